"""Recorded images where they are: distances against the reference, and the lives of tracks."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vislam.base.progress import Silent
from vislam.core.images import StampedPoses
from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.datasets.images import open_images
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.track import reference_frames, track

DATA = Path(os.environ.get("VISLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))

pytestmark = pytest.mark.slow


def recording(name, pairs):
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    found = open_images(folder)
    first = np.arange(len(found)) < pairs
    return replace(found, stamp=found.stamp[first], left=found.left.of(first), right=found.right.of(first))


def test_a_car_s_distance_is_that_of_its_gnss():
    found = recording("kitti_raw", 80)
    tracked = track(found, FrontEndConfig(), progress=Silent())
    assert tracked.counts["images_missing_left"] == tracked.counts["images_missing_right"] == 1
    assert abs(tracked.figures["row_error_px"]) > 0.2 > abs(tracked.figures["row_error_corrected_px"])
    assert tracked.figures["life_median"] >= 8
    assert isinstance(found.reference, StampedPoses)
    frame, pose = reference_frames(tracked, found.reference)
    fits = rigid_fits(tracked.sequence, continuations(tracked.sequence))
    went = sum(np.linalg.norm(fits[k].next_T_prev[:3, 3]) for k in range(frame[0] + 1, frame[-1] + 1))
    expected = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1).sum()
    assert went == pytest.approx(expected, rel=0.015)


def test_a_shaken_rig_keeps_its_tracks():
    tracked = track(recording("euroc_mh01", 60), FrontEndConfig(), progress=Silent())
    assert tracked.counts["frames"] == 60
    assert tracked.figures["in_view_median"] >= 80
    assert tracked.figures["life_median"] >= 6
    assert tracked.figures["row_spread_px"] < 0.5


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_bag_of_recorded_images_has_their_tracks(tmp_path, kind):
    pytest.importorskip("rosbags")
    from tests.frontend.bags import TOPICS, Pen, write_camchain

    found = recording("euroc_mh01", 12)
    made, inertia = found.pair, found.inertia
    imu_T_left = found.pair.rig.imu_T_cam.copy()
    imu_T_left[:3, :3] = imu_T_left[:3, :3] @ made.rect_R_left
    left_T_right = np.eye(4)
    left_T_right[:3, :3] = made.rect_R_left.T @ made.rect_R_right
    left_T_right[:3, 3] = made.rect_R_left.T @ [made.rig.baseline, 0.0, 0.0]
    mounted = (made.left, made.right, imu_T_left, imu_T_left @ left_T_right)
    stamps = np.rint(1e9 * found.stamp).astype(np.int64).tolist()
    with Pen(tmp_path, kind) as pen:
        write_camchain(tmp_path / "camchain-imucam.yaml", TOPICS, mounted)
        rows = zip(inertia.stamp, inertia.gyro, inertia.accelerometer, strict=True)
        for at, gyro, accelerometer in rows:
            stamp = round(1e9 * at)
            pen.write("/imu0", stamp, pen.imu(stamp, gyro, accelerometer))
        for topic, images in zip(TOPICS, (found.left, found.right), strict=True):
            for stamp, content in zip(stamps, images, strict=True):
                pen.write(f"{topic}/compressed", stamp, pen.compressed(stamp, content))
    one = track(found, FrontEndConfig(), progress=Silent()).sequence
    other = track(open_images(pen.path), FrontEndConfig(), progress=Silent()).sequence
    assert np.array_equal(one.track, other.track)
    assert np.abs(one.pixels - other.pixels).max() < 1e-6
