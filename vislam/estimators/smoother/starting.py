"""Where a landmark starts: all its views so far triangulated at once, for many landmarks together.

A track starts when its disparity stands clear of its uncertainty, and waits until then.
"""

from dataclasses import dataclass, fields

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.geometry import se3
from vislam.models import StereoRig
from vislam.models.triangulation import triangulate

_WORST_RESIDUAL = 4.0
"""A track with a residual beyond this many standard deviations is not one static point."""
_FEWEST = 6
"""So many tracks can say together that it is not they that are wrong."""


@dataclass(frozen=True)
class Start:
    """Outcome for each track.

    Attributes
    ----------
    points_world : (n, 3)
    depth : (n,)
        Depth in its first view [m].
    clear : (n,)
        Whether its disparity stands clear.
    worst : (n,)
        Largest residual of the views that are judged, in standard deviations.
    """

    points_world: Array
    depth: Array
    clear: BoolArray
    worst: Array

    @property
    def ready(self) -> BoolArray:
        """Which of the tracks ``(n,)`` may start."""
        return np.asarray(self.clear & (self.worst < _WORST_RESIDUAL))

    @property
    def ready_alone(self) -> BoolArray:
        """Which of the tracks ``(n,)`` may start where no landmark is left that they could agree with.

        Residuals are taken at poses of which the newest is a prediction, and in units of what the noise is
        said to be. If none is within the limit, pose or noise is wrong and not the tracks, and without them
        neither would ever be put right: what stands out from the others is left out then.
        """
        if self.ready.any() or np.count_nonzero(self.clear) < _FEWEST:
            return self.ready
        return np.asarray(self.clear & (self.worst < 2.0 * np.median(self.worst[self.clear])))

    def with_ready(self, rows: IntArray, other: "Start") -> "Start":
        """The same, with those of ``other``, which are the tracks in ``rows (m,)``, that are ready there."""
        merged = {item.name: getattr(self, item.name).copy() for item in fields(self)}
        for name, values in merged.items():
            values[rows[other.ready]] = getattr(other, name)[other.ready]
        return Start(**merged)


def starts(
    rig: StereoRig, world_T_imu: Array, z: Array, sigma: Array, *, clear: float, judged: BoolArray
) -> Start:
    """Find where tracks start, from all their views.

    Parameters
    ----------
    rig : StereoRig
    world_T_imu : (n, V, 4, 4)
        Pose of each view; the first view of a track comes first.
    z : (n, V, 3)
        Measurements (uL, uR, v) [px].
    sigma : (n, V, 3)
        Their standard deviations [px]; infinite where a track has no such view.
    clear : float
        How many standard deviations the disparity must be away from zero.
    judged : (n, V)
        Views whose residuals are looked at.
    """
    world_T_cam = world_T_imu @ rig.imu_T_cam
    found = triangulate(rig, world_T_cam, z, sigma)
    stands_clear = found.solved & (found.disparity > clear * found.disparity_sigma)
    worst = np.max(np.where(judged[..., None], np.abs(found.residual) / sigma, 0.0), axis=(1, 2))
    points_cam = rig.back_project(np.where(stands_clear[:, None], found.mean, [1.0, 0.0, 0.0]))
    points_world = se3.transform(world_T_cam[:, 0], points_cam[:, None])[:, 0]
    return Start(points_world, points_cam[:, 2], stands_clear, worst)
