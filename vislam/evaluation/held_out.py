"""Trajectories scored, and compared, without any reference: by tracks that no estimator was given.

A share of the tracks is kept from all estimators. Afterwards each of them is triangulated from half of its
views at the estimated poses, and predicted in the other half. Poses that are right predict what was measured
there to within the noise.

What the score sees is the motion within the life of a track, a second or a few, and of that what moves points
across the line of sight: the turn, and the direction of the way. The length of the way it sees far less, and
not at all the drift that adds up from one track to the next: of two runs with equal steps and unequal ends it
prefers neither. It measures by the rig that it is given, so an error that a run shares with that rig goes
unseen. And it means nothing in pixels alone: noise of the tracker, slips and moving objects are in it, the
same for all runs, so only scores of the same tracks can be compared.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.sequence import Sequence
from vislam.models import StereoRig
from vislam.models.track_noise import SHARES
from vislam.models.triangulation import triangulate

FEWEST_VIEWS = 4
"""A track with fewer views than this is neither held out nor scored: two to triangulate, two to predict."""
CAP_PX = 10.0
"""RMS of a track that could not be triangulated, and the largest that any track counts with [px]."""
_CHUNK = 256
"""Tracks that are triangulated together."""
_BLOCK = 30
"""Frames in which tracks begin that share their luck: about the longest that a track lives."""
_MOST_BLOCKS = 250
"""In a long sequence blocks are longer, so that there are no more of them."""
_DRAWS = 10_000


@dataclass(frozen=True)
class HeldOut:
    """Observations that no estimator was given.

    Attributes
    ----------
    frame, track : (n,)
        Frame and track of each.
    z : (n, 3)
        Measurement (uL, uR, v) [px], repaired: no disparity is zero.
    rig : StereoRig
        What it was measured with.
    """

    frame: IntArray
    track: IntArray
    z: Array
    rig: StereoRig

    @classmethod
    def of(cls, sequence: Sequence, mask: BoolArray) -> "HeldOut":
        """Observations ``mask (n,)`` of a sequence."""
        return cls(sequence.frame_of[mask], sequence.track[mask], sequence.z[mask], sequence.rig)


@dataclass(frozen=True)
class HeldOutScore:
    """How well a trajectory predicts the tracks that it was not made from.

    Attributes
    ----------
    track, frame : (m,)
        The tracks with enough views, the same for every trajectory, and the frame each begins in.
    rms : (m,)
        Root mean square of the residuals of the predicted views, a pixel coordinate, ``CAP_PX`` at most [px].
    """

    track: IntArray
    frame: IntArray
    rms: Array

    @property
    def median(self) -> float:
        """Median over the tracks of their RMS [px]; NaN if there are none."""
        return float(np.median(self.rms)) if len(self.rms) else float("nan")

    @property
    def capped_rms(self) -> float:
        """RMS over the tracks, none of which counts with more than ``CAP_PX`` [px]; NaN if there are none."""
        return float(np.sqrt(np.mean(self.rms**2))) if len(self.rms) else float("nan")

    @property
    def capped(self) -> int:
        """Number of tracks at ``CAP_PX``."""
        return int(np.count_nonzero(self.rms >= CAP_PX))


@dataclass(frozen=True)
class Paired:
    """One trajectory against another, track by track.

    Attributes
    ----------
    better, low, high : float
        Share of the tracks that the first one predicts better, a tie counting half, and its 95 % interval.
    p_value : float
        Chance of a share at least as far from a half if neither were better.
    gain : float
        Median over the tracks of what the RMS of the second one is larger [px].
    """

    better: float
    low: float
    high: float
    p_value: float
    gain: float

    @property
    def p_told(self) -> str:
        """The p-value in words: the smallest that random swaps can give is a bound."""
        floor = 1.0 / (1 + _DRAWS)
        return f"p < {2.0 * floor:.1g}" if self.p_value <= floor else f"p {self.p_value:.2g}"


def hold_out(track: IntArray, *, share: float, seed: int) -> BoolArray:
    """Choose about a share of the tracks that have enough views to be scored, whole tracks.

    A track's luck depends on the seed and on its id alone, not on the order or on which others there are.

    Parameters
    ----------
    track : (n,)
        Track of each observation; ids count from zero.
    share : float
        Chance of each track.
    seed : int

    Returns
    -------
    (n,)
        Which observations are held out.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"share must be >= 0 and < 1, got {share}")
    views = np.bincount(track)
    luck = np.random.default_rng(seed).random(len(views))
    return np.asarray(((luck < share) & (views >= FEWEST_VIEWS))[track])


