"""Held-out tracks: who is held out, what a trajectory scores, and which of two is better."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.conftest import from_first, recorded
from vislam.datasets.course_npz import load_course_npz
from vislam.evaluation.held_out import (
    CAP_PX,
    FEWEST_VIEWS,
    HeldOut,
    HeldOutScore,
    hold_out,
    paired,
    score,
)
from vislam.geometry import se3
from vislam.models.track_noise import SHARES
from vislam.simulation import SimulationConfig, simulate

SIGMA = 0.3


def drive(**settings):
    config = SimulationConfig(
        **{"frames": 60, "tracks_in_view": 40, "pixel_sigma_px": SIGMA, "depth_max": 50.0, **settings}
    )
    sequence, truth = simulate(config, seed=5, name="held out")
    return HeldOut.of(sequence, np.ones(sequence.observations, bool)), from_first(truth.world_T_imu)


@pytest.fixture(scope="module")
def straight():
    """All tracks of a drive are held out, and the true poses."""
    return drive()


def shaken(poses, sigma, seed=0):
    xi = sigma * np.random.default_rng(seed).standard_normal((len(poses), 6))
    return se3.retract(poses, xi)


def only(held, keep):
    return HeldOut(held.frame[keep], held.track[keep], held.z[keep], held.rig)


def views_of(held):
    views = np.bincount(held.track)
    return views[held.track]


def one_track(held, poses, track):
    """Score of one track, by SciPy on a point in the world, predicted views one by one."""
    rows = np.flatnonzero(held.track == track)
    rows = rows[np.argsort(held.frame[rows])]
    fitted, predicted = rows[::2], rows[1::2]

    def residual(point, row):
        cam_T_world = se3.inverse(poses[held.frame[row]] @ held.rig.imu_T_cam)
        seen = held.rig.project(se3.transform(cam_T_world, point[None]))[0]
        return (held.z[row] - seen) / SHARES

    start = se3.transform(
        poses[held.frame[fitted[0]]] @ held.rig.imu_T_cam, held.rig.back_project(held.z[fitted[:1]])
    )[0]
    found = least_squares(
        lambda point: np.concatenate([residual(point, row) for row in fitted]), start, xtol=1e-15, ftol=1e-15
    )
    return np.sqrt(np.mean([residual(found.x, row) ** 2 for row in predicted]))


def test_true_poses_score_at_the_noise_level(straight):
    held, truth = straight
    found = score(held, truth)
    long = only(held, views_of(held) >= 16)
    assert np.isclose(score(long, truth).median, SIGMA, rtol=0.1)
    # The point is uncertain as well, the more so the fewer views it has.
    assert SIGMA < found.capped_rms < 1.6 * SIGMA
    assert found.capped == 0


def test_without_noise_true_poses_score_nothing():
    held, truth = drive(pixel_sigma_px=0.0)
    assert score(held, truth).rms.max() < 1e-6


def test_the_score_grows_with_the_error_of_the_poses(straight):
    held, truth = straight
    noise = np.array([0.001, 0.001, 0.001, 0.02, 0.02, 0.02])
    found = [score(held, shaken(truth, factor * noise)) for factor in (0.0, 0.5, 1.0, 2.0, 4.0)]
    assert np.all(np.diff([one.median for one in found]) > 0.05)
    assert np.all(np.diff([one.capped_rms for one in found]) > 0.05)


def test_a_turn_and_a_scale_of_the_steps_are_seen_and_another_world_is_not(straight):
    held, truth = straight
    moved = se3.exp(np.array([0.3, -0.2, 1.0, 50.0, -20.0, 3.0])) @ truth
    assert np.allclose(score(held, moved).rms, score(held, truth).rms, rtol=0, atol=1e-9)
    longer = truth.copy()
    longer[:, :3, 3] *= 1.05
    step = se3.local(truth[:-1], truth[1:]) + np.array([0.0, 0.0, 0.003, 0.0, 0.0, 0.0])
    turning = np.array([np.eye(4)] * len(truth))
    for k, xi in enumerate(step):
        turning[k + 1] = turning[k] @ se3.exp(xi)
    for wrong in (longer, turning):
        assert score(held, wrong).median > 1.5 * score(held, truth).median


def test_a_few_wrong_tracks_matter_little(straight):
    held, truth = straight
    generator = np.random.default_rng(1)
    wrong = np.isin(held.track, generator.permutation(held.track.max())[: held.track.max() // 20])
    slipped = held.z + np.where(wrong[:, None], generator.uniform(-200.0, 200.0, held.z.shape), 0.0)
    clean, spoilt = score(held, truth), score(HeldOut(held.frame, held.track, slipped, held.rig), truth)
    assert np.array_equal(clean.track, spoilt.track)
    assert spoilt.capped > 0.02 * len(spoilt.rms)
    assert spoilt.median < 1.1 * clean.median
    assert spoilt.capped_rms < CAP_PX * np.sqrt(0.06)


def test_all_runs_are_scored_on_the_same_tracks(straight):
    held, truth = straight
    whole, begun = score(held, truth), score(held, truth[:30])
    late = [track for track in whole.track if held.frame[held.track == track].max() >= 30]
    assert np.array_equal(whole.track, begun.track)
    assert np.array_equal(begun.rms == CAP_PX, np.isin(whole.track, late))
    assert np.array_equal(begun.rms[begun.rms < CAP_PX], whole.rms[begun.rms < CAP_PX])
    assert np.all(score(held, truth[:0]).rms == CAP_PX)


def test_what_lies_behind_a_camera_is_capped(straight):
    held, truth = straight
    turn = se3.exp(np.array([0.0, 0.0, np.pi, 0.0, 0.0, 0.0]))
    back = np.where((np.arange(len(truth)) % 2 == 0)[:, None, None], truth @ turn, truth)
    assert np.all(score(held, back).rms == CAP_PX)


def test_poses_are_found_by_their_frames(straight):
    held, truth = straight
    frames = np.arange(10, 40)
    some = only(held, (held.frame >= 10) & (held.frame < 40))
    assert np.array_equal(score(some, truth[frames], frame=frames).rms, score(some, truth).rms)


def test_neither_the_order_of_observations_nor_the_company_matters(straight):
    held, truth = straight
    found = score(held, truth)
    mixed = np.random.default_rng(2).permutation(len(held.track))
    assert np.array_equal(score(only(held, mixed), truth).rms, found.rms)
    few = found.track[::7]
    assert np.allclose(score(only(held, np.isin(held.track, few)), truth).rms, found.rms[::7], atol=1e-12)


def test_a_track_with_too_few_views_is_left_out(straight):
    held, truth = straight
    views = np.bincount(held.track)
    assert np.any((views > 0) & (views < FEWEST_VIEWS))
    assert np.array_equal(score(held, truth).track, np.flatnonzero(views >= FEWEST_VIEWS))
    none = score(only(held, views_of(held) < FEWEST_VIEWS), truth)
    assert len(none.rms) == 0
    assert np.isnan(none.median)
    assert np.isnan(none.capped_rms)


def test_all_tracks_at_once_are_one_after_the_other_by_scipy(straight):
    held, truth = straight
    poses = shaken(truth, np.array([0.0005, 0.0005, 0.0005, 0.01, 0.01, 0.01]))
    found = score(held, poses)
    each = [one_track(held, poses, track) for track in found.track[::5]]
    assert np.allclose(found.rms[::5], each, rtol=1e-4)


def test_the_choice_is_of_whole_tracks_and_seeded(straight):
    track = straight[0].track
    chosen = hold_out(track, share=0.1, seed=1)
    assert np.array_equal(chosen, hold_out(track, share=0.1, seed=1))
    assert not np.array_equal(chosen, hold_out(track, share=0.1, seed=2))
    assert set(track[chosen]).isdisjoint(track[~chosen])
    order = np.random.default_rng(3).permutation(len(track))
    assert np.array_equal(hold_out(track[order], share=0.1, seed=1), chosen[order])
    fewer = track % 3 != 0
    assert np.array_equal(hold_out(track[fewer], share=0.1, seed=1), chosen[fewer])


def test_about_the_share_is_held_out_of_the_tracks_with_enough_views():
    track = np.repeat(np.arange(10_000), np.arange(10_000) % 8)
    held = np.unique(track[hold_out(track, share=0.1, seed=0)])
    assert np.all(held % 8 >= FEWEST_VIEWS)
    # Of 5000 tracks; four standard deviations are 85.
    assert abs(len(held) - 500) < 85
    assert not hold_out(np.empty(0, np.int64), share=0.1, seed=0).any()


def test_a_share_of_nothing_is_nothing():
    assert not hold_out(np.repeat(np.arange(50), 5), share=0.0, seed=0).any()


@pytest.mark.parametrize("share", [1.0, -0.1])
def test_a_share_is_none_or_more_and_not_all(share):
    with pytest.raises(ValueError, match="share"):
        hold_out(np.arange(3), share=share, seed=0)


def test_the_better_of_two_is_found():
    held, truth = drive(frames=200)
    noise = np.array([0.0005, 0.0005, 0.0005, 0.01, 0.01, 0.01])
    good, bad = score(held, shaken(truth, noise)), score(held, shaken(truth, 1.5 * noise, seed=1))
    found, turned = paired(good, bad), paired(bad, good)
    assert 0.5 < found.low < found.better < found.high
    # Seven blocks: 2^-6 at least.
    assert found.p_value < 0.05
    assert found.gain > 0.0
    assert np.isclose(found.better + turned.better, 1.0)
    assert np.isclose(found.gain, -turned.gain)


def test_blocks_of_a_long_sequence_are_longer(rng):
    frame = np.sort(rng.integers(0, 100_000, 4000))
    frame[-1] = 99_999
    scores = [HeldOutScore(np.arange(4000), frame, np.abs(rng.normal(size=4000))) for _ in range(2)]
    # A 250th of the sequence has 400 frames: as if these were the thirty of a short one.
    short = [replace(one, frame=30 * (frame // 400)) for one in scores]
    assert paired(*scores) == paired(*short)
    assert paired(*scores) != paired(*(replace(one, frame=30 * (frame // 800)) for one in scores))


def test_a_run_is_no_better_than_itself(straight):
    found = score(*straight)
    same = paired(found, found)
    assert (same.better, same.low, same.high, same.p_value, same.gain) == (0.5, 0.5, 0.5, 1.0, 0.0)


@pytest.mark.statistical
def test_equal_runs_are_seldom_told_apart():
    """Two runs with poses equally wrong: the p-value is below a tenth in about a tenth of the cases."""
    held, truth = drive(frames=300, tracks_in_view=15)
    noise = np.array([0.0005, 0.0005, 0.0005, 0.01, 0.01, 0.01])
    scores = [score(held, shaken(truth, noise, seed=seed)) for seed in range(80)]
    false = sum(paired(*pair).p_value < 0.1 for pair in zip(scores[::2], scores[1::2], strict=True))
    # Binomial (40, 0.1): more than 10 has a chance of 0.5 %.
    assert false <= 10


def test_runs_with_other_tracks_are_not_compared(straight):
    held, truth = straight
    found = score(held, truth)
    fewer = score(only(held, held.track != found.track[0]), truth)
    none = score(only(held, held.track < 0), truth)
    for one, other in ((found, fewer), (none, none)):
        with pytest.raises(ValueError, match="same tracks"):
            paired(one, other)


def test_a_recorded_tenth_is_scored_at_once():
    sequence = load_course_npz(recorded("03.npz"))
    held = HeldOut.of(sequence, hold_out(sequence.track, share=0.1, seed=0))
    found = score(held, np.broadcast_to(np.eye(4), (len(sequence), 4, 4)))
    assert len(found.rms) > 300
    assert found.median > 5.0
