"""Top view: all trajectories, the map of each estimator by its uncertainty, each trajectory by its error."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from vislam.base.legible import literal
from vislam.base.types import Array
from vislam.core.run import Run
from vislam.geometry import se3
from vislam.report.canvas import SMALL, WIDTH, PlainLog, legend, marks, new_figure
from vislam.report.decimation import evenly, one_a_cell
from vislam.report.shown import Shown

_COLOUR_MAP = ListedColormap(colormaps["cividis"](np.linspace(0.0, 0.85, 256)), name="cividis_on_paper")
"""Cividis without the yellows that cannot be seen on white paper."""
_ERROR_MAP = ListedColormap(colormaps["plasma"](np.linspace(0.0, 0.85, 256)), name="plasma_on_paper")
_SIGMA_SHARES = (0.02, 0.98)
"""Quantiles of the landmarks' uncertainty at which the colours end."""
_MOST_LANDMARKS = 20_000
"""Landmarks of a map that are drawn at most."""
_MOST_ERRORS = 4000
"""Errors of a path that are all drawn; of more, the largest at each place."""
_PLACES = 1000
"""Places that are told apart along a panel."""


def top_view(shown: Shown) -> Figure:
    """All the paths in one panel; then a panel a map, its landmarks coloured by their uncertainty.

    Runs that see no landmark do not set the scale: where one leaves the panel, another shows all of it.
    """
    mapped = {name: run for name, run in shown.runs.items() if len(run.landmarks)}
    low, high = _limits(shown)
    whole = _whole(shown, low, high)
    grid = _Grid(1 + len(mapped) + (whole is not None), low, high)
    first, *others = grid.cells
    _paths(first, shown)
    coloured = _maps(others, shown, mapped)
    if whole is not None:
        grid.set_apart(others[len(mapped)], *whole)
        _paths(others[len(mapped)], shown)
        others[len(mapped)].set_title("all paths, whole", fontsize=SMALL)
    grid.finish()
    if coloured is not None:
        grid.bar(coloured, "uncertainty of a landmark: largest standard deviation [m]")
    legend(grid.figure, first)
    return grid.figure


def error_paths(shown: Shown) -> Figure | None:
    """Path of each run, coloured by its position error on one scale; None without a reference."""
    found = {name: one.trajectory for name, one in shown.scores.items() if one.trajectory is not None}
    if not found:
        return None
    seeing = [found[name] for name in shown.seeing() if name in found] or list(found.values())
    sizes = np.concatenate([np.linalg.norm(one.headline.position_error, axis=1) for one in seeing])
    norm = Normalize(0.0, max(float(np.quantile(sizes, _SIGMA_SHARES[1])), 1e-6))
    low, high = _limits(shown)
    grid = _Grid(len(found), low, high)
    for axes, (name, one) in zip(grid.cells, found.items(), strict=False):
        run = shown.runs[name]
        row = np.searchsorted(run.stamp, one.matched.stamp).clip(max=len(run.stamp) - 1)
        path, size = _path(shown, name)[row], np.linalg.norm(one.headline.position_error, axis=1)
        if len(path) > _MOST_ERRORS:
            row = one_a_cell(path, float((high - low).max()) / _PLACES, rank=size)
            path, size = path[row], size[row]
        drawn = axes.scatter(path[:, 0], path[:, 1], s=10, lw=0, c=size, cmap=_ERROR_MAP, norm=norm)
        drawn.set_rasterized(True)
        axes.set_title(literal(f"{name}\nto {size.max():.3g} m"), fontsize=SMALL)
    grid.finish()
    grid.bar(drawn, "position error [m]")
    return grid.figure


