"""Raw inertia of a recording: what lies between frames, its gaps, and the open track format."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.data.test_tracks_npz import tracks_file
from vislam.base.errors import DataError
from vislam.core.imu import ImuSeries
from vislam.datasets.recording import Recording
from vislam.datasets.tracks_npz import load_tracks_npz, write_tracks_npz
from vislam.models.imu import ImuNoise, ImuPrior


def series(stamp):
    """Samples that are linear in time, so that straight lines are exact."""
    stamp = np.asarray(stamp, float)
    return ImuSeries.of(stamp, np.outer(stamp, [1.0, 2, 3]), np.outer(stamp, [4.0, 5, 6]) + 1.0)


def test_steps_join_at_the_frames_and_hold_all_samples_between():
    imu = series(0.013 + 0.01 * np.arange(100))
    frames = np.array([0.1, 0.2, 0.35, 0.5])
    steps = list(imu.steps(frames))
    assert len(steps) == 4
    assert len(steps[0].stamp) == 1
    assert steps[0].missing == 0.0
    for before, step in pairwise(steps):
        assert step.stamp[0] == before.stamp[-1]
        assert np.all(np.diff(step.stamp) > 0.0)
        assert step.known.all()
    for frame, step in zip(frames, steps, strict=True):
        assert step.stamp[-1] == pytest.approx(frame, abs=1e-15)
        assert np.allclose(step.gyro, np.outer(step.stamp, [1.0, 2, 3]), atol=1e-12)
    inner = np.concatenate([step.stamp[1:-1] for step in steps[1:]])
    assert np.allclose(inner, imu.stamp[(imu.stamp > 0.1) & (imu.stamp < 0.5)])
    # The integral of samples that are joined by straight lines is exact.
    total = sum(step.dt @ step.mean_accel for step in steps[1:])
    assert np.allclose(total, np.array([4.0, 5, 6]) * (0.5**2 - 0.1**2) / 2 + 0.4, atol=1e-12)


def test_a_sample_at_a_frame_is_that_of_the_frame():
    imu = series(0.01 * np.arange(100))
    steps = list(imu.steps(np.array([0.1, 0.2 + 1e-9, 0.3])))
    assert [len(step.dt) for step in steps] == [0, 10, 10]


def test_the_clock_offset_moves_the_samples():
    imu = series(0.01 * np.arange(100))
    *_, step = imu.steps(np.array([0.1, 0.2]), clock_offset=0.05)
    assert np.allclose(step.stamp[[0, -1]], [0.1, 0.2])
    assert np.allclose(step.gyro[-1], 0.25 * np.array([1, 2, 3]))


def test_gaps_and_what_lies_outside_are_not_known():
    stamp = 0.01 * np.concatenate([np.arange(20, 40), np.arange(47, 80)])
    imu = series(stamp)
    steps = list(imu.steps(0.1 * np.arange(10)))
    missing = np.array([step.missing for step in steps])
    expected = [0, 0.1, 0.1, 0, 0.01, 0.07, 0, 0, 0.01, 0.1]
    assert np.allclose(missing, expected, atol=1e-9)
    assert imu.counts == {"imu_samples": 53, "imu_duplicates": 0, "imu_gaps": 1}
    # Before the series its first sample is held.
    assert np.allclose(steps[1].gyro, imu.gyro[0])


def test_duplicates_go_and_are_counted():
    imu = series([0.0, 0.1, 0.1, 0.2, 0.15, 0.3])
    assert imu.stamp.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert imu.counts["imu_duplicates"] == 2


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"stamp": np.zeros(4)}, "imu stamp must be increasing"),
        ({"gyro": np.zeros((3, 3))}, "imu gyro must be of shape"),
        ({"accel": np.full((4, 3), np.nan)}, "imu accel must be free of NaN"),
    ],
)
def test_samples_that_cannot_be_are_told(change, told):
    arrays = {"stamp": np.arange(4.0), "gyro": np.zeros((4, 3)), "accel": np.zeros((4, 3)), **change}
    with pytest.raises(ValueError, match=told):
        ImuSeries(**arrays)


def test_noise_and_prior_that_cannot_be_are_told():
    with pytest.raises(ValueError, match="accel_density must be > 0"):
        ImuNoise(1e-3, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="gyro_walk must be >= 0"):
        ImuNoise(1e-3, 1e-2, -1.0, 0.0)
    with pytest.raises(ValueError, match=r"cov must be of shape \(15, 15\)"):
        ImuPrior(np.eye(4), *np.zeros((3, 3)), np.eye(9))


def test_frames_have_their_samples_and_a_sequence_without_has_none(short):
    plain = short.sequence
    sigma = np.ones((plain.observations, 3))
    assert all(frame.imu is None for frame in plain.frames(sigma))
    imu = series(np.arange(plain.stamp[0] - 0.1, plain.stamp[-1] + 0.1, 0.005))
    frames = list(replace(plain, imu=imu).frames(sigma))
    assert len(frames) == len(plain)
    for frame in frames[1:]:
        assert frame.imu.dt.sum() == pytest.approx(frame.dt, abs=1e-12)
    with pytest.raises(ValueError, match="WRITEABLE"):
        frames[1].imu.gyro.flags.writeable = True
    assert [frame.imu.dt.size for frame in replace(plain, imu=imu).first(1).frames(sigma[:0])] == [0]


def test_a_part_that_begins_later_has_not_the_state_of_the_first_frame(short):
    start = ImuPrior(np.eye(4), *np.zeros((3, 3)), np.eye(15))
    whole = replace(short.sequence, start=start)
    assert whole.first(3).start is start
    assert whole.part(1, 4).start is None


def test_the_open_track_format_has_raw_inertia(tmp_path):
    stamp = np.arange(-0.02, 0.6, 0.005)
    values = np.random.default_rng(3).normal(size=(len(stamp), 6))
    given = {"imu_stamp": stamp, "imu_gyro": values[:, :3], "imu_accel": values[:, 3:]}
    path = tracks_file(tmp_path / "a.npz", angular_velocity=None, linear_velocity=None, **given)
    found = load_tracks_npz(path).sequence
    assert np.array_equal(found.imu.accel, values[:, 3:])
    assert np.array_equal(found.twist, np.hstack([values[:, :3], np.zeros((len(stamp), 3))]))
    assert found.counts["imu_samples"] == len(stamp)
    write_tracks_npz(tmp_path / "b.npz", Recording(replace(found, clock_offset=0.5), None, None))
    again = load_tracks_npz(tmp_path / "b.npz").sequence.imu
    assert np.allclose(again.stamp, stamp - 0.5)
    assert np.array_equal(again.gyro, found.imu.gyro)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"imu_gyro": None}, "'imu_gyro' is missing"),
        ({"linear_velocity": None}, "'linear_velocity' is missing"),
        ({"imu_stamp": np.zeros(9)}, "'imu_stamp' must be increasing"),
        ({"imu_accel": np.full((9, 3), 1e4)}, "m/s\\^2, got 10000: is it in another unit"),
        ({"imu_gyro": np.zeros((8, 3))}, "'imu_gyro' must be of shape"),
        ({"imu_stamp": 0.0}, "'imu_stamp' must be of shape"),
    ],
)
def test_raw_inertia_that_cannot_be_is_told(tmp_path, changes, told):
    given = {"imu_stamp": 0.1 * np.arange(9), "imu_gyro": np.zeros((9, 3)), "imu_accel": np.zeros((9, 3))}
    with pytest.raises(DataError, match=told):
        load_tracks_npz(tracks_file(tmp_path / "a.npz", **{**given, **changes}))
