"""The figures of a comparison by name: data in, Figure out."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from matplotlib.figure import Figure

from vislam.core.run import ESTIMATES
from vislam.report import consistency_figures, error_figures, images, limit_figures, time_figures
from vislam.report.shown import Shown
from vislam.report.svg import plain_svg
from vislam.report.top_view import error_paths, top_view


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

    @cached_property
    def svg(self) -> str:
        """The figure as an element, drawn once for the page and for its file."""
        return plain_svg(self.figure)


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


OF_AN_ESTIMATE = (
    "error_path",
    "error",
    "components",
    "relative",
    "bands",
    "nees",
    "coverage",
    "bound",
    "segments",
    "distances",
    "divergence",
    "cost",
)
"""Figures that hold runs against each other, and so are drawn of the filtered and of the smoothed apart."""
FIGURES: dict[str, tuple[Callable[[Shown], Figure | None], str, str]] = {
    "top_view": (
        top_view,
        "From above",
        "Trajectories, and the map of each estimator, from above. Each is aligned to the reference by a "
        "rotation about the vertical and a shift; without a reference all start at the same pose.",
    ),
    "error_path": (
        error_paths,
        "Where each errs",
        "Path of each estimator from above, coloured by its position error where there is a reference.",
    ),
    "error": (
        time_figures.error,
        "Position error",
        "Position error after rigid alignment. Dashed: three estimated standard deviations since the start.",
    ),
    "components": (
        time_figures.components,
        "Position error by axis",
        "Estimate less reference after rigid alignment, along the axes of the reference. A run that sees no "
        "landmark does not set the scale; how far it leaves the frame is written in it.",
    ),
    "relative": (
        time_figures.relative,
        "Relative errors",
        "Relative errors of segments, each drawn where it begins. Against a reference without attitudes, "
        "errors of displacements in the plane.",
    ),
    "height_attitude": (
        time_figures.height_attitude,
        "Height and attitude",
        "Height, roll, pitch and yaw. A run that sees no landmark does not set the scale; how far it leaves "
        "the frame is written in it.",
    ),
    "observations": (
        time_figures.observations,
        "Observations",
        "Observations of each frame that were fused, of those left by the repairs (grey), and those "
        "that were not: rejected by the estimator, or not on the common list.",
    ),
    "disparities": (
        images.disparities,
        "Disparities",
        "Observations by their disparity: those left by the repairs (grey), and those that each run fused.",
    ),
    "nis": (
        time_figures.nis,
        "Innovations",
        "Normalised innovation squared per degree of freedom, over 25 frames: above 1 the stated noise is "
        "too small, below 1 too large.",
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
    "divergence": (
        consistency_figures.divergence,
        "Divergence of the estimates",
        "Paths and three-sigma ellipses about the frame from which two estimates are inconsistent, both "
        "started at the same pose.",
    ),
    "ablation_chain": (error_figures.ablation_chain, "Ablation chain", "Error of each step."),
    "step_time": (
        time_figures.step_time,
        "Time of each step",
        "Time that each frame took, on a logarithmic axis.",
    ),
    "cost": (
        error_figures.accuracy_against_time,
        "Accuracy against time",
        "Error against time of each estimator: nearer to the lower left is better.",
    ),
}
"""What draws each figure (None where the results do not have it), its title and its caption."""
