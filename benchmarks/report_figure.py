"""Figure of :mod:`benchmarks.report_pipeline`: the report's runs from above, ours beside them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.geometry import se3
from vislam.report.placement import reference_T_world

_MARGIN = 0.2
"""Room around the reference, as a share of its length."""


@dataclass(frozen=True)
class Panel:
    """A run from above.

    Attributes
    ----------
    title : str
    path, points : (T, 2), (m, 2)
        Path and landmarks [m].
    beneath : (T, 2) or None
        Path of dead reckoning [m].
    reference : (k, 2) or None
        Positions of the reference [m].
    """

    title: str
    path: Array
    points: Array
    beneath: Array | None
    reference: Array | None

    @classmethod
    def of(cls, run: Run, reference: Reference | None, *, beneath: Run | None, title: str) -> "Panel":
        """Lay levelled runs on the reference, turned and moved in the plane only."""
        path, points = _laid(run, reference)
        return cls(
            title,
            path,
            points,
            None if beneath is None else _laid(beneath, reference)[0],
            None if reference is None else reference.position[:, :2],
        )


def beside(pairs: Sequence[tuple[Panel, Panel]]) -> Figure:
    """Draw a column for each pair: the report's above, ours below."""
    figure = Figure(figsize=(2.7 * len(pairs), 7.0), layout="constrained")
    for column, pair in zip(figure.subplots(2, len(pairs), squeeze=False).T, pairs, strict=True):
        for axes, panel in zip(column, pair, strict=True):
            _draw(axes, panel)
    handles, labels = _keys(figure)
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _draw(axes: Axes, panel: Panel) -> None:
    axes.plot(*panel.points.T, ".", ms=1.0, color="0.6", label="landmarks", rasterized=True)
    if panel.beneath is not None:
        # The report's colours: green for dead reckoning, red for SLAM.
        axes.plot(*panel.beneath.T, color="#009E73", lw=1.0, label="dead reckoning")
        axes.plot(*panel.path.T, color="#D55E00", lw=1.2, label="estimate")
    else:
        axes.plot(*panel.path.T, color="#009E73", lw=1.2, label="dead reckoning")
    shown = panel.path if panel.reference is None else panel.reference
    if panel.reference is not None:
        axes.plot(*panel.reference.T, "k.", ms=2.0, label="reference")
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set_title(panel.title, fontsize=8)
    axes.tick_params(labelsize=6)


def _keys(figure: Figure) -> tuple[list[Artist], list[str]]:
    """Each thing that is drawn, once."""
    found: dict[str, Artist] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    return list(found.values()), list(found)


def _laid(run: Run, reference: Reference | None) -> tuple[Array, Array]:
    moved, point = np.eye(4), np.eye(4)
    if reference is not None:
        laid = reference_T_world(run, reference, planar=True)
        moved, point = (np.eye(4) if laid is None else laid), reference.imu_T_point
    path = (moved @ run.world_T_imu @ point)[:, :2, 3]
    return path, se3.transform(moved, run.points_world)[:, :2]
