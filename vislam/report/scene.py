"""What the page's 3-D scene draws, as plain data; ``scene.js`` draws it."""

import base64
from html import escape
from typing import Any

import numpy as np

from vislam.base.legible import visible
from vislam.base.types import Array
from vislam.core.run import Run
from vislam.geometry import se3
from vislam.report.colours import COLOURS
from vislam.report.shown import Shown

_MOST_LANDMARKS = 4000
"""Landmarks of a run that are drawn at most."""
_MARGIN = 60.0
"""How far around the paths landmarks are drawn [m]."""


def scene_data(shown: Shown) -> dict[str, Any]:
    """Data of the scene; arrays are base64 of float32, little-endian, row after row.

    Everything is laid on the reference, as in the top view but in three dimensions where the reference has
    a height. The poses that move are those known at their own time, with their covariances then, or those in
    the end where the estimator gives no others; the paths and the landmarks are those known in the end.
    """
    placed = {name: _pose(shown, name) for name in shown.runs}
    paths = {
        name: se3.transform(pose, shown.positions(shown.runs[name].final.world_T_imu))
        for name, pose in placed.items()
    }
    every = np.concatenate([*(paths[name] for name in shown.seeing()), np.zeros((0, 3))])
    low, high = (every.min(axis=0), every.max(axis=0)) if len(every) else (np.zeros(3), np.ones(3))
    reference = shown.reference
    return {
        "stamp": _packed(shown.record.stamp - shown.record.stamp[0]),
        "low": (low - _MARGIN).tolist(),
        "high": (high + _MARGIN).tolist(),
        "reference": None
        if reference is None
        else {
            # Plotly reads tags in names.
            "name": escape(visible(reference.name), quote=False),
            "flat": reference.planar,
            "position": _packed(_solid(reference.position)),
        },
        "runs": [
            {"name": name, "colour": COLOURS.index(shown.colour(name)), "path": _packed(paths[name])}
            | _moving(shown, run, placed[name])
            | _landmarks(shown, run, placed[name], low=low - _MARGIN, high=high + _MARGIN)
            for name, run in shown.runs.items()
        ],
    }


def _pose(shown: Shown, name: str) -> Array:
    return shown.drawn_T_world(name, planar=shown.reference is None or shown.reference.planar)


def _solid(position: Array) -> Array:
    """Positions ``(m, 3)`` of a reference; without a height they lie at that of the start."""
    return np.column_stack([position, np.zeros((len(position), 3 - position.shape[1]))])


def _moving(shown: Shown, run: Run, pose: Array) -> dict[str, str]:
    """Position, attitude and three-sigma semi-axes (in columns) of each causal pose."""
    world_R_imu = run.filtered.world_T_imu[:, :3, :3]
    given = np.asarray(np.isfinite(run.filtered.covariances).all(axis=(1, 2)))
    cov = np.where(given[:, None, None], run.filtered.covariances, run.final.covariances)[:, 3:, 3:]
    return {
        "frame": _packed(run.frame.astype(np.float64)),
        "position": _packed(se3.transform(pose, shown.positions(run.filtered.world_T_imu))),
        "attitude": _packed(pose[:3, :3] @ world_R_imu),
        "semi_axes": _packed(pose[:3, :3] @ world_R_imu @ three_sigma_axes(cov)),
    }


def three_sigma_axes(cov: Array) -> Array:
    """Semi-axes, in columns, of the 3-sigma ellipsoids of covariances ``(T, 3, 3)``; NaN where not given."""
    axes = np.full(cov.shape, np.nan)
    given = np.isfinite(cov).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(cov[given])
    axes[given] = 3.0 * np.sqrt(np.maximum(values, 0.0))[:, None, :] * vectors
    return axes


def _landmarks(shown: Shown, run: Run, pose: Array, *, low: Array, high: Array) -> dict[str, Any]:
    """Landmarks near the paths in the order in which they were first seen, thinned out evenly."""
    points = se3.transform(pose, run.landmarks.points_world)
    inside = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    seen = shown.first_seen(run)
    order = inside[np.argsort(seen[inside], kind="stable")]
    order = order[:: max(1, -(-len(order) // _MOST_LANDMARKS))]
    return {
        "landmarks": _packed(points[order]),
        "first_seen": _packed(seen[order].astype(np.float64)),
        "landmarks_drawn": len(order),
        "landmarks_all": len(run.landmarks),
    }


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
