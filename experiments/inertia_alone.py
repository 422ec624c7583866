"""How far inertia leads alone, and whether its covariance says so: on any config with ``motion: imu``.

After each frame of the invariant filter its state, with the joint covariance of pose, velocity and biases, is
predicted over some seconds without a camera. With the relative pose ``D = T_k^-1 T_m`` of the prediction, its
error is that of the motion since frame k,

    e = log(D^-1 D_ref) = (F_pose - Ad(D^-1) [I, 0]) e_k + w,

so that what the filter is off by in heading and place at frame k does not count, and what it is off by in
tilt, velocity and biases does. The reference is that of the dataset.

    python -m experiments.inertia_alone kitti00_imu --seconds 1,5
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vislam.base.progress import Silent
from vislam.base.shipped import find_config
from vislam.base.types import Array
from vislam.comparison.compare import prepare
from vislam.comparison.config import load, with_estimators
from vislam.comparison.open import open_dataset
from vislam.core.frame import Frame
from vislam.core.imu import ImuStep
from vislam.estimators.ekf.filter import EkfEstimator
from vislam.geometry import se3
from vislam.models.imu import ACCEL_BIAS, GYRO_BIAS, IMU_NAV, STATES, VELOCITY, ImuNoise
from vislam.models.inertial_gap import InertialState

_FILTER = "ekf_invariant"


@dataclass(frozen=True)
class Start:
    """State of the filter after a frame, and its covariance ``(15, 15)``."""

    state: InertialState
    cov: Array

    @classmethod
    def of(cls, solver: EkfEstimator) -> "Start":
        """That of a filter as it is."""
        state, layout = solver.state, solver.state.layout
        parts = {name: state.nav[layout[name]].copy() for name in STATES}
        pose = state.world_T_imu.copy()
        found = InertialState(pose, parts[VELOCITY], parts[GYRO_BIAS], parts[ACCEL_BIAS])
        return cls(found, state.cov[:IMU_NAV, :IMU_NAV].copy())

    def error(self, frames: Sequence[Frame], noise: ImuNoise, moved: Array) -> tuple[Array, Array]:
        """Error ``(6,)`` of the motion over some frames, and its covariance.

        Parameters
        ----------
        frames : sequence of Frame
            Those that follow.
        noise : ImuNoise
        moved : (4, 4)
            What the reference moves by.
        """
        samples = [frame.imu for frame in frames if frame.imu is not None]
        step = ImuStep.joined(samples).preintegrated(noise, self.state.gyro_bias, self.state.accel_bias)
        there = self.state.predicted(step, noise.gravity_world)
        relative = se3.inverse(self.state.pose) @ there.pose
        transition, spread = step.linear(self.state.pose[:3, :3])
        by_start = transition[:6]
        by_start[:, :6] -= se3.adjoint(se3.inverse(relative))
        return se3.local(relative, moved), by_start @ self.cov @ by_start.T + spread[:6, :6]


def measure(config_path: Path, seconds: Sequence[float], overrides: dict[str, object]) -> list[str]:
    """One line a horizon [s]."""
    config = with_estimators(load(config_path, overrides=overrides), {_FILTER: {}})
    dataset = open_dataset(
        config.data, seed=config.seed, config_dir=config_path.parent, held_out=config.held_out
    )
    assert dataset.reference is not None
    assert dataset.reference.pose is not None
    prepared = prepare(config, dataset, Silent())
    solver, sequence = prepared.estimators[_FILTER], prepared.runner.sequence
    assert isinstance(solver, EkfEstimator)
    assert prepared.problem.imu is not None
    kept = None if prepared.record.common_set is None else prepared.record.common_set.kept
    frames, starts = [], []
    for frame in sequence.frames(prepared.runner.sigma, kept):
        solver.process(frame)
        frames.append(frame)
        starts.append(Start.of(solver))
    pose, stamp, noise = dataset.reference.pose, sequence.stamp, prepared.problem.imu.noise
    lines = []
    for horizon in seconds:
        ends = np.searchsorted(stamp, stamp + horizon - 1e-6)
        pairs = [(k, int(m)) for k, m in enumerate(ends) if m < len(stamp)]
        found = [
            starts[k].error(frames[k + 1 : m + 1], noise, se3.inverse(pose[k]) @ pose[m]) for k, m in pairs
        ]
        error = np.array([one for one, _ in found])
        cov = np.array([one for _, one in found])
        nees = np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0]) / 6.0
        place, turn = np.linalg.norm(error[:, 3:], axis=1), np.linalg.norm(error[:, :3], axis=1)
        sigma = np.sqrt(np.trace(cov[:, 3:, 3:], axis1=1, axis2=2))
        lines.append(
            f"{horizon:g} s, {len(pairs)} starts: position {_rms(place):.3f} m (stated {_rms(sigma):.3f}), "
            f"attitude {np.degrees(_rms(turn)):.3f} deg, NEES per degree of freedom {nees.mean():.2f} "
            f"(median {np.median(nees):.2f})"
        )
    return lines


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("config")
    parser.add_argument("--seconds", default="1,5")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    pairs = (item.partition("=") for item in options.set)
    overrides: dict[str, object] = {key: float(value) for key, _, value in pairs}
    path = find_config(options.config)
    if path is None:
        parser.error(f"{options.config}: no such config")
    for line in measure(path, [float(part) for part in options.seconds.split(",")], overrides):
        print(line)


if __name__ == "__main__":
    main()
