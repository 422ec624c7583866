"""The reader: both editions, both readings of the extrinsic, both memory orders, and the largest size."""

import gc
import tracemalloc
import zipfile

import numpy as np
import pytest

from tests.cli.test_compare import course_file
from tests.conftest import recorded
from vislam.datasets.course_npz import load_course_npz

EXTRINSIC = np.array([[0, 0, 1.0, 2.0], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1]])


def test_both_editions_give_the_same_sequence(tmp_path):
    course_file(tmp_path / "new.npz", imu_T_cam=EXTRINSIC)
    course_file(
        tmp_path / "old.npz",
        imu_T_cam=None,
        cam_T_imu=np.linalg.inv(EXTRINSIC),
        angular_velocity=None,
        rotational_velocity=np.zeros((3, 6)),
    )
    new, old = load_course_npz(tmp_path / "new.npz"), load_course_npz(tmp_path / "old.npz")
    assert np.allclose(new.rig.imu_T_cam, EXTRINSIC)
    assert np.allclose(old.rig.imu_T_cam, EXTRINSIC)
    assert np.array_equal(new.pixels, old.pixels)


def test_memory_order_and_number_type_do_not_matter(tmp_path, rng):
    features = np.where(rng.random((1, 8, 6)) < 0.4, rng.uniform(10, 90, (4, 8, 6)).round(1), -1.0)
    course_file(tmp_path / "c.npz", features=features)
    course_file(tmp_path / "f.npz", features=np.asfortranarray(features.astype(np.float32)))
    c, f = load_course_npz(tmp_path / "c.npz"), load_course_npz(tmp_path / "f.npz")
    assert np.allclose(c.pixels, f.pixels, atol=1e-4)
    assert np.array_equal(c.track, f.track)
    frame, track = c.frame_of, c.track
    assert np.array_equal(c.pixels, features[:, track, frame].T)
    assert c.observations == np.count_nonzero(features[0] != -1.0)


def test_a_partly_seen_observation_is_dropped_and_counted(tmp_path):
    features = np.full((4, 8, 6), 50.0)
    features[2, 3, 4] = -1.0
    course_file(tmp_path / "a.npz", features=features)
    sequence = load_course_npz(tmp_path / "a.npz")
    assert sequence.counts["observations_incomplete"] == 1
    assert sequence.observations == 8 * 6 - 1


def test_a_sequence_cannot_be_changed(tmp_path):
    course_file(tmp_path / "a.npz")
    sequence = load_course_npz(tmp_path / "a.npz")
    with pytest.raises(ValueError, match="read-only"):
        sequence.pixels[0] = 0.0


@pytest.mark.parametrize(
    ("name", "frames", "observations"), [("03.npz", 1010, 66353), ("0027.npz", 1106, 75647)]
)
def test_recorded_files(name, frames, observations):
    sequence = load_course_npz(recorded(name))
    assert len(sequence) == frames
    assert sequence.observations == observations


@pytest.mark.slow
def test_the_largest_recording_is_never_held_in_memory(tmp_path):
    """A file of dataset 10's size: 13,289 columns, 3,026 frames, 1.28 GB unpacked."""
    columns, frames, seen = 13_289, 3_026, 40
    course_file(
        tmp_path / "small.npz",
        features=None,
        time_stamps=0.1 * np.arange(frames)[None],
        linear_velocity=np.ones((3, frames)),
        angular_velocity=np.zeros((3, frames)),
    )
    target = tmp_path / "10.npz"
    with (
        zipfile.ZipFile(tmp_path / "small.npz") as source,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for member in source.namelist():
            archive.writestr(member, source.read(member))
        with archive.open("features.npy", "w", force_zip64=True) as file:
            header = {"descr": "<f8", "fortran_order": False, "shape": (4, columns, frames)}
            np.lib.format.write_array_header_1_0(file, header)
            for value in (300.0, 200.0, 280.0, 200.0):
                block = np.full((columns, frames), -1.0)
                starts = np.arange(columns) % (frames - seen)
                block[np.arange(columns)[:, None], starts[:, None] + np.arange(seen)] = value
                for rows in np.array_split(block, 50):
                    file.write(rows.tobytes())
                del block
    tracemalloc.start()
    sequence = load_course_npz(target)
    gc.collect()
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sequence.observations == columns * seen
    # The array alone would take 1,287 MB; what is kept here is eight times what the recording has.
    assert peak < 300e6
    assert kept < 150e6
