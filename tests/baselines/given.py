"""Saved runs of poses and maps that a test makes up."""

import numpy as np

from vislam.core.step import Final, Step
from vislam.core.trajectory import Landmarks
from vislam.estimators import loop
from vislam.geometry import se3


class _Given:
    def __init__(self, poses, landmarks):
        self._poses, self._map = poses, landmarks

    def process(self, frame):
        return Step(self._poses[frame.k])

    def finalize(self):
        return Final(map=self._map)


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
        Landmarks(
            own_track if track is None else track, own_points if points is None else points, points_cov
        ),
    )
    sigma = np.ones((dataset.sequence.observations, 3))
    loop.run(given, dataset.sequence, sigma, name="given").save(path)
    return str(path)
