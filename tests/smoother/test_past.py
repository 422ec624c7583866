"""What a lag has left behind takes little memory, and the final estimate has it all the same."""

import numpy as np

from tests.smoother.drives import BUILD, drive, member
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.smoother.past import Past
from vislam.estimators.smoother.tracks import Tracks


def test_the_past_has_all_landmarks_and_observations_and_a_track_only_once():
    past = Past()
    past.add(7, [0, 1], np.array([1, 2, 3]))
    past.add(4, [1], np.array([4, 5, 6]), replaced=True)
    past.add(9, [2, 5], np.array([7, 8, 9]))
    assert past.come_back({1, 7}) == [7]
    assert past.come_back({1, 7}) == []
    past.add(7, [8], np.array([0, 0, 1]))
    ids, points = past.landmarks
    assert ids.tolist() == [9, 7]
    assert points.tolist() == [[7, 8, 9], [0, 0, 1]]
    frames, names = past.observations
    assert list(zip(frames, names, strict=True)) == [(0, 7), (1, 7), (1, 4), (2, 9), (5, 9), (8, 7)]


def test_without_any_the_shapes_are_those_of_nothing():
    ids, points = Past().landmarks
    assert (ids.shape, points.shape) == ((0,), (0, 3))
    assert [part.shape for part in Past().observations] == [(0,), (0,)]


def test_a_lag_holds_no_more_tracks_late_than_early_and_gives_all_of_them(monkeypatch):
    config, dataset = drive(seed=2, frames=90, tracks_in_view=12.0, loss_probability=0.2)
    sigma, held = pixel_sigma(config, dataset), []
    estimator = BUILD["fixed_lag"](make_problem(config, dataset), {"lag_s": 0.5})
    for frame in dataset.sequence.frames(sigma):
        estimator.process(frame)
        held.append(len(estimator._solver.tracks.ended))
    assert max(held[60:]) <= 1.5 * max(held[20:40])
    assert len(estimator._frames) == 1
    found = estimator.finalize()
    monkeypatch.setattr(Tracks, "_pass_on", lambda self, oldest: None)
    whole = member("fixed_lag", config, dataset, lag_s=0.5)
    assert len(whole.map) > 4 * max(held)
    np.testing.assert_array_equal(found.map.track, whole.map.track)
    np.testing.assert_array_equal(found.map.points_world, whole.map.points_world)
    np.testing.assert_array_equal(found.trajectory.world_T_imu, whole.smoothed.world_T_imu)
    fused = set(zip(*(part.tolist() for part in found.fused), strict=True))
    sequence = dataset.sequence
    used = zip(sequence.frame_of[whole.used].tolist(), sequence.track[whole.used].tolist(), strict=True)
    assert fused == set(used)
