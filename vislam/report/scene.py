"""What the page's 3-D scene draws, as plain data; ``scene.js`` draws it."""

import base64
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from vislam.base.legible import visible
from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.geometry import se3
from vislam.report.colours import COLOURS
from vislam.report.decimation import at_most, evenly, simplified
from vislam.report.shown import Shown

_MOST_LANDMARKS = 4000
"""Landmarks of a run that are drawn at most."""
_MOST_STOPS = 2000
"""Frames at which the slider stops at most: it is no longer than some hundred pixels."""
_MOST_CORNERS = 4000
"""Corners of a path at most."""
_MOST_MARKS = 4000
"""Positions of the reference that are drawn at most."""
_PLACES = 4000
"""Places that are told apart along the scene: four a pixel, before it is drawn nearer."""
_MARGIN = 60.0
"""How far around the paths landmarks are drawn [m]."""


def scene_data(shown: Shown) -> dict[str, Any]:
    """Data of the scene; arrays are base64 of float32, little-endian, row after row.

    Everything is laid on the reference, as in the top view but in three dimensions where the reference has
    a height. The poses that move are those known at their own time, with their covariances then, or those in
    the end where the estimator gives no others; the paths and the landmarks are those known in the end.
    However long the sequence is, there are no more of all of them than can be told apart.
    """
    placed = {name: _pose(shown, name) for name in shown.runs}
    paths = {
        name: se3.transform(pose, shown.positions(shown.runs[name].final.world_T_imu))
        for name, pose in placed.items()
    }
    every = np.concatenate([*(paths[name] for name in shown.seeing()), np.zeros((0, 3))])
    low, high = (every.min(axis=0), every.max(axis=0)) if len(every) else (np.zeros(3), np.ones(3))
    stops = evenly(len(shown.record.stamp), _MOST_STOPS)
    least = float((high - low).max() + 2.0 * _MARGIN) / _PLACES
    return {
        "frames": len(shown.record.stamp),
        "stop": _packed(stops.astype(np.float64)),
        "stamp": _packed(shown.record.stamp[stops] - shown.record.stamp[0]),
        "low": (low - _MARGIN).tolist(),
        "high": (high + _MARGIN).tolist(),
        "reference": None if shown.reference is None else _reference(shown.reference, least),
        "runs": [
            {"name": name, "colour": COLOURS.index(shown.colour(name))}
            | _path(paths[name], least)
            | _moving(shown, run, placed[name], stops)
            | _landmarks(shown, run, placed[name], low=low - _MARGIN, high=high + _MARGIN)
            for name, run in shown.runs.items()
        ],
    }


def scene_note(scene: Mapping[str, Any]) -> str:
    """What the scene leaves out or makes up."""
    said, runs, reference = [], scene["runs"], scene["reference"]
    stops = len(unpacked(scene["stop"]))
    if stops < scene["frames"]:
        said.append(f"Poses drawn: those of {stops:,} of {scene['frames']:,} frames.")
    if off := max((run["path_off"] for run in runs), default=0.0):
        said.append(f"Lines of the paths are within {off:.2g} m of all their poses.")
    if reference is not None and reference["drawn"] < reference["all"]:
        said.append(f"Positions of the reference drawn: {reference['drawn']:,} of {reference['all']:,}.")
    drawn = ", ".join(
        f"{run['landmarks_drawn']:,} of {run['landmarks_all']:,} of {run['name']}"
        for run in runs
        if run["landmarks_all"]
    )
    if drawn:
        said.append(f"Landmarks drawn: {drawn}; those far from all the paths are left out.")
    if reference is not None and reference["flat"]:
        said.append("The reference has no height and lies at that of the start.")
    return " ".join(said)


def _pose(shown: Shown, name: str) -> Array:
    return shown.drawn_T_world(name, planar=shown.reference is None or shown.reference.planar)


def _reference(reference: Reference, least: float) -> dict[str, Any]:
    """Positions of a reference, of many one at each place; without a height they lie at that of the start."""
    flat = reference.position
    position = np.column_stack([flat, np.zeros((len(flat), 3 - flat.shape[1]))])
    rows = at_most(position, _MOST_MARKS, least)
    return {
        # Plotly reads tags in names.
        "name": escape(visible(reference.name), quote=False),
        "flat": reference.planar,
        "position": _packed(position[rows]),
        "drawn": len(rows),
        "all": len(position),
    }


def _path(position: Array, least: float) -> dict[str, Any]:
    """Corners of a path, and how far from its line a pose may be [m]."""
    rows, off = simplified(position, _MOST_CORNERS, least)
    return {"path": _packed(position[rows]), "path_off": off}


def _moving(shown: Shown, run: Run, pose: Array, stops: IntArray) -> dict[str, str]:
    """Position, attitude and three-sigma semi-axes (in columns) of the causal poses as of some frames."""
    rows = np.unique(np.searchsorted(run.frame, stops, side="right") - 1)
    rows = rows[rows >= 0]
    world_T_imu, final = run.filtered.world_T_imu[rows], run.final.covariances[rows]
    world_R_imu, filtered = world_T_imu[:, :3, :3], run.filtered.covariances[rows]
    given = np.asarray(np.isfinite(filtered).all(axis=(1, 2)))
    cov = np.where(given[:, None, None], filtered, final)[:, 3:, 3:]
    return {
        "frame": _packed(run.frame[rows].astype(np.float64)),
        "position": _packed(se3.transform(pose, shown.positions(world_T_imu))),
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
    """Array as the scene has it."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def unpacked(text: str) -> Array:
    """Array ``(n,)`` of what the scene has, row after row."""
    return np.frombuffer(base64.b64decode(text), "<f4")
