"""Tracks of rendered pictures, held against the true ones."""

import numpy as np
import pytest

from vislam.base.progress import Silent
from vislam.datasets.images import open_images
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.track import track

CONFIG = FrontEndConfig(features=100, window_px=15)


@pytest.fixture(scope="module")
def tracked(drive_folder):
    return track(open_images(drive_folder), CONFIG, progress=Silent())


def raw_pixels(tracked, drive):
    """Pixels of all observations in the pictures as they are, left and right."""
    pair, pixels = drive.studio.pair, tracked.sequence.pixels
    return pair.raw_left(pixels[:, :2]), pair.raw_right(pixels[:, 2:])


def test_pixels_are_those_of_one_point_of_the_world(tracked, drive):
    """A patch is moved, not warped: a track drifts where perspective changes by 6 % a frame, as here."""
    sequence, left = tracked.sequence, raw_pixels(tracked, drive)[0]
    first, frame, age = sequence.first_rows(), sequence.frame_of, sequence.age()
    error = np.zeros(len(left))
    for k in range(len(sequence)):
        rows = np.flatnonzero(frame[first] == k)
        points = drive.studio.points(drive.pose[k], left[first[rows]])
        for later in range(k, len(sequence)):
            now = frame[rows] == later
            truth, _ = drive.studio.pixels(drive.pose[later], points[now])
            error[rows[now]] = np.linalg.norm(truth - left[rows[now]], axis=1)
    assert np.all(error[age == 0] < 1e-6)
    assert np.median(error[age == 1]) < 0.12
    assert np.percentile(error[age == 1], 95) < 0.4
    assert np.median(error[age >= 5]) < 0.6


def test_disparities_are_not_biased(tracked, drive):
    sequence = tracked.sequence
    left, right = raw_pixels(tracked, drive)
    off = []
    for k in range(len(sequence)):
        rows = slice(sequence.offset[k], sequence.offset[k + 1])
        points = drive.studio.points(drive.pose[k], left[rows])
        off.append(right[rows] - drive.studio.pixels(drive.pose[k], points)[1])
    off = np.concatenate(off)
    assert np.abs(np.median(off, axis=0)).max() < 0.02
    assert 1.4826 * np.median(np.abs(off[:, 0])) < 0.1


def test_tracks_live_and_are_many(tracked):
    assert tracked.figures["life_median"] >= 5
    assert tracked.figures["in_view_median"] >= 60
    assert tracked.distance.shape == (tracked.sequence.observations, 2)


def test_new_corners_restart_nothing(tracked):
    """In no frame do most tracks end: what is in view goes on while corners are added."""
    sequence = tracked.sequence
    for k in range(1, len(sequence)):
        before, now = (sequence.track[sequence.offset[j] : sequence.offset[j + 1]] for j in (k - 1, k))
        assert len(np.intersect1d(before, now)) > 0.6 * len(before)
    assert len(np.unique(sequence.track)) > len(sequence.track[: sequence.offset[1]])


def test_the_same_images_and_seed_give_the_same_tracks(tracked, drive_folder):
    again = track(open_images(drive_folder), CONFIG, progress=Silent())
    assert np.array_equal(again.sequence.pixels, tracked.sequence.pixels)
    assert np.array_equal(again.sequence.track, tracked.sequence.track)


def test_a_right_camera_that_is_turned_is_turned_back(tracked, drive_folder):
    from dataclasses import replace

    recording = open_images(drive_folder)
    turned = replace(recording, pair=recording.pair.turned_right(np.array([2e-3, 0.0, 3e-3])))
    found = track(turned, CONFIG, progress=Silent())
    assert found.figures["row_error_px"] == pytest.approx(2e-3 * 200, abs=0.1)
    assert found.figures["right_camera_turned_x_mrad"] == pytest.approx(-2.0, abs=0.2)
    assert found.figures["right_camera_turned_z_mrad"] == pytest.approx(-3.0, abs=0.3)
    assert abs(found.figures["row_error_corrected_px"]) < 0.02
    assert abs(tracked.figures["right_camera_turned_x_mrad"]) < 0.2
