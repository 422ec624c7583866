"""Landmarks of a fixed field along the way: static, found again, clear of the way."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from vislam.geometry import se3
from vislam.repair.tracks import duplicated_observations
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.drive import stereo_rig
from vislam.simulation.field import landmark_field
from vislam.simulation.path import DrivePath

DRIVE = SimulationConfig(
    frames=300,
    path="urban",
    speed=8.0,
    tracks_in_view=40,
    landmarks="field",
    loss_probability=0.1,
    pixel_sigma_px=0.0,
)


def simulated(config, seed=5):
    return simulate(config, seed=seed, name="s")


def camera_poses(config):
    generator = np.random.default_rng(5)
    time = config.period * np.arange(config.frames)
    return DrivePath(config, generator).pose(time) @ stereo_rig(config).imu_T_cam, generator


def points_of_tracks(sequence, truth):
    """Point of each track, once it has been checked that it has but one."""
    _, first, back = np.unique(sequence.track, return_index=True, return_inverse=True)
    assert np.array_equal(truth.points_world, truth.points_world[first][back])
    return truth.points_world[first]


def test_a_track_has_one_point_and_landmarks_have_several_tracks():
    points = points_of_tracks(*simulated(DRIVE))
    landmarks, tracks = np.unique(points, axis=0, return_counts=True)
    assert len(landmarks) < 0.9 * len(points)
    assert tracks.max() > 2


def test_births_of_their_own_share_no_landmark():
    points = points_of_tracks(*simulated(replace(DRIVE, landmarks="births")))
    assert len(np.unique(points, axis=0)) == len(points)


def test_no_landmark_has_two_tracks_in_one_frame():
    sequence, truth = simulated(DRIVE)
    for k in range(len(sequence)):
        points = truth.points_world[sequence.offset[k] : sequence.offset[k + 1]]
        assert len(np.unique(points, axis=0)) == len(points)


def test_all_tracks_follow_points_of_the_field_that_the_seed_gives():
    sequence, truth = simulated(DRIVE)
    world_T_cam, generator = camera_poses(DRIVE)
    generator.standard_normal((DRIVE.frames, 6))
    field = landmark_field(DRIVE, world_T_cam, generator)
    first = truth.world_T_imu[0] @ stereo_rig(DRIVE).imu_T_cam
    in_camera = se3.transform(se3.inverse(first), truth.points_world)
    distance, _ = KDTree(se3.transform(se3.inverse(world_T_cam[0]), field)).query(in_camera)
    assert distance.max() < 1e-6
    assert len(sequence.track) > 5000


def test_without_noise_the_pixels_are_those_of_the_points():
    sequence, truth = simulated(DRIVE)
    rig = stereo_rig(DRIVE)
    for k in (0, 150, 299):
        rows = slice(sequence.offset[k], sequence.offset[k + 1])
        camera = se3.inverse(truth.world_T_imu[k] @ rig.imu_T_cam)
        z = rig.project(se3.transform(camera, truth.points_world[rows]))
        assert sequence.pixels[rows][:, [0, 2, 1]] == pytest.approx(z, abs=1e-6)


def test_points_come_by_the_metre_and_keep_clear_of_the_way():
    # It crosses its own way, where facades of the one arm would stand on the other.
    config = replace(DRIVE, path="figure_eight", hills_m=0.0)
    world_T_cam, generator = camera_poses(config)
    field = landmark_field(config, world_T_cam, generator)
    place = world_T_cam[:, :3, 3]
    way = np.linalg.norm(np.diff(place, axis=0), axis=1).sum() + DRIVE.depth_max
    assert 0.8 * DRIVE.field_per_metre * way < len(field) <= DRIVE.field_per_metre * way
    distance, nearest = KDTree(place[:, :2]).query(field[:, :2])
    above = field[:, 2] - place[nearest, 2]
    raised = (above > 0.5) & (distance < 30.0)
    assert raised.sum() > 500
    assert distance[raised].min() > 3.0
    assert np.any(distance[~raised] < 1.0)


def test_depths_stay_within_what_is_set():
    config = replace(DRIVE, depth_min=10.0, depth_max=40.0)
    sequence, _ = simulated(config)
    rig = stereo_rig(config)
    _, first = np.unique(sequence.track, return_index=True)
    disparity = rig.fx * rig.baseline / np.array([40.0, 10.0])
    assert sequence.disparity[first].min() >= disparity[0] - 1e-6
    assert sequence.disparity[first].max() <= disparity[1] + 1e-6


def test_an_empty_field_gives_no_more_tracks_than_it_has_points():
    sequence, _ = simulated(replace(DRIVE, frames=40, field_per_metre=0.2))
    assert 0 < np.diff(sequence.offset).max() < 30


def test_a_landmark_that_a_track_has_left_in_a_duplicated_frame_can_be_found_again():
    # At a walking pace with more tracks wanted than there are landmarks, all are taken from the start.
    few = replace(
        DRIVE,
        frames=60,
        path="straight",
        speed=0.1,
        hills_m=0.0,
        loss_probability=0.0,
        field_per_metre=1.0,
        tracks_in_view=5000,
    )
    for probability in (0.0, 0.2):
        sequence, _ = simulated(replace(few, duplication_probability=probability))
        duplicated, _ = duplicated_observations(sequence)
        _, first = np.unique(sequence.track, return_index=True)
        born = np.bincount(sequence.frame_of[first], minlength=60)
        assert born[0] > 20
        many = born > 0.8 * born[0]
        assert (duplicated.sum() > 5) == (probability > 0.0)
        assert np.array_equal(np.flatnonzero(many), [0, *np.flatnonzero(duplicated)])


def test_equal_seeds_give_equal_drives_and_others_do_not():
    first, again, other = (simulated(DRIVE, seed)[0] for seed in (1, 1, 2))
    assert first.pixels.tobytes() == again.pixels.tobytes()
    assert first.digest != other.digest


CIRCUIT = replace(DRIVE, path="circuit", hills_m=0.0, field_per_metre=1.0, landmarks="recognised")


def test_a_recognised_landmark_has_the_same_id_in_both_laps():
    sequence, truth = simulated(CIRCUIT)
    points_of_tracks(sequence, truth)
    lap = sequence.frame_of // (CIRCUIT.frames // 2)
    both = np.intersect1d(sequence.track[lap == 0], sequence.track[lap == 1])
    assert len(both) > 0.6 * len(np.unique(sequence.track))
    for start, end in zip(sequence.offset, sequence.offset[1:], strict=False):
        assert len(np.unique(sequence.track[start:end])) == end - start


def test_without_recognition_the_second_lap_has_tracks_of_its_own():
    sequence, _ = simulated(replace(CIRCUIT, landmarks="field", loss_probability=0.0))
    lap = sequence.frame_of // (CIRCUIT.frames // 2)
    first, second = np.unique(sequence.track[lap == 0]), np.unique(sequence.track[lap == 1])
    assert len(np.intersect1d(first, second)) < 0.3 * len(second)


@pytest.mark.parametrize("fault", ["duplication_probability", "moving_share"])
def test_an_id_of_a_landmark_has_one_point(fault):
    with pytest.raises(ValueError, match=rf"recognised has one static point.*{fault}.*landmarks: field"):
        replace(CIRCUIT, **{fault: 0.1})
