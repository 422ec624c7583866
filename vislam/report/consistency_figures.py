"""Figures of consistency: errors against covariances, and estimates against each other."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from vislam.base.distributions import chi2_quantile
from vislam.base.legible import literal
from vislam.core.run import Run
from vislam.evaluation.metric import of_beside, of_statistic
from vislam.evaluation.normalised import COMPONENTS, PROBABILITIES, Normalised
from vislam.evaluation.statistics import LAGS
from vislam.report.canvas import TIME, band, legend, logarithmic, new_figure, panels
from vislam.report.colours import COLOURS
from vislam.report.shown import Shown
from vislam.report.time_figures import three_sigma_band

_MAIN = ("nees_pose", "nees_position_planar", "nees_position_aligned")
"""Statistics of which the first that a run has is drawn over time."""
_ELLIPSES = 9
"""Frames about the divergence of two runs at which their ellipses are drawn."""
_REACH = 60
"""Frames before and after it that are shown."""
_SIGMAS = 3.0
_LOWEST = 1e-3
"""Where logarithmic axes of squared errors begin."""


def main_claims(shown: Shown) -> dict[str, Normalised]:
    """The normalised errors that stand for each run's consistency, where it has any."""
    found = {}
    for name in shown.seeing():
        one = shown.scores[name]
        claim = next((one.claims[key] for key in _MAIN if key in one.claims), None)
        if claim is not None:
            found[name] = claim
    return found


def considered_claims(shown: Shown) -> dict[str, Normalised]:
    """The same with the shared errors considered, of the runs that have considered them."""
    every = {name: shown.scores[name].claims for name in shown.runs}
    by_key = {name: of_beside(claim.name, "considered") for name, claim in main_claims(shown).items()}
    return {name: every[name][key] for name, key in by_key.items() if key in every[name]}


def _considered_line(axes: Axes, claims: Mapping[str, Normalised]) -> None:
    """Put what is drawn dashed into the legend, if anything is."""
    if claims:
        axes.plot([], [], color="k", lw=0.9, ls="--", label="shared errors considered")


def nees(shown: Shown) -> Figure | None:
    """Normalised squared error of each pose, per degree of freedom, with its 95 % interval."""
    claims = main_claims(shown)
    if not claims:
        return None
    figure, (axes,) = panels(1, 4.0)
    for name, claim in claims.items():
        values = np.maximum(claim.nees / claim.whitened.shape[1], _LOWEST)
        axes.plot(shown.time_at(claim.index), values, lw=0.9, color=shown.colour(name), label=literal(name))
    wider = considered_claims(shown)
    for name, claim in wider.items():
        values = np.maximum(claim.nees / claim.whitened.shape[1], _LOWEST)
        axes.plot(shown.time_at(claim.index), values, lw=0.9, ls="--", color=shown.colour(name))
    _considered_line(axes, wider)
    freedom = next(iter(claims.values())).whitened.shape[1]
    low, high = chi2_quantile([0.025, 0.975], freedom) / freedom
    axes.axhspan(low, high, color="0.8", lw=0, label="95 % interval of a consistent estimator")
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(xlabel=TIME, ylabel=_title(claims))
    logarithmic(axes)
    legend(figure, axes, columns=2)
    return figure


def _title(claims: Mapping[str, Normalised]) -> str:
    """Title of the statistic that is drawn of these runs, of which all have the same reference."""
    return of_statistic(next(iter(claims.values())).name).title


def bands(shown: Shown) -> Figure | None:
    """Each component of the error within three estimated standard deviations."""
    claims = main_claims(shown)
    if not claims:
        return None
    size = next(iter(claims.values())).error.shape[1]
    components = [("x", "m"), ("y", "m"), ("z", "m")][:size]
    if size == len(COMPONENTS):
        components = list(zip(COMPONENTS, ["deg"] * 3 + ["m"] * 3, strict=True))
    figure, rows = panels(size, 1.0 + 1.25 * size)
    wider = considered_claims(shown)
    for index, (axes, (component, unit)) in enumerate(zip(rows, components, strict=True)):
        scale = float(np.rad2deg(1.0)) if unit == "deg" else 1.0
        reach = 0.0
        for name, claim in claims.items():
            error, limit = scale * claim.error[:, index], _SIGMAS * scale * claim.sigma[:, index]
            time = shown.time_at(claim.index)
            axes.plot(time, error, lw=0.9, color=shown.colour(name), label=literal(name))
            band(axes, time, -limit, limit, color=shown.colour(name), alpha=0.18)
            reach = max(reach, 1.5 * float(np.abs(error).max()))
        for name, claim in wider.items():
            limit = _SIGMAS * scale * claim.sigma[:, index]
            for side in (-limit, limit):
                axes.plot(shown.time_at(claim.index), side, lw=0.9, ls="--", color=shown.colour(name))
        axes.set_ylabel(f"{component} [{unit}]")
        if reach > 0.0:
            axes.set_ylim(-reach, reach)
    three_sigma_band(rows[0])
    _considered_line(rows[0], wider)
    rows[-1].set_xlabel(TIME)
    legend(figure, rows[0])
    return figure


