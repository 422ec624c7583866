"""Top view: all trajectories, and the map of each estimator by its estimated uncertainty."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure

from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.core.run import Run
from vislam.geometry import se3
from vislam.report.shown import Shown

_WIDTH = 7.2
"""Width of the figure [inch]."""
_COLOUR_MAP = ListedColormap(colormaps["cividis"](np.linspace(0.0, 0.85, 256)), name="cividis_on_paper")
"""Cividis without the yellows that cannot be seen on white paper."""
_SIGMA_SHARES = (0.02, 0.98)
"""Quantiles of the landmarks' uncertainty at which the colours end."""


def top_view(shown: Shown) -> Figure:
    """All the paths in one panel; then a panel a map, its landmarks coloured by their uncertainty."""
    mapped = {name: run for name, run in shown.runs.items() if len(run.landmarks)}
    low, high = _limits(shown)
    wanted = 1 + len(mapped)
    columns = wanted if wanted <= 3 else 2 if wanted == 4 else 3
    rows = -(-wanted // columns)
    tall = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.35, 1.25))
    size = (_WIDTH, 1.2 + rows * (0.25 + tall * (_WIDTH - 0.9) / columns))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    first, *others = panels.flat
    _paths(first, shown)
    first.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    coloured = _maps(others, shown, mapped)
    for axes in others[len(mapped) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]")
    for column in panels.T:
        [axes for axes in column if axes.axison][-1].set_xlabel("x [m]")
        [axes for axes in column if axes.axison][-1].tick_params(labelbottom=True)
    for axes in (first, *others):
        axes.set_aspect("equal")
    if coloured is not None:
        bar = figure.colorbar(coloured, ax=panels, location="bottom", shrink=0.6, aspect=40, pad=0.01)
        bar.set_label("uncertainty of a landmark: largest standard deviation [m]", fontsize=8)
        assert bar.solids is not None
        bar.solids.set(alpha=1.0, rasterized=True)
    first.legend(loc="best", fontsize=7)
    return figure


def _limits(shown: Shown) -> tuple[Array, Array]:
    """Corners ``(2,)`` of what is shown [m]: the reference, or else the paths, with a margin."""
    if shown.reference is not None:
        points = shown.reference.position[:, :2]
    else:
        points = np.concatenate(
            [run.final.world_T_imu[:, :2, 3] for run in shown.runs.values()] or [np.eye(2)]
        )
    low, high = points.min(axis=0), points.max(axis=0)
    # The shorter side is given something as well: a straight path would be a line.
    margin = 0.12 * float((high - low).max()) + 5.0
    return low - margin, high + margin


def _path(shown: Shown, name: str) -> Array:
    """Path from above ``(T, 2)`` [m]."""
    moved = shown.drawn_T_world(name, planar=True)
    return se3.transform(moved, shown.positions(shown.runs[name].final.world_T_imu))[:, :2]


def _paths(axes: Axes, shown: Shown) -> None:
    axes.set_title("all paths", fontsize=9)
    for name in shown.runs:
        axes.plot(*_path(shown, name).T, color=shown.colour(name), lw=1.2, label=literal(shown.label(name)))
    if shown.reference is not None:
        axes.plot(*shown.reference.position[:, :2].T, "k.", ms=2, label=literal(shown.reference.name))


def _maps(panels: list[Axes], shown: Shown, mapped: dict[str, Run]) -> PathCollection | None:
    sigma = {
        name: np.sqrt(np.linalg.eigvalsh(cov)[:, -1])
        for name, run in mapped.items()
        if (cov := run.landmarks.points_cov) is not None
    }
    coloured = None
    if sigma:
        ends = np.quantile(np.concatenate(list(sigma.values())), _SIGMA_SHARES)
        norm = LogNorm(*np.maximum(ends, 1e-6))
    for axes, (name, run) in zip(panels, mapped.items(), strict=False):
        points = se3.transform(shown.drawn_T_world(name, planar=True), run.landmarks.points_world)[:, :2]
        if name in sigma:
            # The least certain first, so that they do not hide the others.
            order = np.argsort(-sigma[name])
            x, y = points[order].T
            coloured = axes.scatter(x, y, s=1.5, lw=0, c=sigma[name][order], cmap=_COLOUR_MAP, norm=norm)
            coloured.set_rasterized(True)
        else:
            axes.plot(*points.T, ".", ms=1.2, color="0.5", rasterized=True)
        axes.plot(*_path(shown, name).T, color=shown.colour(name), lw=1.0)
        covariances = "" if name in sigma else " (no covariances)"
        axes.set_title(literal(f"map of {name}{covariances}"), fontsize=9)
    return coloured
