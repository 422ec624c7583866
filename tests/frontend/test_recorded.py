"""Recorded images where they are: distances against the reference, and the lives of tracks."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.frontend.bags import TOPICS, Pen, write_camchain
from vislam.base.progress import Silent
from vislam.core.images import StampedPoses
from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.datasets.calibration_yaml import read_sensor
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


def first_pairs(folder, pairs):
    """The first pairs of MH_01 as a folder of its own, calibrated by a camchain file; cameras of a rig."""
    source = DATA / "euroc_mh01" / "mav0"
    if not source.is_dir():
        pytest.skip(f"{source} is not here")
    mounted = [read_sensor(source / name / "sensor.yaml", body_T_imu=np.eye(4)) for name in ("cam0", "cam1")]
    write_camchain(
        folder / "camchain-imucam.yaml",
        TOPICS,
        (mounted[0].camera, mounted[1].camera, mounted[0].imu_T_cam, mounted[1].imu_T_cam),
    )
    for name, rows in (("cam0", pairs), ("cam1", pairs), ("imu0", 60 * pairs)):
        (folder / "mav0" / name).mkdir(parents=True)
        lines = (source / name / "data.csv").read_text().splitlines()[: rows + 1]
        (folder / "mav0" / name / "data.csv").write_text("\n".join(lines) + "\n")
        if name != "imu0":
            (folder / "mav0" / name / "data").symlink_to(source / name / "data")
    return folder


def stamped(path):
    lines = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
    return [(int(line[0]), line[1:]) for line in lines]


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_bag_of_recorded_images_has_their_tracks(tmp_path, kind):
    pytest.importorskip("rosbags")
    folder = first_pairs(tmp_path, 12)
    with Pen(tmp_path, kind) as pen:
        for stamp, values in stamped(folder / "mav0" / "imu0" / "data.csv"):
            pen.write("/imu0", stamp, pen.imu(stamp, values[:3], values[3:6]))
        for name, topic in zip(("cam0", "cam1"), TOPICS, strict=True):
            for stamp, (file,) in stamped(folder / "mav0" / name / "data.csv"):
                content = (folder / "mav0" / name / "data" / file.strip()).read_bytes()
                pen.write(f"{topic}/compressed", stamp, pen.compressed(stamp, content))
    one, other = (
        track(open_images(path), FrontEndConfig(), progress=Silent()).sequence
        for path in (folder / "mav0", pen.path)
    )
    assert len(one) == 12
    assert np.array_equal(one.track, other.track)
    assert np.array_equal(one.pixels, other.pixels)
    assert np.array_equal(one.stamp, other.stamp)
    assert np.array_equal(one.twist, other.twist)
