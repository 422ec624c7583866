"""Maps of points without identities: each point with the nearest one, up to a share of its depth."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vislam.base.types import Array
from vislam.evaluation.maps import DEPTHS, NEAR_OF_DEPTH, Bin, binned


@dataclass(frozen=True)
class CloudErrors:
    """A map of points against another.

    Attributes
    ----------
    distance : (n,)
        From each point of the map to the nearest of the other [m].
    depth : (n,)
        Of each point, from the nearest pose [m].
    within : float
        Share of the points of the map that have one of the other within the cut: accuracy.
    complete : float
        Share of the points of the other that have one of the map within the cut: completeness.
    baseline : float
        Of the rig [m].
    """

    distance: Array
    depth: Array
    within: float
    complete: float
    baseline: float

    @property
    def near(self) -> Array:
        """Distances of those within the cut [m]."""
        return self.distance[self.distance <= NEAR_OF_DEPTH * self.depth]

    def by_depth(self) -> list[Bin]:
        """How far the maps are apart, by depth [baselines]."""
        unknown = np.full(len(self.distance), np.nan)
        return binned(self.distance, unknown, by=self.depth / self.baseline, edges=DEPTHS)


def cloud_errors(points: Array, other: Array, positions: Array, *, baseline: float) -> CloudErrors | None:
    """Compare points ``(n, 3)`` with others ``(m, 3)`` in the same world [m]; None if there are none.

    The cut is ``NEAR_OF_DEPTH`` times the depth, which is the distance from the nearest of some positions
    ``(T, 3)``: the error of stereo grows with depth, and no one length suits a car and a hand-held rig.
    """
    if not len(points) or not len(other) or not len(positions):
        return None
    poses = cKDTree(positions)
    depth, others_depth = poses.query(points)[0], poses.query(other)[0]
    distance, back = cKDTree(other).query(points)[0], cKDTree(points).query(other)[0]
    return CloudErrors(
        np.asarray(distance),
        np.asarray(depth),
        float(np.mean(distance <= NEAR_OF_DEPTH * depth)),
        float(np.mean(back <= NEAR_OF_DEPTH * others_depth)),
        baseline,
    )
