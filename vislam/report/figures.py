"""Figures of a comparison: data in, Figure out."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vislam.data.reference import Reference
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import Matched, associate
from vislam.evaluation.trajectory import ate, distance_driven
from vislam.run import Run
from vislam.types import Array

# Okabe and Ito's colours, which the colour-blind can tell apart; for more runs than six, some of Tol's.
_COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"),
    *("#332288", "#999933", "#882255"),
)
_SMALLEST_ERROR = 1e-2
"""Where the logarithmic axis of the error starts [m]; on a linear one dead reckoning flattens the rest."""
_SMOOTHING = 25
"""Frames over which the NIS is averaged."""


def all_figures(runs: Mapping[str, Run], reference: Reference | None, *, title: str) -> dict[str, Figure]:
    """Every figure of a comparison, by file name."""
    shown = {name: run.levelled() for name, run in runs.items() if len(run.stamp) > 2}
    figures = {
        "top_view": top_view(shown, reference, title=title),
        "height_attitude": height_attitude(shown, reference),
        "step_time": step_time(shown),
    }
    if reference is not None:
        figures["error"] = error_over_distance(shown, reference)
    if any(run.dof.sum() > 0 for run in shown.values()):
        figures["nis"] = nis_over_time(shown)
    return figures


def colours(names: Iterable[str]) -> dict[str, str]:
    """One colour for each run, the same in every figure."""
    return {name: _COLOURS[index % len(_COLOURS)] for index, name in enumerate(names)}


def top_view(runs: Mapping[str, Run], reference: Reference | None, *, title: str) -> Figure:
    """Paths and landmarks from above, aligned with the reference where there is one."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    axes = figure.subplots()
    for name, run in runs.items():
        rotation, translation = np.eye(2), np.zeros(2)
        matched = None if reference is None else _matched(run, reference)
        if matched is not None and len(matched.frame) > 2:
            alignment = find_alignment("planar", matched)
            rotation, translation = alignment.rotation[:2, :2], alignment.translation[:2]
        colour = colours(runs)[name]
        if len(run.points_world):
            points = run.points_world[:, :2] @ rotation.T + translation
            axes.plot(*points.T, ".", ms=1, alpha=0.25, color=colour, rasterized=True)
        path = (run.world_T_imu @ (np.eye(4) if reference is None else reference.imu_T_point))[:, :2, 3]
        axes.plot(*(path @ rotation.T + translation).T, color=colour, lw=1.2, label=name)
    if reference is not None:
        axes.plot(*reference.position[:, :2].T, "k.", ms=3, label=reference.name)
        low, high = reference.position[:, :2].min(axis=0), reference.position[:, :2].max(axis=0)
        margin = 0.15 * float((high - low).max()) + 20.0
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(title=title, xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.legend(loc="best", fontsize=8)
    return figure


def _matched(run: Run, reference: Reference) -> Matched:
    return associate(run.frame, run.stamp, run.world_T_imu, reference)


def height_attitude(runs: Mapping[str, Run], reference: Reference | None) -> Figure:
    """Height, roll, pitch and yaw over time."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    rows = figure.subplots(4, 1, sharex=True)
    for name, run in runs.items():
        _height_attitude(rows, run.stamp, run.world_T_imu, colour=colours(runs)[name], label=name)
    if reference is not None and reference.pose is not None and np.allclose(reference.imu_T_point, np.eye(4)):
        stamp = max((run.stamp for run in runs.values()), key=len)
        inside = reference.frame < len(stamp)
        _height_attitude(
            rows, stamp[reference.frame[inside]], reference.pose[inside], colour="black", label=reference.name
        )
    for axes, label in zip(rows, ("height [m]", "roll [deg]", "pitch [deg]", "yaw [deg]"), strict=True):
        axes.set_ylabel(label)
    rows[0].legend(loc="best", fontsize=8)
    rows[-1].set_xlabel("time [s]")
    return figure


def _height_attitude(rows: list[Axes], stamp: Array, pose: Array, *, colour: str, label: str) -> None:
    angles = Rotation.from_matrix(pose[:, :3, :3]).as_euler("xyz", degrees=True)
    angles[:, 2] = np.rad2deg(np.unwrap(np.deg2rad(angles[:, 2])))
    for axes, values in zip(rows, [pose[:, 2, 3], *angles.T], strict=True):
        axes.plot(stamp, values, lw=1, color=colour, label=label)


def error_over_distance(runs: Mapping[str, Run], reference: Reference) -> Figure:
    """Position error after alignment over the distance driven, with the causal 3-sigma claim."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, run in runs.items():
        matched = _matched(run, reference)
        if len(matched.frame) < 3:
            continue
        errors = ate(matched, find_alignment("planar" if reference.planar else "se3", matched))
        driven = distance_driven(run.world_T_imu)
        colour = colours(runs)[name]
        axes.plot(
            driven[np.searchsorted(run.frame, errors.frame)],
            np.linalg.norm(errors.position_error, axis=1),
            ".-",
            ms=2,
            lw=0.8,
            color=colour,
            label=name,
        )
        if np.isfinite(run.pose_cov_causal).any() and run.dof.sum() > 0:
            spread = 3.0 * np.sqrt(np.linalg.eigvalsh(run.pose_cov_causal[:, 3:, 3:])[:, -1])
            axes.plot(driven, spread, "--", lw=0.9, alpha=0.8, color=colour)
    axes.set(xlabel="distance driven [m]", ylabel=f"position error to {reference.name} [m]")
    axes.set(yscale="log", ylim=(_SMALLEST_ERROR, None))
    axes.set_title("dashed: three standard deviations from the start, as claimed at the time", fontsize=9)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def nis_over_time(runs: Mapping[str, Run]) -> Figure:
    """Normalised innovation squared per degree of freedom, with its 95 % interval under the model."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    for name, run in runs.items():
        if run.dof.sum() == 0:
            continue
        window = np.ones(min(_SMOOTHING, len(run.dof)))
        dof = np.convolve(run.dof, window, mode="same")
        nis = np.convolve(run.nis, window, mode="same") / np.maximum(dof, 1.0)
        axes.plot(run.stamp, nis, lw=1, color=colours(runs)[name], label=f"{name}, {_SMOOTHING} frames")
        low, high = (chi2.ppf(share, np.maximum(dof, 1.0)) / np.maximum(dof, 1.0) for share in (0.025, 0.975))
        first = not axes.collections
        label = "95 % interval of a consistent filter" if first else None
        axes.fill_between(run.stamp, low, high, color="0.8", lw=0, label=label)
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(xlabel="time [s]", ylabel="NIS per degree of freedom", ylim=(0, None))
    axes.legend(loc="best", fontsize=8)
    return figure


def step_time(runs: Mapping[str, Run]) -> Figure:
    """Time of each step."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    for name, run in runs.items():
        axes.semilogy(1e3 * run.step_time, lw=0.6, color=colours(runs)[name], label=name)
    axes.set(xlabel="frame", ylabel="step time [ms]")
    axes.legend(loc="best", fontsize=8)
    return figure
