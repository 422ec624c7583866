"""The measure of Clement et al. (2015), of the configs ``battle/*``: ``python -m experiments.battle``.

Lee Clement, Valentin Peretroukhin, Jacob Lambert and Jonathan Kelly, *The Battle for Filter Supremacy: A
Comparative Study of the Multi-State Constraint Kalman Filter and the Sliding Window Filter* (CRV 2015). The
first pose is that of the reference and nothing is aligned. With e the error of a part of a pose, a vector of
three numbers, and P the estimated covariance (6 x 6) of all of it,

    ARMSE = mean over time of sqrt(|e|^2 / 3),    ANEES = mean over time of e^T P^-1 e / 6.

The position's error is that of the left camera in the world; the rotation's is the rotation vector between
estimate and reference. Of their MSCKF the authors take each pose as it leaves the window, which is what is
called smoothed here.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import vislam
from vislam.base.shipped import shipped_configs
from vislam.base.types import Array
from vislam.cli.console import Terminal
from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation.normalised import pose_errors
from vislam.geometry import se3

HEADER = "| set | estimator | estimate | ARMSE position [m] | ARMSE rotation [rad] | ANEES | step [ms] |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the configs and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("config", nargs="*", help="in place of all battle/*")
    parser.add_argument("--data-dir", type=Path, help="first folder to look for data")
    parser.add_argument("--estimators", help="in place of the config's, with commas between")
    options = parser.parse_args(arguments)
    chosen = options.estimators.split(",") if options.estimators else None
    print(f"{HEADER}\n|---|---|---|---:|---:|---:|---:|")
    for name in options.config or [name for name in shipped_configs() if name.startswith("battle/")]:
        outcome = vislam.compare(
            name,
            estimators=chosen,
            data_dir=options.data_dir,
            allow_substitute=False,
            progress=Terminal(),
        )
        record = outcome.results.record
        assert record.reference is not None
        for run in outcome.runs.values():
            for line in rows(run, record.reference, record.rig.imu_T_cam):
                print(f"| {outcome.results.config.name} | {line}", flush=True)
    return 0


def rows(run: Run, reference: Reference, imu_T_cam: Array) -> Iterator[str]:
    """Lines of a run, one for each of its estimates."""
    if run.log.error:
        yield f"{run.name} | broke off: {run.log.error} | | | | |"
        return
    for estimate in ESTIMATES:
        if estimate == "smoothed" and run.smoothed is None:
            continue
        position, rotation = armse(run, reference, imu_T_cam, estimate=estimate)
        nees, step = anees(run, reference, estimate=estimate), 1e3 * float(np.median(run.cost.step_time))
        said = "-" if nees is None else f"{nees:.2f}"
        yield f"{run.name} | {estimate} | {position:.3f} | {rotation:.4f} | {said} | {step:.1f} |"


def armse(run: Run, reference: Reference, imu_T_cam: Array, *, estimate: Estimate) -> tuple[float, float]:
    """ARMSE of the left camera's position [m] and of the rotation [rad]."""
    assert reference.pose is not None
    _, own, other = np.intersect1d(run.frame, reference.frame, return_indices=True)
    pose, target = (one @ imu_T_cam for one in (run.poses(estimate).world_T_imu[own], reference.pose[other]))
    return armse_of(pose, target)


def armse_of(world_T_cam: Array, target_T_cam: Array) -> tuple[float, float]:
    """ARMSE of positions [m] and of rotations [rad] of poses ``(T, 4, 4)``, from the same first pose on."""
    target = world_T_cam[0] @ se3.inverse(target_T_cam[0]) @ target_T_cam
    turned = se3.log(se3.inverse(world_T_cam) @ target)[:, :3]
    moved = world_T_cam[:, :3, 3] - target[:, :3, 3]
    position, rotation = (float(np.mean(np.sqrt(np.mean(e**2, axis=1)))) for e in (moved, turned))
    return position, rotation


def anees(run: Run, reference: Reference, *, estimate: Estimate) -> float | None:
    """ANEES of the pose; None where no covariance was estimated."""
    errors = pose_errors(run, reference, estimate=estimate)
    found = None if errors is None else errors.get("pose")
    return None if found is None else float(np.mean(found.nees)) / 6.0


if __name__ == "__main__":
    sys.exit(main())
