"""A front end that re-detects in bursts, loses tracks by their flow and errs by a share of the disparity."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.geometry import se3
from vislam.repair.tracks import duplicated_observations
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.drive import stereo_rig
from vislam.simulation.field import in_view

STEADY = SimulationConfig(frames=400, tracks_in_view=60, loss_probability=0.05)
BURSTS = replace(STEADY, redetect_below=40)


def simulated(config, seed=5):
    return simulate(config, seed=seed, name="s")


def ids(sequence, frame):
    return sequence.track[sequence.offset[frame] : sequence.offset[frame + 1]]


def first_frames(sequence):
    """Frame in which each track is born."""
    _, first = np.unique(sequence.track, return_index=True)
    return sequence.frame_of[first]


def test_tracks_are_born_in_duplicated_frames_only_and_these_follow_frames_of_few():
    # With so wide a spread, some bursts bring too few.
    sequence, _ = simulated(replace(BURSTS, tracks_spread=0.5))
    duplicated, _ = duplicated_observations(sequence)
    before = np.diff(sequence.offset)[:-1]
    assert np.any(duplicated[:-1] & (np.diff(sequence.offset)[:-1] < 40))
    assert set(first_frames(sequence)) <= {0, *np.flatnonzero(duplicated)}
    assert before[duplicated[1:]].max() < 40
    # All frames of few are followed by a duplicated one, but for those that are duplicated themselves.
    assert np.array_equal(duplicated[1:], (before < 40) & ~duplicated[:-1])


def test_a_front_end_without_bursts_is_not_taken_for_one_with_them():
    sequence, _ = simulated(replace(STEADY, duplication_probability=0.1))
    duplicated, _ = duplicated_observations(sequence)
    assert len(set(first_frames(sequence)) - set(np.flatnonzero(duplicated))) > 100


def test_no_track_is_lost_in_the_frame_of_a_burst():
    sequence, _ = simulated(BURSTS)
    duplicated, _ = duplicated_observations(sequence)
    for k in np.flatnonzero(duplicated):
        assert np.isin(ids(sequence, k - 1), ids(sequence, k)).all()


@pytest.mark.statistical
def test_after_a_burst_there_are_as_many_tracks_as_drawn():
    config = replace(BURSTS, frames=2000, tracks_in_view=100, tracks_spread=0.1)
    sequence, _ = simulated(config)
    duplicated, _ = duplicated_observations(sequence)
    there = np.diff(sequence.offset)[duplicated]
    # Five standard deviations of a mean and of a standard deviation; nobody draws less than 40 here.
    assert there.mean() == pytest.approx(100.0, abs=5.0 * 10.0 / np.sqrt(len(there)))
    assert there.std() == pytest.approx(10.0, abs=5.0 * 10.0 / np.sqrt(2.0 * len(there)))


def test_re_detection_waits_for_a_frame_that_is_written():
    sequence, _ = simulated(replace(BURSTS, dropped_probability=0.2))
    duplicated, _ = duplicated_observations(sequence)
    empty = np.diff(sequence.offset) == 0
    assert duplicated.sum() > 10
    assert not np.any(duplicated & empty)
    assert not np.any(duplicated[1:] & empty[:-1])


def test_when_all_tracks_are_lost_new_ones_are_born():
    sequence, _ = simulated(replace(BURSTS, frames=30, loss_probability=1.0))
    assert np.diff(sequence.offset).min() > 0


def test_short_tracks_are_left_out_and_nothing_else():
    whole, truth = simulated(BURSTS)
    long, long_truth = simulated(replace(BURSTS, shortest_track=3))
    length = np.bincount(whole.track)
    kept = length[whole.track] >= 3
    assert 0 < kept.sum() < len(kept)
    assert np.array_equal(long.pixels, whole.pixels[kept])
    assert np.array_equal(long.frame_of, whole.frame_of[kept])
    assert np.array_equal(long_truth.points_world, truth.points_world[kept])
    assert np.bincount(long.track).min() >= 3
    _, first = np.unique(long.track, return_index=True)
    assert np.array_equal(long.track[first], np.arange(len(first)))


def survival(config):
    """Flow of each track that stays in view [px], and whether it goes on, by the truth."""
    sequence, truth = simulated(config)
    rig = stereo_rig(config)
    cam_T_world = se3.inverse(truth.world_T_imu @ rig.imu_T_cam)
    flow, kept = [], []
    for k in range(len(sequence) - 1):
        rows = slice(sequence.offset[k], sequence.offset[k + 1])
        point = truth.points_world[rows]
        now, later = (se3.transform(cam_T_world[frame], point) for frame in (k, k + 1))
        stays = in_view(config, rig, later)
        moved = (rig.project(later[stays]) - rig.project(now[stays]))[:, [0, 2]]
        flow.append(np.linalg.norm(moved, axis=1))
        kept.append(np.isin(sequence.track[rows][stays], ids(sequence, k + 1)))
    return np.concatenate(flow), np.concatenate(kept)


@pytest.mark.statistical
def test_losses_grow_with_the_flow_as_set():
    config = replace(STEADY, loss_probability=0.0, pixel_sigma_px=0.0, loss_flow_px=100.0)
    flow, kept = survival(config)
    chance = np.exp(-flow / 100.0)
    for low, high in ((0.0, 3.0), (3.0, 10.0), (10.0, 30.0), (30.0, 100.0)):
        inside = (flow >= low) & (flow < high)
        assert inside.sum() > 200
        sigma = np.sqrt(np.sum((chance * (1.0 - chance))[inside]))
        assert kept[inside].sum() == pytest.approx(chance[inside].sum(), abs=5.0 * sigma)


@pytest.mark.statistical
def test_without_the_setting_losses_have_nothing_to_do_with_the_flow():
    flow, kept = survival(replace(STEADY, loss_probability=0.1, pixel_sigma_px=0.0))
    fast = flow > np.quantile(flow, 0.8)
    within = 5.0 * np.sqrt(0.09 / fast.sum())
    assert kept[fast].mean() == pytest.approx(0.9, abs=within)
    assert kept[~fast].mean() == pytest.approx(0.9, abs=within)


@pytest.mark.statistical
def test_the_match_errs_by_a_student_share_that_stays_with_the_track():
    config = replace(STEADY, pixel_sigma_px=0.0, matching_bias_share=0.05, loss_probability=0.2)
    sequence, truth = simulated(config)
    rig = stereo_rig(config)
    cam_T_world = se3.inverse(truth.world_T_imu @ rig.imu_T_cam)
    seen = np.einsum("nij,nj->ni", cam_T_world[sequence.frame_of][:, :3, :3], truth.points_world)
    seen += cam_T_world[sequence.frame_of][:, :3, 3]
    share = sequence.disparity * seen[:, 2] / (rig.fx * rig.baseline) - 1.0
    _, first, back = np.unique(sequence.track, return_index=True, return_inverse=True)
    assert share == pytest.approx(share[first][back], abs=1e-9)
    # Quantiles of |t| with two degrees of freedom; a normal of the same median would have 2.4 at 95 %.
    half, most = np.quantile(np.abs(share[first]), [0.5, 0.95]) / 0.05
    assert half == pytest.approx(0.816, rel=0.1)
    assert most == pytest.approx(4.30, rel=0.2)
