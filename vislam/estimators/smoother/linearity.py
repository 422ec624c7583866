"""How far the linearisation of the newest observations is off at the estimate.

A Gauss-Newton step takes the whitened residual ``r(x)`` for ``r(x_0) + J (x - x_0)``. What it neglects,

    r(x_0 + d) - r(x_0) - J d,

is in standard deviations of the observation: where it is small the estimate is that of the objective,
whatever the scale of the scene, and where it is not, the step was no solution (Nocedal and Wright, *Numerical
Optimization*, 2nd ed., section 10.3).
"""

from collections.abc import Sequence

import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.observations import Observations
from vislam.estimators.smoother.tracks import Track
from vislam.geometry import se3
from vislam.models import StereoRig


def neglected(
    rig: StereoRig, tracks: Sequence[Track], *, points: Array, pose: Array, linearised: Array
) -> tuple[Array, Array]:
    """What the linearisation of the newest observation of each track neglects, and what it leaves.

    Parameters
    ----------
    rig : StereoRig
    tracks : sequence of Track
        All observed in the newest frame, their landmarks linearised at ``track.linearised``.
    points : (n, 3)
        Estimates of their landmarks [m].
    pose, linearised : (4, 4)
        Estimate of the newest pose, and where it was linearised.

    Returns
    -------
    neglected : (n,)
        Largest component, in standard deviations; 0 of a landmark that is not in front of the camera, here or
        there, which is degenerate and has no linearisation.
    left : (n,)
        Root mean square of the residual of the linear problem, likewise.
    """
    if not tracks:
        return np.zeros(0), np.zeros(0)
    views = [track.views[-1] for track in tracks]
    seen = Observations(
        np.zeros(len(views), np.int64),
        np.arange(len(views)),
        np.array([view.z for view in views]),
        np.array([view.sigma for view in views]),
    )
    before = np.array([track.linearised for track in tracks])
    there = seen.linearise(rig, linearised[None], before, kernel=None)
    here = seen.linearise(rig, pose[None], points, kernel=None)
    linear = there.residual + there.by_pose @ se3.local(linearised, pose)
    linear += np.einsum("nij,nj->ni", there.by_point, points - before)
    found = np.abs(here.residual - linear).max(axis=1)
    in_front = [np.any(each.by_point != 0.0, axis=(1, 2)) for each in (here, there)]
    known = in_front[0] & in_front[1]
    left = np.sqrt(np.mean(linear**2, axis=1))
    return np.where(known, found, 0.0), np.where(known, left, 0.0)