def coverage(shown: Shown) -> Figure | None:
    """Share of the errors within the estimated bounds, against the nominal share."""
    claims = main_claims(shown)
    if not claims:
        return None
    figure = new_figure(4.6)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="k", lw=0.6, label="nominal")
    for name, claim in claims.items():
        axes.plot(PROBABILITIES, claim.coverage_curve(), color=shown.colour(name), label=literal(name))
    wider = considered_claims(shown)
    for name, claim in wider.items():
        axes.plot(PROBABILITIES, claim.coverage_curve(), ls="--", color=shown.colour(name))
    _considered_line(axes, wider)
    axes.set(xlabel="nominal share", ylabel="share of the errors", xlim=(0, 1), ylim=(0, 1.02))
    axes.set_aspect("equal")
    legend(figure, axes)
    return figure


def whiteness(shown: Shown) -> Figure | None:
    """Autocorrelation of the NIS over the first lags, with the band of a white sequence."""
    found = {name: shown.evaluation.scores[name].whiteness for name in shown.runs}
    there = {name: one for name, one in found.items() if one is not None}
    if not there:
        return None
    figure = new_figure(3.6)
    axes = figure.subplots()
    width = 0.8 / len(there)
    for index, (name, one) in enumerate(there.items()):
        at = one.lag - 0.4 + (index + 0.5) * width
        axes.bar(at, one.autocorrelation, width=width, color=shown.colour(name), label=literal(name))
        axes.axhspan(-one.band, one.band, color="0.8", lw=0, zorder=0)
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set(
        xlabel="lag [frames]",
        ylabel="autocorrelation of the NIS",
        xlim=(0.4, LAGS + 0.6),
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend(figure, axes)
    return figure


def distances(shown: Shown) -> Figure | None:
    """Squared Mahalanobis distance of each pair's poses, per degree of freedom, with where they part."""
    pairs = shown.agreements()
    if not pairs:
        return None
    figure, (axes,) = panels(1, 4.2)
    for index, (pair, found) in enumerate(pairs.items()):
        label, colour = " and ".join(pair), COLOURS[index % len(COLOURS)]
        squared = np.maximum(found.squared / 6.0, _LOWEST)
        axes.plot(shown.time_at(found.frame), squared, lw=0.9, color=colour, label=literal(label))
        frame = found.divergence()
        if frame is not None:
            axes.axvline(float(shown.time_at(np.array(frame))), color=colour, lw=0.9, ls=":")
    axes.axhline(float(chi2_quantile(0.95, 6)) / 6.0, color="k", lw=0.8, ls="--", label="95 % bound")
    axes.set(xlabel=TIME, ylabel="squared distance per degree of freedom")
    logarithmic(axes)
    legend(figure, axes, columns=2)
    return figure


def divergence(shown: Shown) -> Figure | None:
    """Paths and 3-sigma ellipses of the runs about where they part, a panel a pair; None if none do."""
    parted = {
        pair: frame for pair, one in shown.agreements().items() if (frame := one.divergence()) is not None
    }
    if not parted:
        return None
    columns = min(len(parted), 2)
    lines = -(-len(parted) // columns)
    figure = new_figure(0.4 + 3.2 * lines)
    cells = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, (pair, frame) in zip(cells, parted.items(), strict=False):
        for name in pair:
            _ellipses(axes, shown.runs[name], frame, colour=shown.colour(name))
        axes.set_title(literal(f"{pair[0]} and {pair[1]}: frame {frame}"), fontsize=9)
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="datalim")
    for axes in cells[len(parted) :]:
        axes.set_axis_off()
    legend(figure, *cells)
    return figure


def _ellipses(axes: Axes, run: Run, frame: int, *, colour: str) -> None:
    """Path and ellipses of a run about a frame, in its own world joined at the first pose."""
    position = (
        run.final.world_T_imu[:, :3, :3].transpose(0, 2, 1)[0]
        @ (run.final.world_T_imu[:, :3, 3] - run.final.world_T_imu[0, :3, 3]).T
    )
    near = np.flatnonzero(np.abs(run.frame - frame) <= _REACH)
    axes.plot(*position[:2, near], color=colour, lw=1, label=literal(run.name))
    turn = run.final.world_T_imu[0, :3, :3].T @ run.final.world_T_imu[:, :3, :3]
    for row in near[np.linspace(0, len(near) - 1, min(_ELLIPSES, len(near))).astype(int)]:
        cov = (turn[row] @ run.final.covariances[row, 3:, 3:] @ turn[row].T)[:2, :2]
        if not np.isfinite(cov).all():
            continue
        size, axis = np.linalg.eigh(cov)
        width, height = 2.0 * _SIGMAS * np.sqrt(np.maximum(size, 0.0))
        angle = float(np.rad2deg(np.arctan2(axis[1, 0], axis[0, 0])))
        x, y = position[:2, row]
        axes.add_patch(Ellipse((x, y), width, height, angle=angle, fill=False, color=colour, lw=0.9))