def score(held: HeldOut, world_T_imu: Array, *, frame: IntArray | None = None) -> HeldOutScore:
    """Score a trajectory.

    Every other view of a track is triangulated, beginning with its first, and those in between are predicted.
    To triangulate its first half and predict the second, or the other way round, ranks trajectories about as
    well, but adds noise, since a tracker drifts: fewer pairs of runs are told apart.

    Parameters
    ----------
    held : HeldOut
    world_T_imu : (T, 4, 4)
    frame : (T,), optional
        Frames of the poses, in increasing order; 0 to T - 1 if not given. A track with a view in any other
        frame counts with ``CAP_PX``.
    """
    frame = np.arange(len(world_T_imu)) if frame is None else frame
    order = np.lexsort((held.frame, held.track))
    track, first, views = np.unique(held.track[order], return_index=True, return_counts=True)
    enough = views >= FEWEST_VIEWS
    track, first, views = track[enough], first[enough], views[enough]
    rms = np.full(len(track), CAP_PX)
    by_length = np.argsort(views, kind="stable")
    for begin in range(0, len(track) if len(frame) else 0, _CHUNK):
        chosen = by_length[begin : begin + _CHUNK]
        rows = order[_fitted_first(first[chosen], views[chosen])]
        at = np.minimum(np.searchsorted(frame, held.frame[rows]), len(frame) - 1)
        there = np.all(frame[at] == held.frame[rows], axis=1)
        some = chosen[there]
        rms[some] = _track_rms(held.rig, world_T_imu[at[there]], held.z[rows[there]], views[some])
    return HeldOutScore(track, held.frame[order[first]], np.minimum(rms, CAP_PX))


def _fitted_first(first: IntArray, views: IntArray) -> IntArray:
    """Places ``(m, V)`` of the views of each track, every other one and then the rest, padded with the first.

    Parameters
    ----------
    first, views : (m,)
        Where each track begins, and how many views it has.
    """
    place, fitted = np.arange(views.max(initial=0)), _fitted(views)[:, None]
    chosen = np.where(place < fitted, 2 * place, 2 * (place - fitted) + 1)
    return np.asarray(first[:, None] + np.where(place < views[:, None], chosen, 0))


def _fitted(views: IntArray) -> IntArray:
    """How many of a track's views are triangulated; the rest is predicted."""
    return (views + 1) // 2


def _track_rms(rig: StereoRig, world_T_imu: Array, z: Array, views: IntArray) -> Array:
    """RMS ``(m,)`` [px] of the predicted views, infinite where there is no such point.

    A residual is in units of the white noise of a pixel coordinate: v, a mean of two, has half its variance.
    """
    place = np.arange(z.shape[1])
    fitted = place < _fitted(views)[:, None]
    predicted = (place < views[:, None]) & ~fitted
    sigma = np.where(fitted[..., None], SHARES, np.inf)
    found = triangulate(rig, world_T_imu @ rig.imu_T_cam, z, sigma)
    square = np.mean((found.residual / SHARES) ** 2, axis=2)
    mean = np.sum(square, axis=1, where=predicted) / np.sum(predicted, axis=1)
    return np.where(found.solved, np.sqrt(mean), np.inf)


def paired(one: HeldOutScore, other: HeldOutScore, *, seed: int = 0) -> Paired:
    """Compare two trajectories on the same tracks.

    Tracks in view together share the error of the poses, so they are no independent trials: those that begin
    within the same thirty frames are taken for one, or within a 250th of the sequence if that is longer. The
    interval is that of a bootstrap over these blocks, the p-value that of a sign test which swaps the two
    trajectories in random blocks; with B blocks it cannot fall below 2^(1-B).

    Raises
    ------
    ValueError
        If there are no tracks, or not the same ones.
    """
    if not len(one.track) or not np.array_equal(one.track, other.track):
        raise ValueError("two trajectories are compared on the same tracks, of which there must be some")
    larger = other.rms - one.rms
    # SciPy's dense ranks are integers or floats by its version; these are integers in all.
    length = max(_BLOCK, -(-(int(one.frame.max()) + 1) // _MOST_BLOCKS))
    block = np.unique(one.frame // length, return_inverse=True)[1]
    tracks = np.bincount(block)
    balance = np.bincount(block, weights=np.sign(larger))
    generator = np.random.default_rng(seed)
    drawn = generator.multinomial(len(tracks), np.full(len(tracks), 1.0 / len(tracks)), size=_DRAWS)
    shares = 0.5 + 0.5 * (drawn @ balance) / (drawn @ tracks)
    swapped = generator.choice([-1.0, 1.0], size=(_DRAWS, len(tracks))) @ balance
    as_far = int(np.count_nonzero(np.abs(swapped) >= np.abs(balance.sum())))
    low, high = np.quantile(shares, [0.025, 0.975])
    return Paired(
        better=float(0.5 + 0.5 * balance.sum() / tracks.sum()),
        low=float(low),
        high=float(high),
        p_value=(1 + as_far) / (1 + _DRAWS),
        gain=float(np.median(larger)),
    )
