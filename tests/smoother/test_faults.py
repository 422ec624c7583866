"""Planted faults: whatever the data do, the run ends with finite poses or says why it did not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import from_first
from tests.smoother import drives
from tests.smoother.drives import ate, drive, member
from vislam.comparison.config import KernelConfig
from vislam.repair.tracks import Interruptions

FRAMES = 45
MEMBERS = ["isam2", "fixed_lag", "batch"]
FAULTS = {
    "negative disparities": drives.negative_disparities,
    "one frame without tracks": drives.dark(15, 1),
    "20 frames without tracks": drives.dark(15, 20),
    "a teleporting track": drives.teleporting_track,
    "landmarks on the baseline": drives.landmark_on_the_baseline,
    "repeated frames": drives.repeated_frames,
    "a first frame without tracks": drives.dark(0, 1),
}


def check_usable(run, frames):
    """Finite poses of all frames, or of all up to the error."""
    assert np.isfinite(run.final.world_T_imu).all()
    assert np.isfinite(run.filtered.world_T_imu).all()
    assert run.frames_expected == frames
    if run.complete:
        assert len(run.final.world_T_imu) == frames
    else:
        assert run.log.error.startswith(f"frame {len(run.final.world_T_imu)}: ")
        assert len(run.log.error) > len("frame 00: ")


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
@pytest.mark.parametrize("name", MEMBERS)
def test_wrong_associations_do_not_end_the_run(name, share):
    config, dataset = drive(seed=8, frames=FRAMES, tracks_in_view=25, outlier_probability=share)
    run = member(name, config, dataset)
    check_usable(run, FRAMES)
    assert run.complete


@pytest.mark.parametrize(
    ("seed", "share", "lag", "frames"),
    [(1, 0.4, 1.0, 50), (3, 0.2, 3.0, 75), (5, 0.2, 3.0, 85), (7, 0.4, 3.0, 80), (10, 0.2, 1.0, 120)],
)
def test_a_lag_outlives_what_was_set_aside_and_stays_in_its_marginals(seed, share, lag, frames):
    """Drives in which a landmark broke the step and was no longer in any factor but a marginal."""
    config, dataset = drive(seed=seed, frames=120, tracks_in_view=25, outlier_probability=share)
    dataset = replace(dataset, sequence=dataset.sequence.first(frames))
    run = member(
        "fixed_lag",
        config,
        dataset,
        lag_s=lag,
        relinearize_every=5,
        landmark_threshold=0.15,
        pose_threshold_rad=0.01,
        pose_threshold_m=0.1,
        factorization="qr",
        wildfire_threshold=0.1,
    )
    check_usable(run, frames)
    assert run.complete
    assert run.log.counts["recoveries"] > 0
    assert len(run.log.events) == run.log.counts["recoveries"]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", MEMBERS)
def test_a_fault_does_not_end_the_run(name, fault):
    config, dataset = drive(seed=8, frames=FRAMES, tracks_in_view=25)
    dataset = replace(dataset, sequence=FAULTS[fault](dataset.sequence))
    run = member(name, config, dataset)
    check_usable(run, FRAMES)
    assert run.complete
    if "tracks" in fault or "teleporting" in fault:
        assert ate(run.final.world_T_imu, dataset) < 1.0
    if "20 frames" in fault:
        error = run.final.world_T_imu[:, :3, 3] - from_first(dataset.reference.pose)[:, :3, 3]
        assert np.abs(error).max() < 1.0


def with_outliers(dataset, share):
    """Some observations off by up to 50 px, all else as it was."""
    rng = np.random.default_rng(1)
    pixels = dataset.sequence.pixels.copy()
    wrong = rng.random(len(pixels)) < share
    pixels[wrong] += rng.uniform(-50.0, 50.0, (int(wrong.sum()), 4))
    return replace(dataset, sequence=replace(dataset.sequence, pixels=pixels))


@pytest.mark.slow
@pytest.mark.parametrize("name", MEMBERS)
def test_a_robust_kernel_keeps_outliers_from_harming(name):
    """On the mean of six drives: on a single one, which observations are lost matters by a third."""
    without, with_them = [], []
    for seed in range(12, 18):
        config, good = drive(seed=seed, frames=80, tracks_in_view=40)
        bad = with_outliers(good, 0.1)
        student = replace(config, kernel=KernelConfig())
        without.append(ate(member(name, student, good).final.world_T_imu, good))
        with_them.append(ate(member(name, student, bad).final.world_T_imu, bad))
        assert ate(member(name, config, bad).final.world_T_imu, bad) > 3.0 * with_them[-1]
    assert np.mean(with_them) < max(1.2 * np.mean(without), np.mean(without) + 0.01)


def test_gnc_finds_the_outliers():
    config, good = drive(seed=12, frames=50, tracks_in_view=30)
    bad = with_outliers(good, 0.03)
    run = member("batch_gnc", config, bad)
    assert run.complete
    wrong = np.any(bad.sequence.pixels != good.sequence.pixels, axis=1)
    assert not run.used[wrong].any()
    assert run.used[~wrong].mean() > 0.9
    assert 0.5 * wrong.sum() < run.log.counts["outliers"] < wrong.sum()
    assert ate(run.final.world_T_imu, bad) < 0.5 * ate(member("batch", config, bad).final.world_T_imu, bad)


def test_tracks_that_are_never_clear_leave_dead_reckoning():
    config, dataset = drive(seed=8, frames=30, tracks_in_view=20)
    run = member("isam2", config, dataset, initialisation_snr=1e6)
    assert run.complete
    assert not run.used.any()
    assert len(run.landmarks.track) == 0
    assert run.log.counts["landmarks_too_weak"] == len(np.unique(dataset.sequence.track))
    assert ate(run.final.world_T_imu, dataset) < 1.0


def test_a_sequence_without_any_track_is_dead_reckoning():
    config, dataset = drive(seed=8, frames=20, tracks_in_view=20)
    nothing = np.zeros(dataset.sequence.observations, bool)
    dataset = replace(dataset, sequence=Interruptions().apply(dataset.sequence.select(nothing)))
    for name in MEMBERS:
        run = member(name, config, dataset, sigma=np.empty((0, 3)))
        assert run.complete
        assert ate(run.final.world_T_imu, dataset) < 1.0
