"""Saved runs of poses and maps that a test makes up."""

import numpy as np

from vislam.core.estimator import Estimate, StepRecord
from vislam.estimators import loop
from vislam.geometry import se3


class _Given:
    def __init__(self, poses, track, points, points_cov):
        self._poses, self._map = poses, (track, points, points_cov)

    def process(self, frame, refused):
        nothing = np.zeros(len(refused), bool)
        pose = self._poses[frame.k]
        return StepRecord(pose, None, None, None, 0.0, 0, float("nan"), nothing, nothing)

    def finalize(self):
        return Estimate(self._poses, None, *self._map, {})


def true_poses(dataset):
    """Poses from the first one on."""
    pose = dataset.reference.pose
    return se3.inverse(pose[0]) @ pose


def true_map(dataset):
    """Tracks and points as seen from the first pose."""
    reference = dataset.reference
    return reference.track, se3.transform(se3.inverse(reference.pose[0]), reference.points_world)


def save_run(path, dataset, *, poses=None, track=None, points=None, points_cov=None):
    """Save a run of poses and a map; the true ones where none are given. Returns the path as text."""
    own_track, own_points = true_map(dataset)
    given = _Given(
        true_poses(dataset) if poses is None else poses,
        own_track if track is None else track,
        own_points if points is None else points,
        points_cov,
    )
    sigma = np.ones((dataset.sequence.observations, 3))
    loop.run(given, dataset.sequence, sigma, name="given").save(path)
    return str(path)
