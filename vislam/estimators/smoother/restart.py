"""The last resort of a smoother: a final estimate that is worse than no camera at all is re-initialised.

iSAM2 takes Gauss-Newton steps without damping and leaves what lies behind as it was linearised. Where few
tracks hold the estimate, a step may diverge so far that no later one comes back. Such an estimate gives
itself away: its own cost is above that of the path that the twist alone makes, with the landmarks
triangulated from it.
"""

from functools import partial

import gtsam
import numpy as np

from vislam.core.estimator import Problem
from vislam.estimators.smoother import motion
from vislam.estimators.smoother.batch import Drive, by_gtsam, minimise
from vislam.estimators.smoother.descent import Budget
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.values import only
from vislam.geometry import se3

_SUSPECT = 10.0
"""Squares of residuals per degree of freedom beyond which the comparison is worth its time."""
_ROUNDS = 3


def restarted(
    drive: Drive, values: gtsam.Values, problem: Problem, options: SmootherOptions, budget: Budget
) -> gtsam.Values | None:
    """Levenberg-Marquardt from the path of the twist alone; None if the estimate is better than that path.

    Parameters
    ----------
    drive : Drive
    values : gtsam.Values
        The estimate.
    problem : Problem
    options : SmootherOptions
    budget : Budget
        What is left of that of the final optimisation.
    """
    squares, freedom = drive.fit(values)
    if squares <= _SUSPECT * freedom:
        return None
    graph = drive.graph()
    start = drive.triangulated(_inertial_path(drive, problem, options), clear=options.initialisation_snr)
    start = only(start, graph.keyVector())
    cost = graph.error(start)
    if 2.0 * cost >= squares:
        return None
    found = minimise(
        partial(by_gtsam, graph),
        start,
        cost=cost,
        restart=lambda best: drive.triangulated(best, clear=options.initialisation_snr),
        rounds=_ROUNDS,
        budget=budget,
    )
    return found.values


def _inertial_path(drive: Drive, problem: Problem, options: SmootherOptions) -> gtsam.Values:
    """First values of all variables: poses by the twist alone, each landmark by its first view from there."""
    model, values = motion.make(problem, options), gtsam.Values()
    poses, pose = [], np.eye(4)
    for frame in drive.frames:
        pose = model.predict(frame, pose)
        model.insert(values, frame, pose)
        poses.append(pose)
    for track in drive.tracks:
        view = track.views[0]
        world_T_cam = poses[view.k] @ drive.rig.imu_T_cam
        z = drive.stereo.errors.mended(view.z, drive.rig)
        values.insert(track.key, se3.transform(world_T_cam, drive.rig.back_project(z)[None])[0])
    return values
