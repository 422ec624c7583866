"""Figures of a comparison: data in, Figure out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.core.run import ESTIMATES
from vislam.evaluation.trajectory import distance_driven
from vislam.report import consistency_figures, error_figures, limit_figures
from vislam.report.shown import Shown
from vislam.report.top_view import top_view

_SIZE = (7.2, 3.6)
"""Width and height of a figure of one panel [inch]."""
_SMALLEST_ERROR = 1e-2
"""Where the logarithmic axis of the error starts [m]; on a linear one dead reckoning flattens the rest."""
_SMOOTHING = 25
"""Frames over which the NIS is averaged."""


@dataclass(frozen=True)
class Drawing:
    """A figure with the words that go with it.

    Attributes
    ----------
    title, caption : str
    figure : Figure
    """

    title: str
    caption: str
    figure: Figure


def all_figures(shown: Shown) -> dict[str, Drawing]:
    """Every figure that can be drawn of a comparison, by file name."""
    blocks, found = shown.blocks(), {}
    for name, (draw, title, caption) in FIGURES.items():
        parts = {name: (title, shown)}
        if name in OF_AN_ESTIMATE:
            parts = {f"{name}_{one.estimate}": (f"{title}, {one.estimate}", one) for one in blocks}
        for file, (titled, part) in parts.items():
            figure = draw(part)
            if figure is not None:
                found[file] = Drawing(titled, caption, figure)
    return found


def figure_names() -> list[str]:
    """File names of all figures that there can be."""
    return [
        file
        for name in FIGURES
        for file in ([f"{name}_{one}" for one in ESTIMATES] if name in OF_AN_ESTIMATE else [name])
    ]


def height_attitude(shown: Shown) -> Figure:
    """Height, roll, pitch and yaw over time."""
    figure = Figure(figsize=(7.2, 6.8), layout="constrained")
    rows = figure.subplots(4, 1, sharex=True)
    reference = shown.reference
    for name, run in shown.runs.items():
        _height_attitude(
            rows, shown.time(run), run.final.world_T_imu, colour=shown.colour(name), label=shown.label(name)
        )
    if reference is not None and reference.pose is not None and np.allclose(reference.imu_T_point, np.eye(4)):
        stamp = shown.record.stamp[reference.frame] - shown.record.stamp[0]
        _height_attitude(rows, stamp, reference.pose, colour="black", label=reference.name)
    for axes, label in zip(rows, ("height [m]", "roll [deg]", "pitch [deg]", "yaw [deg]"), strict=True):
        axes.set_ylabel(label)
    rows[0].legend(loc="best", fontsize=8)
    rows[-1].set_xlabel("time [s]")
    return figure


def _height_attitude(rows: list[Axes], stamp: Array, pose: Array, *, colour: str, label: str) -> None:
    angles = Rotation.from_matrix(pose[:, :3, :3]).as_euler("xyz", degrees=True)
    angles[:, 2] = np.rad2deg(np.unwrap(np.deg2rad(angles[:, 2])))
    for axes, values in zip(rows, [pose[:, 2, 3], *angles.T], strict=True):
        axes.plot(stamp, values, lw=1, color=colour, label=literal(label))


def error_over_distance(shown: Shown) -> Figure | None:
    """Position error after alignment over the distance driven, with the estimated 3-sigma bound."""
    reference = shown.reference
    if reference is None:
        return None
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, run in shown.runs.items():
        found = shown.scores[name].trajectory
        if found is None:
            continue
        driven = distance_driven(run.final.world_T_imu)
        colour = shown.colour(name)
        axes.plot(
            driven[np.searchsorted(run.stamp, found.matched.stamp).clip(max=len(driven) - 1)],
            np.linalg.norm(found.headline.position_error, axis=1),
            ".-",
            ms=2,
            lw=0.8,
            color=colour,
            label=literal(name),
        )
        cov = run.final.covariances
        if np.isfinite(cov).any() and run.innovations.dof.sum() > 0:
            spread = 3.0 * np.sqrt(np.linalg.eigvalsh(cov[:, 3:, 3:])[:, -1])
            axes.plot(driven, spread, "--", lw=0.9, alpha=0.8, color=colour)
    axes.set(xlabel="distance driven [m]", ylabel=literal(f"position error to {reference.name} [m]"))
    axes.set(yscale="log", ylim=(_SMALLEST_ERROR, None))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def nis_over_time(shown: Shown) -> Figure | None:
    """Normalised innovation squared per degree of freedom, with its 95 % interval under the model."""
    if not any(run.innovations.dof.sum() > 0 for run in shown.runs.values()):
        return None
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots()
    for name, run in shown.runs.items():
        found = run.innovations
        if found.dof.sum() == 0:
            continue
        window = np.ones(min(_SMOOTHING, len(found.dof)))
        dof = np.convolve(found.dof, window, mode="same")
        nis = np.convolve(found.nis, window, mode="same") / np.maximum(dof, 1.0)
        axes.plot(
            shown.time(run),
            nis,
            lw=1,
            color=shown.colour(name),
            label=literal(f"{name}, {_SMOOTHING} frames"),
        )
        low, high = (chi2.ppf(share, np.maximum(dof, 1.0)) / np.maximum(dof, 1.0) for share in (0.025, 0.975))
        first = not axes.collections
        label = "95 % interval of a consistent filter" if first else None
        axes.fill_between(shown.time(run), low, high, color="0.8", lw=0, label=label)
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(xlabel="time [s]", ylabel="NIS per degree of freedom", ylim=(0, None))
    axes.legend(loc="best", fontsize=8)
    return figure


def step_time(shown: Shown) -> Figure | None:
    """Time of each step; None where nobody knows it."""
    if not any(len(run.cost.step_time) for run in shown.runs.values()):
        return None
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots()
    for name, run in shown.runs.items():
        if len(run.cost.step_time):
            axes.semilogy(1e3 * run.cost.step_time, lw=0.6, color=shown.colour(name), label=literal(name))
    axes.set(xlabel="frame", ylabel="step time [ms]")
    axes.legend(loc="best", fontsize=8)
    return figure


OF_AN_ESTIMATE = ("error", "bands", "nees", "coverage", "bound", "segments", "distances", "parting", "cost")
"""Figures that hold runs against each other, and so are drawn of the filtered and of the smoothed apart."""
FIGURES: dict[str, tuple[Callable[[Shown], Figure | None], str, str]] = {
    "top_view": (
        top_view,
        "From above",
        "Trajectories, and the map of each estimator, from above. Each is aligned to the reference by a "
        "rotation about the vertical and a shift; without a reference all start at the same pose.",
    ),
    "error": (
        error_over_distance,
        "Position error",
        "Position error after rigid alignment over the distance travelled. Dashed: three estimated standard "
        "deviations since the start.",
    ),
    "height_attitude": (height_attitude, "Height and attitude", "Height, roll, pitch and yaw over time."),
    "nis": (
        nis_over_time,
        "Innovations",
        "Normalised innovation squared per degree of freedom: above 1 the stated noise is too small, "
        "below 1 too large.",
    ),
    "whiteness": (
        consistency_figures.whiteness,
        "Whiteness",
        "Autocorrelation of the NIS: bars beyond the grey band show correlated innovations, whose effective "
        "number is smaller.",
    ),
    "bands": (
        consistency_figures.bands,
        "Errors and three sigma",
        "Each component of the error, and three estimated standard deviations. Worlds are joined as the "
        "metrics state.",
    ),
    "nees": (
        consistency_figures.nees,
        "Consistency",
        "NEES per degree of freedom: above the grey band an estimate is overconfident.",
    ),
    "coverage": (
        consistency_figures.coverage,
        "Coverage",
        "Share of the errors within the estimated bounds, against the nominal share: below the diagonal an "
        "estimate is overconfident.",
    ),
    "bound": (
        limit_figures.bound,
        "Errors and the bound",
        "Length of the errors of rotation and position since the first frame, and the least root mean square "
        "that any estimator can have over many sequences. On a single one chance decides on which side a "
        "line lies.",
    ),
    "lag_curve": (
        limit_figures.lag_curve,
        "What waiting buys",
        "Each metric of the poses as known some time later, from the filtered ones at 0 to the smoothed ones "
        "of all data.",
    ),
    "segments": (
        error_figures.segment_errors,
        "Errors of segments",
        "Translation error over segments of the trajectory: quartiles, and 5 to 95 %. Against a reference "
        "without attitudes, errors of displacements in the plane.",
    ),
    "distances": (
        consistency_figures.distances,
        "Distance by their own covariances",
        "Squared Mahalanobis distance of each two estimates by the sum of their covariances, with no "
        "reference involved. Dotted: from there on they are inconsistent with each other.",
    ),
    "parting": (
        consistency_figures.parting,
        "Divergence of the estimates",
        "Paths and three-sigma ellipses about the frame from which two estimates are inconsistent, both "
        "started at the same pose.",
    ),
    "ladder": (error_figures.ladder, "Ablation chain", "Error of each step."),
    "step_time": (step_time, "Time of each step", "Time that each frame took, on a logarithmic axis."),
    "cost": (
        error_figures.accuracy_against_time,
        "Accuracy against time",
        "Error against time of each estimator: nearer to the lower left is better.",
    ),
}
"""What draws each figure (None where the results do not have it), its title and its caption."""
