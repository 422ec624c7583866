"""Fixed-lag smoothed poses, scored lag by lag, from the filter to the smoother.

At lag 0 each pose is the filtered one; at the last lag it is what all data say. A frame that the drive ends
before its lag counts with what is known at the end, so that every lag is of the same frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.core.trajectory import Poses
from vislam.evaluation import normalised
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.held_out import HeldOut, score
from vislam.evaluation.rpe import displacement_by_time, rpe_by_time
from vislam.evaluation.statistics import Statistic
from vislam.evaluation.trajectory import ate
from vislam.evaluation.trajectory_scores import headline_alignment

_FEWEST = 3
"""Matched frames without which nothing is said."""
_RELATIVE_S = 1.0
"""Duration of the segments of relative errors, as in the keys [s]."""
_BUYS = 0.01
"""Share of an error that smoothing has to take away for there to be half of it."""


@dataclass(frozen=True)
class LagScores:
    """The poses of a run at one lag.

    Attributes
    ----------
    frames : int or None
        The lag; None for all data.
    seconds : float or None
        The same in time, by the median time between frames [s].
    errors : mapping of str to float
        By the key of the metric.
    nees : Statistic or None
        None where nothing is claimed, or there is no reference.
    """

    frames: int | None
    seconds: float | None
    errors: Mapping[str, float]
    nees: Statistic | None

    @property
    def label(self) -> str:
        """The lag as it stands in keys: a number of frames, or ``all``."""
        return "all" if self.frames is None else str(self.frames)

    @property
    def values(self) -> dict[str, float]:
        """Errors and the average NEES, by the key of the metric."""
        return dict(self.errors) | ({} if self.nees is None else {self.nees.name: self.nees.value})

    def record(self) -> dict[str, object]:
        """Plain data for JSON."""
        found: dict[str, object] = {"frames": self.frames, "seconds": self.seconds, **self.errors}
        if self.nees is not None:
            low, high = self.nees.interval(0.95)
            found["nees"] = {**asdict(self.nees), "low_95": low, "high_95": high}
        return found


def score_lags(run: Run, record: Record) -> list[LagScores]:
    """Score the lags of a levelled run, the shortest first; none where they were not asked for."""
    if run.lagged is None or len(run.stamp) < _FEWEST:
        return []
    period = float(np.median(np.diff(run.stamp)))
    found = []
    for lag, poses in run.lagged:
        every = lag >= len(run.stamp) - 1
        alone = replace(run, filtered=poses, smoothed=None, lagged=None)
        errors = dict(_errors(alone, poses, record))
        nees = None if record.reference is None else _nees(alone, record.reference)
        found.append(LagScores(None if every else lag, None if every else period * lag, errors, nees))
    return found


def _errors(run: Run, poses: Poses, record: Record) -> Iterator[tuple[str, float]]:
    reference, held = record.reference, record.held_out
    if reference is not None:
        matched = associate(run.frame, run.stamp, poses.world_T_imu, reference)
        if len(matched.frame) >= _FEWEST:
            aligned = ate(matched, find_alignment(headline_alignment(matched.planar), matched))
            yield f"ate_{'planar_' if matched.planar else ''}rmse", aligned.position.rmse
            of_time = displacement_by_time if matched.pose is None else rpe_by_time
            relative = of_time(matched, _RELATIVE_S).translation
            if relative is not None:
                yield f"{'displacement' if matched.pose is None else 'rpe'}_1s_rmse", relative.rmse
    if len(held.track):
        found = score(HeldOut(held.frame, held.track, held.z, record.rig), poses.world_T_imu, frame=run.frame)
        if len(found.track):
            yield "held_out_median", found.median


def _nees(run: Run, reference: Reference) -> Statistic | None:
    if reference.pose is not None:
        found = normalised.pose_errors(run, reference)
        return None if found is None else found["pose"].statistic()
    planar = normalised.position_errors(
        run, reference, planar=reference.planar, reference_sigma=reference.sigma
    )
    return None if planar is None else planar.statistic()


@dataclass(frozen=True)
class Half:
    """Lag at which half of the gain by smoothing is reached.

    Attributes
    ----------
    seconds : float or None
        The lag, by straight lines between those that were read [s]; None: later than the longest of them.
    longest : float
        That one [s].
    filtered, smoothed : float
        The error without later data, and with all.
    """

    seconds: float | None
    longest: float
    filtered: float
    smoothed: float


def half_time(lags: Sequence[LagScores], key: str) -> Half | None:
    """Find when half of the gain has come; None where smoothing takes off next to nothing."""
    known = [(one.seconds, one.errors[key]) for one in lags if key in one.errors]
    if len(known) < 2 or known[0][0] != 0.0 or known[-1][0] is not None:
        return None
    first, last = known[0][1], known[-1][1]
    if not first - last > _BUYS * first:
        return None
    at = np.array([seconds for seconds, _ in known[:-1]], float)
    error = np.array([value for _, value in known[:-1]])
    place = _first_crossing(error, 0.5 * (first + last))
    seconds = None if place is None else float(np.interp(place, np.arange(len(at)), at))
    return Half(seconds, float(at[-1]), first, last)


def _first_crossing(error: Array, target: float) -> float | None:
    """Place at which errors ``(n,)`` are first at a target or below, between two of them; None if nowhere."""
    below = np.flatnonzero(error <= target)
    if not len(below):
        return None
    after = int(below[0])
    if after == 0:
        return 0.0
    before = error[after - 1]
    return after - 1 + float((before - target) / (before - error[after]))
