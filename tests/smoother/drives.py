"""Simulated drives, faults planted in them, and short ways to run a smoother over them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tests.conftest import from_first
from vislam.base.types import Array
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.loop import run
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions, family
from vislam.geometry import se3
from vislam.models import CAMERA_AXES, StereoRig
from vislam.repair import RepairConfig
from vislam.repair.pixels import Disparity
from vislam.repair.tracks import Interruptions
from vislam.simulation import SimulationConfig

BUILD = {
    "isam2": family.build_isam2,
    "isam2_between": family.build_between,
    "isam2_norelin": family.build_norelin,
    "fixed_lag": family.build_fixed_lag,
    "batch": family.build_batch,
    "batch_schur": family.build_schur,
    "batch_gnc": family.build_gnc,
}
RIG = StereoRig(
    500.0,
    510.0,
    320.0,
    200.0,
    0.5,
    se3.from_rotation_translation(CAMERA_AXES, np.array([1.0, 0.1, 0.5])),
)


def drive(*, seed: int, pixel: float = 0.3, gyro: float = 0.002, velocity: float = 0.02, **settings: Any):
    """Config and dataset of a drive whose noise is what the estimators assume; all repairs let it pass."""
    simulation = SimulationConfig(
        pixel_sigma_px=pixel, gyro_sigma=gyro, velocity_sigma=velocity, **{"frames": 60, **settings}
    )
    root = np.sqrt(simulation.period)
    repairs = RepairConfig(consensus=None, disparity=Disparity(row_difference_px=200.0))
    config = Config(
        name="drive",
        data=DataConfig(simulation=simulation, repair=repairs),
        noise=NoiseConfig(pixel_sigma_px=pixel, twist_density=(gyro * root,) * 3 + (velocity * root,) * 3),
    )
    return config, open_dataset(config.data, seed=seed)


def exact(*, seed: int, **settings: Any):
    """Config and dataset of a drive without any error, and noise figures as if it had some."""
    config, _ = drive(seed=seed, **settings)
    assert config.data.simulation is not None
    clean = replace(config.data.simulation, pixel_sigma_px=0.0, gyro_sigma=0.0, velocity_sigma=0.0)
    dataset = open_dataset(replace(config.data, simulation=clean), seed=seed)
    assert dataset.reference is not None
    sequence, pose = dataset.sequence, dataset.reference.pose
    steps = se3.local(pose[:-1], pose[1:]) / np.diff(sequence.stamp)[:, None]
    stamp, twist = piecewise_constant(sequence.stamp, steps)
    sequence = replace(
        sequence, inertial_stamp=stamp, twist=twist, vertical_velocity=np.full(len(stamp), np.nan)
    )
    return config, replace(dataset, sequence=sequence)


def member(name: str, config: Config, dataset: Dataset, *, sigma: Array | None = None, **options: Any) -> Run:
    """Run a member of the family."""
    estimator = BUILD[name](make_problem(config, dataset), options)
    sigma = pixel_sigma(config, dataset) if sigma is None else sigma
    return run(estimator, dataset.sequence, sigma, name=name)


def filtered(config: Config, dataset: Dataset) -> Run:
    """Run the filter on what the smoothers are told: no gate, independent errors."""
    estimator = EkfEstimator(
        make_problem(config, dataset),
        EkfOptions(gate=False, track_errors="independent", marginalised_landmarks="filtered"),
    )
    return run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="ekf")


def smoother(problem: Problem, **options: Any) -> SmootherEstimator:
    """Build the smoother with plain options."""
    return SmootherEstimator(problem, SmootherOptions(**options))


def gap(one: Array, other: Array) -> tuple[float, float]:
    """Largest difference of two lists of poses [rad, m]."""
    local = se3.local(one, other)
    return (
        float(np.linalg.norm(local[..., :3], axis=-1).max()),
        float(np.linalg.norm(local[..., 3:], axis=-1).max()),
    )


def ate(poses: Array, dataset: Dataset) -> float:
    """Root mean square error of the positions, the first poses laid on each other [m]; inf of a part."""
    if len(poses) < len(dataset.sequence):
        return float("inf")
    assert dataset.reference is not None
    error = (from_first(poses) - from_first(dataset.reference.pose))[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def _pixels(sequence: Sequence, change: Callable[[Array], None]) -> Sequence:
    pixels = sequence.pixels.copy()
    change(pixels)
    return replace(sequence, pixels=pixels)


def negative_disparities(sequence: Sequence) -> Sequence:
    """One observation in nine has left and right columns exchanged."""

    def change(pixels: Array) -> None:
        wrong = np.arange(len(pixels)) % 9 == 4
        pixels[wrong] = pixels[wrong][:, [2, 1, 0, 3]]

    return _pixels(sequence, change)


def dark(first: int, count: int) -> Callable[[Sequence], Sequence]:
    """No tracks for some frames."""

    def fault(sequence: Sequence) -> Sequence:
        frame = sequence.frame_of
        return Interruptions().apply(sequence.select((frame < first) | (frame >= first + count)))

    return fault


def teleporting_track(sequence: Sequence) -> Sequence:
    """The longest track jumps across the image in its middle, and in disparity."""
    which = np.argmax(np.bincount(sequence.track))
    rows = np.flatnonzero(sequence.track == which)

    def change(pixels: Array) -> None:
        pixels[rows[len(rows) // 2 :]] += [300.0, -80.0, 260.0, -80.0]

    return _pixels(sequence, change)


def landmark_on_the_baseline(sequence: Sequence) -> Sequence:
    """The longest track has the disparities of a point a centimetre away, another one comes to it."""
    long = np.argsort(np.bincount(sequence.track))[-2:]

    def change(pixels: Array) -> None:
        whole, later = (np.flatnonzero(sequence.track == which) for which in long)
        pixels[whole, 2] = pixels[whole, 0] - sequence.rig.fx * sequence.rig.baseline / 0.01
        half = later[len(later) // 2 :]
        pixels[half, 2] = pixels[half, 0] - np.geomspace(100.0, 1e5, len(half))

    return _pixels(sequence, change)


def repeated_frames(sequence: Sequence) -> Sequence:
    """Every tenth frame has the pixels of the one before, and comes a microsecond after it."""
    stamp, pixels = sequence.stamp.copy(), sequence.pixels.copy()
    frame = sequence.frame_of
    for k in range(10, len(sequence), 10):
        stamp[k] = stamp[k - 1] + 1e-6
        before, now = np.flatnonzero(frame == k - 1), np.flatnonzero(frame == k)
        _, there, here = np.intersect1d(sequence.track[before], sequence.track[now], return_indices=True)
        pixels[now[here]] = pixels[before[there]]
    return replace(sequence, stamp=stamp, pixels=pixels)


def thinned(sequence: Sequence, kept: Array) -> Sequence:
    """Some frames of a sequence only, with the inertial samples of these and without tracks."""
    return replace(
        sequence,
        stamp=sequence.stamp[kept],
        inertial_stamp=sequence.inertial_stamp[kept],
        twist=sequence.twist[kept],
        vertical_velocity=sequence.vertical_velocity[kept],
        offset=np.zeros(len(kept) + 1, np.int64),
        track=sequence.track[:0],
        pixels=sequence.pixels[:0],
        row=sequence.row[:0],
    )
