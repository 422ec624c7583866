"""What an inspection leaves behind: ``inspection.json`` and its figures."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.files import replace_whole, write_text
from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.inspection import Inspection

SCHEMA_VERSION = 1
Panel = Callable[[Axes, dict[str, Array]], None]
_NAMES = ("rate x [rad/s]", "rate y [rad/s]", "rate z [rad/s]", "forward [m/s]", "left [m/s]", "third [m/s]")


def write_inspection(folder: Path, result: Inspection, *, stand_in: bool) -> None:
    """Write the findings and the figures, each file whole or not at all."""
    document = {
        "schema_version": SCHEMA_VERSION,
        "name": result.name,
        "stand_in": stand_in,
        "findings": [_finite(asdict(finding)) for finding in result.findings],
        "proposal": _finite(result.proposal),
        "settings": _finite(result.settings),
        "unknown": result.unknown,
    }
    write_text(folder / "inspection.json", json.dumps(document, indent=1) + "\n")
    mark = " [SIMULATED]" if stand_in else ""
    for name, figure in figures(result, title=f"{result.name}{mark}").items():
        with replace_whole(folder / f"{name}.png") as temporary:
            figure.savefig(temporary, format="png", dpi=110)


def figures(result: Inspection, *, title: str) -> dict[str, Figure]:
    """Figures by name: tracks, motion, and what the other checks have measured; without a series, none."""
    series = result.series
    drawn = {"tracks": _tracks(series)}
    if len(series.get("step_seen", ())):
        drawn["motion"] = _motion(series)
    panels = [draw for draw, needed in _PANELS.items() if all(len(series.get(name, ())) for name in needed)]
    if panels:
        drawn["checks"] = _checks(series, panels)
    for figure in drawn.values():
        figure.suptitle(literal(title))
    return drawn


def _tracks(series: dict[str, Array]) -> Figure:
    figure = Figure(figsize=(9, 6), layout="constrained")
    above, below = figure.subplots(2)
    above.plot(series["tracks_in_view"], linewidth=0.8, label="tracks in view")
    above.plot(
        series["stale_frames"], np.zeros(len(series["stale_frames"])), "|", color="C3", label="stale frames"
    )
    above.set(xlabel="frame", ylabel="tracks")
    above.legend()
    length = series["track_length"]
    below.hist(length, bins=np.arange(1, max(length.max(initial=1), 2) + 2) - 0.5)
    below.set(xlabel="length of a track, stale tracks cut [frames]", ylabel="tracks")
    if len(length):
        below.set_yscale("log")
    return figure


def _motion(series: dict[str, Array]) -> Figure:
    figure = Figure(figsize=(9, 11), layout="constrained")
    for index, axes in enumerate(figure.subplots(6, sharex=True)):
        axes.plot(
            series["step_time"], series["step_seen"][:, index], ".", markersize=2, color="C1", label="camera"
        )
        axes.plot(
            series["step_time"],
            series["step_inertial"][:, index],
            linewidth=0.8,
            color="C0",
            label="inertial",
        )
        low, high = np.quantile(series["step_seen"][:, index], [0.005, 0.995])
        axes.set(
            ylabel=_NAMES[index], ylim=(low - 0.1 * (high - low) - 1e-3, high + 0.1 * (high - low) + 1e-3)
        )
    axes.set_xlabel("time [s]")
    figure.axes[0].legend()
    return figure


def _checks(series: dict[str, Array], panels: list[Panel]) -> Figure:
    figure = Figure(figsize=(9, 7 if len(panels) > 2 else 4), layout="constrained")
    for place, draw in enumerate(panels, start=1):
        draw(figure.add_subplot((len(panels) + 1) // 2, min(len(panels), 2), place), series)
    return figure


def _readings(axes: Axes, series: dict[str, Array]) -> None:
    score = series["mounting_score"]
    axes.plot(np.arange(1, len(score) + 1), score, "o-", markersize=3)
    axes.set(xlabel="reading of axes and extrinsic, by rank", ylabel="one-frame error [px]")


def _clock(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["clock_lag"], series["clock_cost"])
    axes.set(xlabel="clock offset [s]", ylabel="mismatch of the two motions")


def _scale(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["way_disparity"], series["way_ratio"], "o-")
    axes.axhline(1.0, color="0.6", linewidth=0.8)
    axes.set(xlabel="disparity [px]", ylabel="camera's distance over inertial distance", xscale="log")


def _pixel_noise(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["pixel_span"], series["pixel_sigma"], "o-")
    axes.set(xlabel="frames between two observations", ylabel="row error [px]")


_PANELS: dict[Panel, tuple[str, ...]] = {
    _readings: ("mounting_score",),
    _clock: ("clock_lag", "clock_cost"),
    _scale: ("way_disparity", "way_ratio"),
    _pixel_noise: ("pixel_span", "pixel_sigma"),
}
"""Panels of the figure of checks, each with the series that it needs."""


def _finite(value: object) -> object:
    """Plain data for JSON: numbers that are none become null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
