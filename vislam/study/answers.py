"""What a study answers: failure rates, errors, overconfidence, paired differences.

Trials are independent of each other; the times within one are not. So a trial counts once, with its average,
however many frames it has.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, spearmanr, wilcoxon

from vislam.base.types import IntArray
from vislam.study.intervals import PROBABILITY, Estimate, bootstrap, positive_mean, share
from vislam.study.trials import Trials

NEES = "nees_pose"
"""Statistic that speaks for consistency; it needs a truth, which simulated trials have."""
_FREEDOM = 6
FEWEST_TRIALS = 6
"""Trials without which nothing is judged: of five, no signed-rank test can reach 0.05 (2 / 2^5)."""
COVERAGE = "coverage_pose_3sigma"
_FEWEST_RANKED = 2
"""Runs of which an order says nothing yet."""
CLAIMED = 0.9973
"""Share of the errors that three standard deviations of a normal distribution hold."""


@dataclass(frozen=True)
class PooledNees:
    """Consistency of an estimator over trials.

    Attributes
    ----------
    mean : Estimate
        Mean over trials of their NEES per degree of freedom; 1 is expected.
    beyond : Estimate
        Share of trials beyond :func:`trial_bound`; 0.05 at most is expected.
    """

    mean: Estimate
    beyond: Estimate

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds between which the mean of a consistent estimator lies with 95 % or more.

        Those of as many independent poses as there are trials (Bar-Shalom, Li and Kirubarajan, Estimation
        with Applications to Tracking and Navigation, 5.4.2). The average of a trial spreads no more than a
        pose, so they hold whatever the errors within a trial have in common; and of two means of as many
        trials, the larger is not spared where the smaller is accused.
        """
        freedom = _FREEDOM * self.mean.count
        tail = 0.5 * (1.0 - PROBABILITY)
        return float(chi2.ppf(tail, freedom)) / freedom, float(chi2.isf(tail, freedom)) / freedom

    @property
    def enough(self) -> bool:
        """Whether there are trials enough to judge by."""
        return self.mean.count >= FEWEST_TRIALS

    @property
    def overconfident(self) -> bool:
        """Whether the errors are larger than estimated."""
        return self.mean.value > self.bounds[1]

    @property
    def conservative(self) -> bool:
        """Whether they are smaller."""
        return self.mean.value < self.bounds[0]


@dataclass(frozen=True)
class Paired:
    """Two estimators on the same trials, by a metric of which less is better.

    Attributes
    ----------
    difference : Estimate
        Mean of the first less the second, with its bootstrap interval; below 0 the first is better.
    better : Estimate
        Share of the trials in which the first is better, a tie counting half.
    p_value : float
        Of Wilcoxon's signed-rank test (Biometrics Bulletin 1945): chance of as much if neither were better.
    """

    difference: Estimate
    better: Estimate
    p_value: float


def failure_rate(trials: Trials, name: str, *, rows: IntArray) -> Estimate | None:
    """Share of runs that did not finish, of the trials that were carried out; None if none was."""
    done = rows[trials.done[rows]]
    if not len(done):
        return None
    found = share(float(np.count_nonzero(~trials.complete[name][done])), len(done))
    return Estimate(found.value, found.low, found.high, len(done), len(rows) - len(done))


def mean(trials: Trials, name: str, key: str, *, rows: IntArray) -> Estimate | None:
    """Mean of a metric over the trials that have it."""
    return bootstrap(trials.value(name, key)[rows], np.mean)


def median(trials: Trials, name: str, key: str, *, rows: IntArray) -> Estimate | None:
    """Median of a metric over the trials that have it."""
    return bootstrap(trials.value(name, key)[rows], np.median)


def trial_bound() -> float:
    """Bound under which the NEES per degree of freedom of a consistent trial lies with 95 % or more.

    The bound of one pose: if the errors of a trial stay the same throughout, its average tells no more than
    that; if they change, the average lies closer to 1.
    """
    return float(chi2.ppf(0.95, _FREEDOM)) / _FREEDOM


def pooled_nees(trials: Trials, name: str, *, rows: IntArray) -> PooledNees | None:
    """Consistency over trials, from the average NEES of each; None if no trial has one."""
    values = trials.value(name, NEES)[rows]
    found = positive_mean(values)
    if found is None:
        return None
    return PooledNees(found, share(float(np.count_nonzero(values > trial_bound())), found.count))


def pooled_coverage(trials: Trials, name: str, *, rows: IntArray) -> Estimate | None:
    """Share of the errors within three estimated standard deviations, mean over trials."""
    return mean(trials, name, COVERAGE, rows=rows)


def paired(trials: Trials, one: str, other: str, key: str, *, rows: IntArray) -> Paired | None:
    """Compare two estimators on the trials that both finished; None if there is none."""
    difference = (trials.value(one, key) - trials.value(other, key))[rows]
    found = bootstrap(difference, np.mean)
    if found is None:
        return None
    known = difference[np.isfinite(difference)]
    hits = np.count_nonzero(known < 0.0) + 0.5 * np.count_nonzero(known == 0.0)
    # Differences of 0 tell nothing, and with nothing else the test has nothing to rank.
    p_value = float(wilcoxon(known).pvalue) if known.any() else 1.0
    return Paired(found, share(float(hits), len(known)), p_value)


def rank_correlation(trials: Trials, one: str, other: str) -> Estimate | None:
    """Spearman's rank correlation of two metrics over the runs of a seed, mean over the seeds.

    The runs of a seed, those of all points and estimators, are of one sequence, so that only their quality
    differs; None if no seed has three runs with both metrics that are not all the same.
    """
    found = []
    for seed in np.unique(trials.seed):
        rows = trials.seed == seed
        pair = np.array([[trials.value(name, key)[rows] for name in trials.complete] for key in (one, other)])
        first, second = pair.reshape(2, -1)[:, np.isfinite(pair).all(axis=0).reshape(-1)]
        if len(first) > _FEWEST_RANKED and np.ptp(first) > 0.0 and np.ptp(second) > 0.0:
            found.append(float(spearmanr(first, second).statistic))
    return bootstrap(np.array(found), np.mean)


def onset(found: Sequence[PooledNees | None]) -> int | None:
    """First of the points from which on an estimator is overconfident; None if there is none.

    Points where no trial finished tell nothing and are passed over.
    """
    first = None
    for place, nees in enumerate(found):
        if nees is None:
            continue
        if not nees.overconfident:
            first = None
        elif first is None:
            first = place
    return first
