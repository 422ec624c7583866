"""Landmarks against true ones, and landmark by landmark between two runs."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vislam.base.distributions import chi2_quantile
from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation.normalised import Normalised, usable, whiten
from vislam.geometry import se3

NEAR_OF_DEPTH = 0.05
"""A landmark within this share of its depth of the true one counts as found: the error of stereo grows with
depth, and no one length suits a car and a hand-held rig."""
DEPTHS = np.array([0.0, 16.0, 32.0, 64.0, 128.0, np.inf])
"""Bounds of the depths by which maps are compared [baselines]: a disparity is the focal length over them."""


@dataclass(frozen=True)
class MapErrors:
    """Landmarks of a run against the true ones.

    Attributes
    ----------
    track : (k,)
        True landmarks that the run has estimated.
    distance : (k,)
        Error of each [m].
    estimated, found : float
        Share of the true landmarks that were estimated at all, and that were estimated within
        ``NEAR_OF_DEPTH`` of their depth.
    normalised : Normalised or None
        Errors and claims, landmark after landmark by track; None where the run gives no covariances.
    """

    track: IntArray
    distance: Array
    estimated: float
    found: float
    normalised: Normalised | None


@dataclass(frozen=True)
class MapDifference:
    """Landmarks that two runs share, their worlds joined at the first pose.

    Attributes
    ----------
    track : (k,)
    distance : (k,)
        Between the two estimates of each [m].
    squared : (k,)
        Squared Mahalanobis distance with the sum of both covariances, for which see
        :mod:`vislam.evaluation.agreement`; NaN where one has none.
    """

    track: IntArray
    distance: Array
    squared: Array


@dataclass(frozen=True)
class Bin:
    """Landmarks that are alike in something.

    Attributes
    ----------
    low, high : float
        Bounds of that, the upper one excluded.
    count : int
    distance : float
        Median [m]; NaN in an empty bin, as are the next two.
    mahalanobis : float
        Median Mahalanobis distance.
    beyond : float
        Share beyond the 95 % bound of the chi-square distribution; 0.05 if what is claimed is true.
    """

    low: float
    high: float
    count: int
    distance: float
    mahalanobis: float
    beyond: float


def map_errors(run: Run, reference: Reference, *, alignment: Array, depth: Array) -> MapErrors | None:
    """Compare a map with the true one; None if they have no landmark in common.

    Parameters
    ----------
    run : Run
    reference : Reference
        With true landmarks.
    alignment : (4, 4)
        Pose that takes the run's world to the reference's.
    depth : (j,)
        Distance of each true landmark from the pose that saw it first [m].
    """
    found = run.landmarks
    track, mine, true = np.intersect1d(found.track, reference.track, return_indices=True)
    if not len(track):
        return None
    error = reference.points_world[true] - se3.transform(alignment, found.points_world[mine])
    distance = np.linalg.norm(error, axis=1)
    near = distance <= NEAR_OF_DEPTH * depth[true]
    total = len(reference.track)
    cov = None if found.points_cov is None else _turned(found.points_cov[mine], alignment)
    return MapErrors(
        track,
        distance,
        len(track) / total,
        float(near.sum()) / total,
        None if cov is None else _normalised(track, error, cov, name=reference.name),
    )


def map_difference(one: Run, other: Run) -> MapDifference | None:
    """Compare the maps of two runs; None if they have no landmark in common."""
    mine, others = one.landmarks, other.landmarks
    track, first, second = np.intersect1d(mine.track, others.track, return_indices=True)
    if not len(track) or not len(one.stamp) or not len(other.stamp):
        return None
    join = one.final.world_T_imu[0] @ se3.inverse(other.final.world_T_imu[0])
    apart = se3.transform(join, others.points_world[second]) - mine.points_world[first]
    squared = np.full(len(track), np.nan)
    if mine.points_cov is not None and others.points_cov is not None:
        total = mine.points_cov[first] + _turned(others.points_cov[second], join)
        known = usable(total)
        squared[known] = np.sum(whiten(apart[known], total[known]) ** 2, axis=1)
    return MapDifference(track, np.linalg.norm(apart, axis=1), squared)


def binned(distance: Array, squared: Array, *, by: Array | IntArray, edges: Array) -> list[Bin]:
    """Table of landmarks by something, such as their depth or the number of their views.

    Parameters
    ----------
    distance, squared : (k,)
        Distances [m] and squared Mahalanobis distances, NaN where not known.
    by : (k,)
        What they are sorted by.
    edges : (b + 1,)
        Bounds of the bins, ascending; what is outside is left out.
    """
    which = np.digitize(by, edges) - 1
    return [
        _bin(float(low), float(high), distance[which == k], squared[which == k])
        for k, (low, high) in enumerate(pairwise(edges))
    ]


def _bin(low: float, high: float, distance: Array, squared: Array) -> Bin:
    known = squared[np.isfinite(squared)]
    return Bin(
        low,
        high,
        len(distance),
        float(np.median(distance)) if len(distance) else np.nan,
        float(np.median(np.sqrt(known))) if len(known) else np.nan,
        float(np.mean(known > chi2_quantile(0.95, 3))) if len(known) else np.nan,
    )


def _normalised(track: IntArray, error: Array, cov: Array, *, name: str) -> Normalised | None:
    known = usable(cov)
    if not known.any():
        return None
    return Normalised(
        "nees_landmark",
        track[known],
        error[known],
        np.sqrt(np.diagonal(cov[known], axis1=1, axis2=2)),
        whiten(error[known], cov[known]),
        f"error = {name} - landmark, axes of the reference's world after the given alignment; covariance as "
        "claimed, turned into these axes; landmarks in the order of their tracks",
    )


def _turned(cov: Array, pose: Array) -> Array:
    rotation = pose[:3, :3]
    return np.asarray(rotation @ cov @ rotation.T)
