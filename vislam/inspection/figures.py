"""Figures of an inspection: series of the checks in, drawings out."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.inspection.finding import Inspection
from vislam.inspection.shared_profile import CHANNELS, QUANTITIES
from vislam.report.canvas import SMALL, TIME, legend, logarithmic, new_figure
from vislam.report.colours import COLOURS
from vislam.report.figures import Drawing

Panel = Callable[[Axes, dict[str, Array]], None]
_NAMES = ("rate x [rad/s]", "rate y [rad/s]", "rate z [rad/s]", "forward [m/s]", "left [m/s]", "third [m/s]")
_TOLD = {
    "tracks": ("Tracks", "Tracks in view of each frame, the duplicated frames, and how long tracks are."),
    "motion": (
        "Motion",
        "Rates and velocities of each step: as the camera sees them, and as the inertial samples say.",
    ),
    "checks": (
        "Measured by the checks",
        "One-frame error of each reading of axes and extrinsic, mismatch over the clock offset, distance by "
        "disparity, and pixel noise over the frames between two observations.",
    ),
    "shared": (
        "Errors that all tracks share",
        "Mean residuals of tracks carried over one frame, with 95 % intervals by a block bootstrap: under "
        "the recorded motion less its bias (left), and under the rigid motion of the frame's own tracks "
        "(right).",
    ),
}
"""Title and caption of each figure."""
OF_CHECKS = {
    "tracks": ("duplicated tracks", "tracks", "observations"),
    "motion": ("biases", "inertial noise", "third velocity component", "units"),
    "checks": ("axes and extrinsic", "clock", "imu clock", "stereo scale", "disparity offset", "pixel noise"),
    "shared": ("shared errors",),
}
"""Checks whose evidence each figure shows."""


def drawings(result: Inspection, *, title: str) -> dict[str, Drawing]:
    """Figures by name with their words: tracks, motion, and what the other checks have measured."""
    return {name: Drawing(*_TOLD[name], figure) for name, figure in figures(result, title=title).items()}


def figures(result: Inspection, *, title: str) -> dict[str, Figure]:
    """Figures by name; without a series, none."""
    series = result.series
    drawn = {"tracks": _tracks(series)}
    if len(series.get("step_seen", ())):
        drawn["motion"] = _motion(series)
    panels = [draw for draw, needed in _PANELS.items() if all(len(series.get(name, ())) for name in needed)]
    if panels:
        drawn["checks"] = _checks(series, panels)
    if len(series.get("shared_at", ())):
        drawn["shared"] = _shared(series)
    for figure in drawn.values():
        figure.suptitle(literal(title), x=0.99, ha="right", fontsize=SMALL)
    return drawn


def _tracks(series: dict[str, Array]) -> Figure:
    figure = new_figure(4.8)
    above, below = figure.subplots(2)
    above.plot(series["tracks_in_view"], linewidth=0.8, color=COLOURS[0], label="tracks in view")
    above.plot(
        series["duplicated_frames"],
        np.zeros(len(series["duplicated_frames"])),
        "|",
        color=COLOURS[1],
        label="duplicated frames",
    )
    above.set(xlabel="frame", ylabel="tracks")
    legend(figure, above)
    length = series["track_length"]
    below.hist(length, color=COLOURS[0], bins=np.arange(1, max(length.max(initial=1), 2) + 2) - 0.5)
    below.set(xlabel="length of a track, duplicated tracks cut [frames]", ylabel="tracks")
    if len(length):
        logarithmic(below)
    return figure


def _motion(series: dict[str, Array]) -> Figure:
    figure = new_figure(8.4)
    for index, axes in enumerate(figure.subplots(6, sharex=True)):
        axes.plot(
            series["step_time"],
            series["step_seen"][:, index],
            ".",
            markersize=2,
            color=COLOURS[1],
            label="camera",
            rasterized=True,
        )
        axes.plot(
            series["step_time"],
            series["step_inertial"][:, index],
            linewidth=0.8,
            color=COLOURS[0],
            label="inertial",
        )
        low, high = np.quantile(series["step_seen"][:, index], [0.005, 0.995])
        axes.set(
            ylabel=_NAMES[index], ylim=(low - 0.1 * (high - low) - 1e-3, high + 0.1 * (high - low) + 1e-3)
        )
    axes.set_xlabel(TIME)
    legend(figure, figure.axes[0])
    return figure


def _checks(series: dict[str, Array], panels: list[Panel]) -> Figure:
    figure = new_figure(5.6 if len(panels) > 2 else 3.2)
    for place, draw in enumerate(panels, start=1):
        draw(figure.add_subplot((len(panels) + 1) // 2, min(len(panels), 2), place), series)
    return figure


def _shared(series: dict[str, Array]) -> Figure:
    figure = new_figure(9.6)
    panels = figure.subplots(len(QUANTITIES), 2)
    for side, name in enumerate(("shared_recorded", "shared_own")):
        for row, (at, table) in enumerate(zip(series["shared_at"], series[name], strict=True)):
            axes = panels[row, side]
            for channel, colour in enumerate(COLOURS[: len(CHANNELS)]):
                mean, low, high = table[:, channel].T
                axes.plot(at, mean, "o-", markersize=2, linewidth=0.8, color=colour, label=CHANNELS[channel])
                axes.fill_between(at, low, high, color=colour, alpha=0.2, linewidth=0.0)
            axes.axhline(0.0, color="0.6", linewidth=0.6)
            axes.set(xlabel=QUANTITIES[row], ylabel="residual [px]" if side == 0 else "")
            if row == 0:
                logarithmic(axes, "x")
    legend(figure, panels[0, 0])
    return figure


def _readings(axes: Axes, series: dict[str, Array]) -> None:
    score = series["mounting_score"]
    axes.plot(np.arange(1, len(score) + 1), score, "o-", markersize=3, color=COLOURS[0])
    axes.set(xlabel="reading of axes and extrinsic, by rank", ylabel="one-frame error [px]")


def _clock(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["clock_lag"], series["clock_cost"], color=COLOURS[0])
    axes.set(xlabel="clock offset [s]", ylabel="mismatch of the two motions")


def _scale(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["way_disparity"], series["way_ratio"], "o-", color=COLOURS[0])
    axes.axhline(1.0, color="0.6", linewidth=0.8)
    axes.set(xlabel="disparity [px]", ylabel="camera's distance over inertial distance")
    logarithmic(axes, "x")


def _pixel_noise(axes: Axes, series: dict[str, Array]) -> None:
    axes.plot(series["pixel_span"], series["pixel_sigma"], "o-", color=COLOURS[0])
    axes.set(xlabel="frames between two observations", ylabel="row error [px]")


_PANELS: dict[Panel, tuple[str, ...]] = {
    _readings: ("mounting_score",),
    _clock: ("clock_lag", "clock_cost"),
    _scale: ("way_disparity", "way_ratio"),
    _pixel_noise: ("pixel_span", "pixel_sigma"),
}
"""Panels of the figure of checks, each with the series that it needs."""
