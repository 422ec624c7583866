"""Figures over time: errors, attitude, observations, innovations, cost of the steps."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.spatial.transform import Rotation

from vislam.base.distributions import chi2_quantile
from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.core.run import Run
from vislam.evaluation.rpe import RelativeErrors
from vislam.evaluation.trajectory_scores import WORST_LENGTH, TrajectoryScores
from vislam.report.canvas import TIME, area, band, legend, limit, line, logarithmic, panels
from vislam.report.shown import Shown

_SMALLEST_ERROR = 1e-2
"""Where the logarithmic axis of the error starts [m]; on a linear one dead reckoning flattens the rest."""
_SMOOTHING = 25
"""Frames over which the NIS is averaged."""
THREE_SIGMA = "three estimated standard deviations"


def height_attitude(shown: Shown) -> Figure:
    """Height, roll, pitch and yaw over time."""
    figure, rows = panels(4, 6.8)
    reference = shown.reference
    drawn: dict[str, list[Array]] = {}
    for name, run in shown.runs.items():
        drawn[name] = _height_attitude(run.final.world_T_imu)
        for axes, values in zip(rows, drawn[name], strict=True):
            axes.plot(
                shown.time(run), values, lw=1, color=shown.colour(name), label=literal(shown.label(name))
            )
    wanted = [drawn[name] for name in shown.seeing()]
    if reference is not None and reference.pose is not None and np.allclose(reference.imu_T_point, np.eye(4)):
        wanted.append(_height_attitude(reference.pose))
        for axes, values in zip(rows, wanted[-1], strict=True):
            axes.plot(
                shown.time_at(reference.frame), values, lw=1, color="black", label=literal(reference.name)
            )
    for row, (axes, label) in enumerate(
        zip(rows, ("height [m]", "roll [deg]", "pitch [deg]", "yaw [deg]"), strict=True)
    ):
        axes.set_ylabel(label)
        limit(
            axes,
            [one[row] for one in wanted],
            _leaving(shown, {name: one[row] for name, one in drawn.items()}),
        )
    rows[-1].set_xlabel(TIME)
    legend(figure, rows[0])
    return figure


def _height_attitude(pose: Array) -> list[Array]:
    angles = Rotation.from_matrix(pose[:, :3, :3]).as_euler("xyz", degrees=True)
    angles[:, 2] = np.rad2deg(np.unwrap(np.deg2rad(angles[:, 2])))
    return [pose[:, 2, 3], *angles.T]


def _leaving(shown: Shown, values: Mapping[str, Array]) -> list[tuple[str, str, Array]]:
    """Lines that do not set the scale of a panel, as :func:`~vislam.report.canvas.limit` takes them."""
    return [(literal(name), shown.colour(name), values[name]) for name in shown.leaving() if name in values]


def error(shown: Shown) -> Figure | None:
    """Position error after alignment over time, with the estimated 3-sigma bound."""
    reference, found = shown.reference, _trajectories(shown)
    if reference is None or not found:
        return None
    figure, (axes,) = panels(1, 4.0)
    bounded = False
    for name, one in found.items():
        run, colour = shown.runs[name], shown.colour(name)
        size = np.linalg.norm(one.headline.position_error, axis=1)
        time = shown.matched_time(one)
        line(axes, time, size, lw=1.0, color=colour, label=literal(name))
        cov = run.final.covariances
        if np.isfinite(cov).any() and run.innovations.dof.sum() > 0:
            spread = 3.0 * np.sqrt(np.linalg.eigvalsh(cov[:, 3:, 3:])[:, -1])
            axes.plot(shown.time(run), spread, "--", lw=0.9, alpha=0.8, color=colour)
            bounded = True
    if bounded:
        axes.plot([], [], "--", lw=0.9, color="black", label=THREE_SIGMA)
    axes.set(xlabel=TIME, ylabel=literal(f"position error to {reference.name} [m]"))
    logarithmic(axes)
    axes.set_ylim(_SMALLEST_ERROR, None)
    legend(figure, axes)
    return figure


def _trajectories(shown: Shown) -> dict[str, TrajectoryScores]:
    every = {name: one.trajectory for name, one in shown.scores.items()}
    return {name: one for name, one in every.items() if one is not None}


def components(shown: Shown) -> Figure | None:
    """Position error along each axis of the reference over time."""
    found = _trajectories(shown)
    if not found:
        return None
    size = next(iter(found.values())).headline.position_error.shape[1]
    figure, rows = panels(size, 0.9 + 1.5 * size)
    for index, (axes, letter) in enumerate(zip(rows, "xyz", strict=False)):
        values = {name: one.headline.position_error[:, index] for name, one in found.items()}
        for name, one in found.items():
            time = shown.matched_time(one)
            line(axes, time, values[name], lw=1.0, color=shown.colour(name), label=literal(name))
        axes.axhline(0.0, color="k", lw=0.5)
        axes.set_ylabel(f"{letter} [m]")
        limit(axes, [values[name] for name in shown.seeing() if name in values], _leaving(shown, values))
    rows[-1].set_xlabel(TIME)
    legend(figure, rows[0])
    return figure


def relative(shown: Shown) -> Figure | None:
    """Relative errors over segments of one length, at the time at which each begins."""
    found, length = _segments(shown)
    if not found:
        return None
    turned = all(one.rotation_error is not None for one in found.values())
    figure, rows = panels(2 if turned else 1, 4.8 if turned else 3.2)
    for name, one in found.items():
        parts = [one.translation_error]
        if one.rotation_error is not None:
            parts.append(np.rad2deg(one.rotation_error))
        for axes, values in zip(rows, parts, strict=False):
            line(
                axes, shown.time_at(one.first), values, lw=1.0, color=shown.colour(name), label=literal(name)
            )
    for axes, label in zip(rows, (f"over {length:g} m [m]", f"over {length:g} m [deg]"), strict=False):
        axes.set_ylabel(label)
        logarithmic(axes)
    rows[-1].set_xlabel(TIME)
    legend(figure, rows[0])
    return figure


def _segments(shown: Shown) -> tuple[dict[str, RelativeErrors], float]:
    """Relative errors of each run over the length of the worst segments, or else the longest there is."""
    trajectories = _trajectories(shown)
    lengths = {length for one in trajectories.values() for length in one.by_distance}
    if not lengths:
        return {}, 0.0
    length = WORST_LENGTH if WORST_LENGTH in lengths else max(lengths)
    found = {name: one.by_distance[length] for name, one in trajectories.items() if length in one.by_distance}
    return found, length


def observations(shown: Shown) -> Figure | None:
    """How many observations each frame has, how many each run fused and how many it did not."""
    given = shown.record.given.frame
    frames = len(shown.record.stamp)
    if not len(given):
        return None
    figure, (above, below) = panels(2, 4.6)
    time = shown.time_at(np.arange(frames))
    read = np.bincount(given, minlength=frames)
    area(above, time, read, color="0.8", label="given, repaired", step="mid")
    for name in shown.seeing():
        run = shown.runs[name]
        used, own = np.bincount(given[run.used], minlength=frames), run.frame
        drawn: dict[str, Any] = {"lw": 0.8, "color": shown.colour(name), "label": literal(name)}
        above.plot(time[own], used[own], **drawn)
        below.plot(time[own], (read - used)[own], **drawn)
    above.set(ylabel="fused", ylim=(0, None))
    below.set(ylabel="rejected", xlabel=TIME, ylim=(0, None))
    legend(figure, above)
    return figure


def nis(shown: Shown) -> Figure | None:
    """Normalised innovation squared per degree of freedom, with its 95 % interval under the model."""
    runs = {name: run for name, run in shown.runs.items() if run.innovations.dof.sum() > 0}
    if not runs:
        return None
    figure, (axes,) = panels(1, 3.6)
    for index, (name, run) in enumerate(runs.items()):
        value, low, high = _smoothed_nis(run)
        axes.plot(shown.time(run), value, lw=1, color=shown.colour(name), label=literal(name))
        label = "95 % interval of a consistent filter" if index == 0 else None
        band(axes, shown.time(run), low, high, color="0.8", label=label)
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(xlabel=TIME, ylabel="NIS per degree of freedom", ylim=(0, None))
    legend(figure, axes)
    return figure


def _smoothed_nis(run: Run) -> tuple[Array, Array, Array]:
    """NIS per degree of freedom over some frames, and its 95 % interval."""
    found = run.innovations
    window = np.ones(min(_SMOOTHING, len(found.dof)))
    dof = np.maximum(np.convolve(found.dof, window, mode="same"), 1.0)
    low, high = (chi2_quantile(share, dof) / dof for share in (0.025, 0.975))
    return np.convolve(found.nis, window, mode="same") / dof, low, high


def step_time(shown: Shown) -> Figure | None:
    """Time of each step; None where nobody knows it."""
    if not any(len(run.cost.step_time) for run in shown.runs.values()):
        return None
    figure, (axes,) = panels(1, 3.4)
    for name, run in shown.runs.items():
        if len(run.cost.step_time):
            axes.plot(
                shown.time(run),
                1e3 * run.cost.step_time,
                lw=0.6,
                color=shown.colour(name),
                label=literal(name),
            )
    axes.set(xlabel=TIME, ylabel="step time [ms]")
    logarithmic(axes)
    legend(figure, axes)
    return figure


def three_sigma_band(axes: Axes) -> None:
    """Put what a band of three standard deviations looks like into the legend."""
    axes.add_line(Line2D([], [], color="0.5", lw=6, alpha=0.3, label=THREE_SIGMA))
