"""Part ``settings``: what a setting of iSAM2 costs, and how far from the converged estimate it ends.

The distance to the converged batch estimate of the same graph needs no reference: it is the error of the
solving alone. No alignment is made for it, as all start from the same prior of the first pose.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.smoother_figure import steps
from benchmarks.smoothing import Smoothed, smoothed
from benchmarks.timing import Drive, Part, milliseconds
from vislam.base.files import replace_whole
from vislam.base.types import Array
from vislam.core.estimator import Estimate
from vislam.estimators.smoother import SmootherOptions
from vislam.estimators.smoother.family import MEMBERS
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.trajectory import ate

_SHIPPED = SmootherOptions()
_SCALES = {0.15: 3.0, 0.5: 10.0}

SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "shipped": {},
    **{
        f"relinearize_every: {every}": {"relinearize_every": every}
        for every in (1, 2, 10, 20, 0)
        if every != _SHIPPED.relinearize_every
    },
    **{
        f"landmark_threshold: {share}": {
            "landmark_threshold": share,
            "pose_threshold_rad": scale * _SHIPPED.pose_threshold_rad,
            "pose_threshold_m": scale * _SHIPPED.pose_threshold_m,
        }
        for share, scale in _SCALES.items()
    },
    **{
        f"wildfire_threshold: {least}": {"wildfire_threshold": least}
        for least in (0.01, 0.1)
        if least != _SHIPPED.wildfire_threshold
    },
    "factorization: auto": {"factorization": "auto"},
}
"""One setting at a time away from the shipped ones; the thresholds of poses go with that of landmarks."""


@dataclass(frozen=True)
class Setting:
    """A setting's run, measured.

    Attributes
    ----------
    run : Smoothed
    distance_as_is, distance_causal : float
        RMSE of the positions at the last frame, before anything final is done, and of the causal ones,
        against the converged estimate [m].
    ate_as_is, ate_causal : float or None
        ATE of the same against the reference [m].
    """

    run: Smoothed
    distance_as_is: float
    distance_causal: float
    ate_as_is: float | None
    ate_causal: float | None


def measure(drive: Drive, *, figure: Path | None) -> Part:
    """Run each setting once, and the batch estimate that all are compared with."""
    batch = smoothed(drive, SmootherOptions(**MEMBERS["batch"])).estimate
    converged = _poses(batch)
    found = {}
    for name, options in SETTINGS.items():
        run = smoothed(drive, SmootherOptions(**{**options, "final": "as_is"}))
        end = _poses(run.estimate)
        found[name] = Setting(
            run,
            distance(end, converged),
            distance(run.causal, converged),
            _ate(drive, end),
            _ate(drive, run.causal),
        )
    if figure is not None:
        drawn = steps(
            {name: one.run.step_time for name, one in found.items()},
            {name: one.distance_as_is for name, one in found.items()},
            title=f"iSAM2 on {drive.name}",
        )
        with replace_whole(figure) as temporary:
            drawn.savefig(temporary, format="png", dpi=110)
    shipped = found["shipped"]
    return Part(
        title=f"settings: isam2 on {drive.name}, {len(drive.dataset.sequence)} frames, 1 thread",
        header=[
            "setting",
            "step, mean [ms]",
            "all steps [s] (/shipped)",
            "to converged, as is [m]",
            "causal [m]",
            "ATE, as is [m]",
            "causal [m]",
            "events",
        ],
        rows=[
            [
                name,
                milliseconds(one.run.step_time.mean()),
                f"{one.run.forward:.2f} ({one.run.forward / shipped.run.forward:.2f})",
                f"{one.distance_as_is:.3f}",
                f"{one.distance_causal:.3f}",
                _metres(one.ate_as_is),
                _metres(one.ate_causal),
                f"{len(one.run.estimate.events)}",
            ]
            for name, one in found.items()
        ],
        notes=(
            f"shipped: relinearize_every {_SHIPPED.relinearize_every}, landmark_threshold "
            f"{_SHIPPED.landmark_threshold}, wildfire_threshold {_SHIPPED.wildfire_threshold}, factorization "
            f"{_SHIPPED.factorization}; as is: after the last step, nothing final done",
            f"converged: batch, {batch.counts['optimisation_rounds']} rounds, ATE "
            f"{_metres(_ate(drive, converged))} m{', '.join(('', *batch.events))}",
            *(f"{name}: {event}" for name, one in found.items() for event in one.run.estimate.events[:2]),
        ),
        values={
            "converged_ate_m": _ate(drive, converged),
            "settings": {
                name: {
                    "step_mean_s": float(one.run.step_time.mean()),
                    "forward_s": one.run.forward,
                    "forward_ratio": one.run.forward / shipped.run.forward,
                    "distance_as_is_m": one.distance_as_is,
                    "distance_causal_m": one.distance_causal,
                    "ate_as_is_m": one.ate_as_is,
                    "ate_causal_m": one.ate_causal,
                    "events": list(one.run.estimate.events),
                }
                for name, one in found.items()
            },
        },
    )


def distance(one: Array, other: Array) -> float:
    """Root mean square distance of positions of two runs of poses ``(T, 4, 4)``, not aligned [m]."""
    return float(np.sqrt(np.mean(np.sum((one[:, :3, 3] - other[:, :3, 3]) ** 2, axis=1))))


def _poses(estimate: Estimate) -> Array:
    assert estimate.world_T_imu is not None
    return estimate.world_T_imu


def _ate(drive: Drive, poses: Array) -> float | None:
    reference = drive.dataset.reference
    if reference is None:
        return None
    matched = associate(np.arange(len(poses)), drive.dataset.sequence.stamp[: len(poses)], poses, reference)
    return ate(matched, find_alignment("planar" if reference.planar else "se3", matched)).position.rmse


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