class _Grid:
    """Panels of one extent, as many as are wanted, three beside each other at most.

    Attributes
    ----------
    figure : Figure
    cells : list of Axes
        Those that are wanted first.
    """

    def __init__(self, wanted: int, low: Array, high: Array) -> None:
        columns = wanted if wanted <= 2 else 2 if wanted == 4 else 3
        rows = -(-wanted // columns)
        tall = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.35, 1.25))
        self.figure = new_figure(1.2 + rows * (0.7 + tall * ((WIDTH - 0.3) / columns - 0.55)))
        self._panels = self.figure.subplots(rows, columns, squeeze=False)
        self.cells: list[Axes] = list(self._panels.flat)
        self._wanted = wanted
        for axes in self.cells:
            self.set_apart(axes, low, high)

    def set_apart(self, axes: Axes, low: Array, high: Array) -> None:
        """Give a panel an extent of its own."""
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")

    def finish(self) -> None:
        """Label the outer panels, and hide what is not used."""
        for axes in self.cells[self._wanted :]:
            axes.set_axis_off()
        for axes in self._panels[:, 0]:
            axes.set_ylabel("y [m]")
        for column in self._panels.T:
            [axes for axes in column if axes.axison][-1].set_xlabel("x [m]")
        for axes in self.cells:
            axes.xaxis.set_major_locator(MaxNLocator(4))
            axes.yaxis.set_major_locator(MaxNLocator(5))
            axes.tick_params(labelsize=SMALL)

    def bar(self, coloured: PathCollection, label: str) -> None:
        """Say below the panels what the colours mean."""
        bar = self.figure.colorbar(
            coloured, ax=self._panels, location="bottom", shrink=0.6, aspect=40, pad=0.01
        )
        bar.set_label(label, fontsize=SMALL)
        if isinstance(coloured.norm, LogNorm):
            bar.ax.xaxis.set_major_formatter(PlainLog())
            bar.ax.xaxis.set_minor_formatter(PlainLog(minor_thresholds=(1.0, 0.4)))
        bar.ax.tick_params(which="both", labelsize=SMALL)
        assert bar.solids is not None
        bar.solids.set(alpha=1.0, rasterized=True)


def _whole(shown: Shown, low: Array, high: Array) -> tuple[Array, Array] | None:
    """Corners of all paths; None where those that do not set the scale stay inside the others' corners."""
    leaving = [_path(shown, name) for name in shown.leaving()]
    if not leaving:
        return None
    points = np.concatenate([*leaving, [low, high]])
    every = points.min(axis=0), points.max(axis=0)
    inside = (every[0] >= low).all() and (every[1] <= high).all()
    return None if inside else every


def _limits(shown: Shown) -> tuple[Array, Array]:
    """Corners ``(2,)`` of what is shown [m]: the reference, or else the paths in scale, and a margin."""
    if shown.reference is not None:
        points = shown.reference.position[:, :2]
    else:
        points = np.concatenate([_path(shown, name) for name in shown.seeing()] or [np.eye(2)])
    low, high = points.min(axis=0), points.max(axis=0)
    # The shorter side is given something as well: a straight path would be a line.
    margin = 0.12 * float((high - low).max()) + 5.0
    return low - margin, high + margin


def _path(shown: Shown, name: str) -> Array:
    """Path from above ``(T, 2)`` [m]."""
    moved = shown.drawn_T_world(name, planar=True)
    return se3.transform(moved, shown.positions(shown.runs[name].final.world_T_imu))[:, :2]


def _paths(axes: Axes, shown: Shown) -> None:
    axes.set_title("all paths", fontsize=SMALL)
    for name in shown.runs:
        axes.plot(*_path(shown, name).T, color=shown.colour(name), lw=1.2, label=literal(shown.label(name)))
    if shown.reference is not None:
        marks(axes, shown.reference.position[:, :2], color="k", ms=2, label=literal(shown.reference.name))


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
        rows = evenly(len(points), _MOST_LANDMARKS)
        if name in sigma:
            # The least certain first, so that they do not hide the others.
            order = rows[np.argsort(-sigma[name][rows])]
            x, y = points[order].T
            coloured = axes.scatter(x, y, s=1.5, lw=0, c=sigma[name][order], cmap=_COLOUR_MAP, norm=norm)
            coloured.set_rasterized(True)
        else:
            axes.plot(*points[rows].T, ".", ms=1.2, color="0.5", rasterized=True)
        axes.plot(*_path(shown, name).T, color=shown.colour(name), lw=1.0)
        covariances = "" if name in sigma else " (no covariances)"
        part = f"\n{len(rows):,} of {len(points):,} landmarks" if len(rows) < len(points) else ""
        axes.set_title(literal(f"map of {name}{covariances}") + part, fontsize=SMALL)
    return coloured
