"""Figures of what runs claim of themselves: against a reference, and against each other."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from vislam.evaluation.evaluate import Evaluation
from vislam.evaluation.normalised import PROBABILITIES, Normalised
from vislam.evaluation.scores import RunScores
from vislam.evaluation.statistics import LAGS
from vislam.report.figures import colours
from vislam.run import Run

_MAIN = ("nees_pose", "nees_position_planar")
"""Statistics of which the first that a run has is drawn over time."""
_ELLIPSES = 9
"""Frames about the parting of two runs at which their ellipses are drawn."""
_REACH = 60
"""Frames before and after it that are shown."""
_SIGMAS = 3.0
_LOWEST = 1e-3
"""Where logarithmic axes of squared errors begin."""


def main_claims(scores: Mapping[str, RunScores]) -> dict[str, Normalised]:
    """The errors beside claims that stand for each run's consistency, for those that have any."""
    found = {}
    for name, one in scores.items():
        claim = next((one.claims[key] for key in _MAIN if key in one.claims), None)
        if claim is not None:
            found[name] = claim
    return found


def nees(scores: Mapping[str, RunScores]) -> Figure:
    """Normalised squared error of each pose, per degree of freedom, with its 95 % interval."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    claims = main_claims(scores)
    for name, claim in claims.items():
        values = np.maximum(claim.nees / claim.whitened.shape[1], _LOWEST)
        axes.plot(claim.index, values, lw=0.9, color=colours(scores)[name], label=name)
    freedom = next(iter(claims.values())).whitened.shape[1]
    low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
    axes.axhspan(low, high, color="0.8", lw=0, label="95 % interval of a consistent estimator")
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(xlabel="frame", ylabel="NEES per degree of freedom", yscale="log")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def coverage(scores: Mapping[str, RunScores]) -> Figure:
    """Share of the errors within what was claimed, against the share that was claimed."""
    figure = Figure(figsize=(5.5, 5), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="k", lw=0.6, label="as claimed")
    for name, claim in main_claims(scores).items():
        axes.plot(PROBABILITIES, claim.coverage_curve(), color=colours(scores)[name], label=name)
    axes.set(xlabel="claimed share", ylabel="share of the errors", xlim=(0, 1), ylim=(0, 1.02))
    axes.set_aspect("equal")
    axes.legend(loc="best", fontsize=8)
    return figure


def whiteness(scores: Mapping[str, RunScores]) -> Figure:
    """Autocorrelation of the NIS over the first lags, with the band of a white sequence."""
    figure = Figure(figsize=(9, 3.5), layout="constrained")
    axes = figure.subplots()
    shown = {name: one.whiteness for name, one in scores.items() if one.whiteness is not None}
    width = 0.8 / max(len(shown), 1)
    for index, (name, found) in enumerate(shown.items()):
        at = found.lag - 0.4 + (index + 0.5) * width
        axes.bar(at, found.autocorrelation, width=width, color=colours(scores)[name], label=name)
        axes.axhspan(-found.band, found.band, color="0.8", lw=0, zorder=0)
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set(xlabel="lag [frames]", ylabel="autocorrelation of the NIS", xlim=(0.4, LAGS + 0.6))
    axes.legend(loc="best", fontsize=8)
    return figure


def distances(evaluation: Evaluation) -> Figure:
    """Squared Mahalanobis distance of each pair's poses, per degree of freedom, with where they part."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    pairs = {pair: one.agreement for pair, one in evaluation.pairs.items() if one.agreement is not None}
    colour = colours(" and ".join(pair) for pair in pairs)
    for pair, found in pairs.items():
        label = " and ".join(pair)
        squared = np.maximum(found.squared / 6.0, _LOWEST)
        axes.plot(found.frame, squared, lw=0.9, color=colour[label], label=label)
        frame = found.parting()
        if frame is not None:
            axes.axvline(frame, color=colour[label], lw=0.9, ls=":")
    axes.axhline(chi2.ppf(0.95, 6) / 6.0, color="k", lw=0.8, ls="--", label="95 % bound")
    axes.set(xlabel="frame", ylabel="squared distance per degree of freedom", yscale="log")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def parting(evaluation: Evaluation) -> Figure | None:
    """Paths and 3-sigma ellipses of the runs about where they part, a panel a pair; None if none do."""
    parted = {
        pair: frame
        for pair, one in evaluation.pairs.items()
        if one.agreement is not None and (frame := one.agreement.parting()) is not None
    }
    if not parted:
        return None
    columns = min(len(parted), 3)
    lines = -(-len(parted) // columns)
    figure = Figure(figsize=(9, 9 / columns * lines), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    colour = colours(evaluation.scores)
    for axes, (pair, frame) in zip(panels, parted.items(), strict=False):
        for name in pair:
            _ellipses(axes, evaluation.scores[name].run, frame, colour=colour[name])
        axes.set_title(f"{pair[0]} and {pair[1]}: frame {frame}", fontsize=9)
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="best", fontsize=7)
    for axes in panels[len(parted) :]:
        axes.set_axis_off()
    return figure


def _ellipses(axes: Axes, run: Run, frame: int, *, colour: str) -> None:
    """Path and ellipses of a run about a frame, in its own world joined at the first pose."""
    position = (
        run.world_T_imu[:, :3, :3].transpose(0, 2, 1)[0]
        @ (run.world_T_imu[:, :3, 3] - run.world_T_imu[0, :3, 3]).T
    )
    near = np.flatnonzero(np.abs(run.frame - frame) <= _REACH)
    axes.plot(*position[:2, near], color=colour, lw=1, label=run.name)
    turn = run.world_T_imu[0, :3, :3].T @ run.world_T_imu[:, :3, :3]
    for row in near[np.linspace(0, len(near) - 1, min(_ELLIPSES, len(near))).astype(int)]:
        cov = (turn[row] @ run.pose_cov[row, 3:, 3:] @ turn[row].T)[:2, :2]
        if not np.isfinite(cov).all():
            continue
        size, axis = np.linalg.eigh(cov)
        width, height = 2.0 * _SIGMAS * np.sqrt(np.maximum(size, 0.0))
        angle = float(np.rad2deg(np.arctan2(axis[1, 0], axis[0, 0])))
        x, y = position[:2, row]
        axes.add_patch(Ellipse((x, y), width, height, angle=angle, fill=False, color=colour, lw=0.9))
