"""Errors drawn from what a run claims are consistent with it; planted faults in the claim are found."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.evaluation.test_statistics import decaying
from tests.records import altered
from vislam.core.reference import Reference
from vislam.core.run import StateHistory
from vislam.core.step import TWIST_BIAS
from vislam.core.trajectory import Poses
from vislam.evaluation.alignment import align
from vislam.evaluation.normalised import (
    PARTS,
    PROBABILITIES,
    Normalised,
    bias_errors,
    nis_statistic,
    nis_whiteness,
    pose_errors,
    position_errors,
)
from vislam.geometry import se3

FRAMES = 500
LENGTH = 3.0
SUSPECT = 1e-3
MOVE = se3.exp(np.array([0.0, 0.0, 0.8, 10.0, -20.0, 3.0]))
SWAP = [3, 4, 5, 0, 1, 2]


def nees(error, cov):
    """Normalised squared errors ``(n,)`` by their definition."""
    return np.array([one @ np.linalg.inv(matrix) @ one for one, matrix in zip(error, cov, strict=True)])


def body_cov():
    """Covariance on the right of a pose: more certain across the way than along it, and correlated."""
    sigma = np.array([1e-3, 2e-3, 8e-3, 0.5, 0.05, 0.1])
    correlation = np.eye(6)
    correlation[2, 4] = correlation[4, 2] = 0.9
    correlation[1, 5] = correlation[5, 1] = -0.9
    return correlation * np.outer(sigma, sigma)


def drive(rng):
    """A true drive and a run that starts exactly and claims the covariance its errors are drawn from."""
    truth = circle(frames=FRAMES)
    error = decaying(LENGTH, 6)(rng) @ np.linalg.cholesky(body_cov()).T
    error[0] = 0.0
    estimate = truth @ se3.inverse(se3.exp(error))
    return truth, made_run("one", estimate, cov=np.tile(body_cov(), (FRAMES, 1, 1)))


def p_values(run, reference):
    return {part: found.statistic().p_value() for part, found in pose_errors(run, reference).items()}


def test_errors_drawn_from_the_claim_are_consistent_with_it(rng):
    truth, run = drive(rng)
    found = pose_errors(run, of_truth(truth))
    assert set(found) == {"pose", "rotation", "position"}
    for part, one in found.items():
        statistic = one.statistic()
        assert statistic.name == f"nees_{part}"
        assert statistic.p_value() > SUSPECT
        low, high = statistic.interval(0.999)
        assert low < statistic.value < high
    assert np.allclose(
        found["pose"].nees,
        np.einsum("ti,ij,tj->t", found["pose"].error, np.linalg.inv(body_cov()), found["pose"].error),
    )


def in_world(cov, pose):
    turn = np.zeros((len(pose), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = pose[:, :3, :3]
    return turn @ cov @ turn.transpose(0, 2, 1)


FAULTS = {
    "tangent order swapped": lambda cov, pose: cov[:, SWAP][:, :, SWAP],
    "half the noise": lambda cov, pose: 0.25 * cov,
    "twice the noise": lambda cov, pose: 4.0 * cov,
    "sign between rotation and translation": lambda cov, pose: (
        cov * np.kron([[1, -1], [-1, 1]], np.ones((3, 3)))
    ),
    "world axes": in_world,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_in_the_claim_is_found(rng, fault):
    truth, run = drive(rng)
    wrong = altered(run, cov=FAULTS[fault](run.final.covariances, run.final.world_T_imu))
    assert p_values(run, of_truth(truth))["pose"] > SUSPECT
    assert p_values(wrong, of_truth(truth))["pose"] < SUSPECT


def test_worlds_are_joined_and_a_rigid_motion_of_either_changes_nothing(rng):
    truth, run = drive(rng)
    plain = pose_errors(run, of_truth(truth))
    moved = altered(run, world_T_imu=se3.exp(rng.normal(size=6)) @ run.final.world_T_imu)
    other = pose_errors(moved, of_truth(se3.exp(rng.normal(size=6)) @ truth))
    for part in plain:
        assert np.allclose(plain[part].nees, other[part].nees, rtol=1e-6)


def test_an_error_that_stays_in_the_world_counts_once_though_the_body_turns():
    # Twenty times round.
    truth = np.concatenate([circle(frames=FRAMES // 20)] * 20)
    estimate = truth.copy()
    estimate[1:, :3, 3] += [1.0, -0.5, 0.2]
    cov = np.tile(np.diag([1e-6] * 3 + [0.5] * 3), (FRAMES, 1, 1))
    found = pose_errors(made_run("one", estimate, cov=cov), of_truth(truth))["position"]
    assert np.ptp(found.error[:, 0]) > 1.0
    assert found.statistic().effective == 1.0


def test_another_point_of_the_body_has_another_position_error_and_the_same_pose_nees(rng):
    truth, run = drive(rng)
    lever = se3.exp(np.array([0.3, -0.2, 1.0, 2.0, -1.0, 0.5]))
    there = truth @ lever
    reference = replace(of_truth(there), imu_T_point=lever)
    here, moved = pose_errors(run, of_truth(truth)), pose_errors(run, reference)
    assert np.allclose(here["pose"].nees, moved["pose"].nees, rtol=1e-6)
    assert not np.allclose(here["position"].nees, moved["position"].nees, rtol=1e-2)
    # The point swings about the body as the body turns.
    error = np.einsum("tij,tj->ti", se3.adjoint(se3.inverse(lever))[None], here["pose"].error)
    assert np.allclose(moved["pose"].error, error, atol=1e-9)
    for one in moved.values():
        assert one.statistic().p_value() > SUSPECT


def test_frames_without_a_claim_are_left_out(rng):
    truth, run = drive(rng)
    cov = run.final.covariances.copy()
    cov[5] = np.nan
    cov[6] = 0.0
    cov[7] = np.ones((6, 6))
    cov[8] = 1e-30 * np.eye(6)
    found = pose_errors(altered(run, cov=cov), of_truth(truth))
    for one in found.values():
        assert np.array_equal(one.index, [*range(1, 5), *range(9, FRAMES)])
        assert one.statistic().samples == FRAMES - 5


def test_a_covariance_that_is_positive_definite_in_some_axes_only_is_left_out(rng):
    """With rounding, one of variances 1e29 and 1e-4 is so in the body's axes, and not in those that stay."""
    truth, run = drive(rng)
    cov = run.final.covariances.copy()
    cov[40] = np.diag([1e-4, 1e-4, 1e29, 1e-4, 1e29, 1e-4])
    found = pose_errors(altered(run, cov=cov), of_truth(truth))["pose"]
    assert 40 not in found.index
    assert np.isfinite(found.nees).all()


def test_nothing_is_said_of_a_run_or_a_reference_that_does_not_give_it(rng):
    truth, run = drive(rng)
    run = replace(run, filtered=Poses(run.filtered.world_T_imu), smoothed=run.filtered)
    assert pose_errors(run, of_truth(truth), estimate="filtered") is None
    assert pose_errors(run, replace(of_truth(truth), pose=None)) is None
    assert (
        position_errors(run, of_truth(truth), planar=True, reference_sigma=1.0, estimate="filtered") is None
    )
    assert bias_errors(run, np.zeros(6)) is None
    assert nis_statistic(run) is None
    assert nis_whiteness(run) is None


def test_filtered_poses_have_their_own_covariances(rng):
    truth, run = drive(rng)
    both = replace(
        run,
        filtered=Poses(run.final.world_T_imu, 4.0 * run.final.cov),
        smoothed=Poses(truth, run.final.cov),
    )
    alone, own = pose_errors(run, of_truth(truth)), pose_errors(both, of_truth(truth), estimate="filtered")
    assert np.allclose(own["pose"].nees, 0.25 * alone["pose"].nees)
    assert own["pose"].name == "nees_pose"
    assert np.allclose(pose_errors(both, of_truth(truth))["pose"].nees, 0.0)
    with pytest.raises(ValueError, match="smoothed poses"):
        pose_errors(run, of_truth(truth), estimate="smoothed")


def surveyed(truth, size):
    """Positions of a point of the body, in a world of somebody else's."""
    lever = se3.exp(np.array([0.0, 0.0, 0.4, 1.0, 0.5, 0.2]))
    position = (MOVE @ truth @ lever)[:, :size, 3]
    return Reference("survey", "", np.arange(len(truth)), position, None, lever)


@pytest.mark.parametrize("planar", [True, False])
def test_positions_alone_are_compared_wherever_their_world_lies(rng, planar):
    truth, run = drive(rng)
    reference = surveyed(truth, 2 if planar else 3)
    sound = position_errors(run, reference, planar=planar, reference_sigma=0.0)
    assert sound.error.shape == (FRAMES, 2 if planar else 3)
    assert sound.statistic().value == pytest.approx(1.0, abs=0.15)
    assert "only values above 1 accuse" in sound.convention
    wrong = altered(run, cov=in_world(run.final.covariances, run.final.world_T_imu))
    assert (
        position_errors(wrong, reference, planar=planar, reference_sigma=0.0).statistic().p_value() < SUSPECT
    )
    # The survey's own error, ten times that of the run.
    rough = replace(
        reference, position=reference.position + rng.normal(scale=5.0, size=reference.position.shape)
    )
    assert position_errors(run, rough, planar=planar, reference_sigma=0.0).statistic().value > 10.0
    blamed = position_errors(run, rough, planar=planar, reference_sigma=5.0)
    assert blamed.statistic().value == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("planar", [True, False])
def test_an_alignment_does_not_accuse_a_run_that_was_sure_of_its_start(rng, planar):
    truth, estimates, cov = reckoned(rng, runs=20)
    size = 2 if planar else 3
    reference = replace(surveyed(truth, size), imu_T_point=np.eye(4), position=(MOVE @ truth)[:, :size, 3])
    least_distance = []
    for pose in estimates.transpose(1, 0, 2, 3):
        found = position_errors(
            made_run("one", pose, cov=cov), reference, planar=planar, reference_sigma=1e-3
        )
        assert found.statistic().p_value() > SUSPECT
        # No worse than with the true motion between the worlds.
        place = pose[:, :size, 3]
        claim = (pose[:, :3, :3] @ cov[:, 3:, 3:] @ pose[:, :3, :3].transpose(0, 2, 1))[:, :size, :size]
        claim = claim + 1e-6 * np.eye(size)
        assert found.nees.mean() <= nees(truth[:, :size, 3] - place, claim).mean() * (1.0 + 1e-6)
        rotation, translation = align(reference.position, place)
        least_distance.append(nees(reference.position @ rotation.T + translation - place, claim).mean())
    # What the alignment of the least distance does: late errors come where the run is sure.
    assert np.median(least_distance) > 4.0 * size


def test_the_bias_is_compared_with_the_true_one(rng):
    true = np.array([0.01, 0.02, -0.01, 0.1, 0.0, -0.1])
    sigma = np.tile(np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2]), (FRAMES, 1))
    bias = true - sigma * decaying(LENGTH, 6)(rng)
    # The first is not given.
    sigma[0] = np.nan
    run = made_run("one", circle(frames=FRAMES), states={TWIST_BIAS: StateHistory(bias, sigma)})
    found = bias_errors(run, true)
    assert np.array_equal(found.index, np.arange(1, FRAMES))
    assert found.statistic().p_value() > SUSPECT
    assert np.allclose(found.nees, bias_errors(run, np.tile(true, (FRAMES + 3, 1))).nees)
    assert bias_errors(run, -true).statistic().p_value() < SUSPECT
    bias[7] = np.nan
    assert 7 not in bias_errors(altered(run, states={TWIST_BIAS: StateHistory(bias, sigma)}), true).index


def test_the_nis_is_averaged_over_the_frames_that_fuse_something(rng):
    dof = rng.integers(0, 4, FRAMES) * 30
    nis = np.array([np.sum(rng.normal(size=count) ** 2) for count in dof])
    run = made_run("one", circle(frames=FRAMES), nis=nis, dof=dof)
    found = nis_statistic(run)
    assert found.value == pytest.approx(run.nis_per_dof)
    assert found.samples == np.sum(dof > 0)
    assert found.p_value() > SUSPECT
    assert nis_statistic(altered(run, nis=0.25 * nis)).p_value() < SUSPECT
    assert nis_whiteness(run).p_value > SUSPECT


def test_the_coverage_curve_of_a_sound_claim_is_the_diagonal_and_of_a_bold_one_below_it(rng):
    truth, run = drive(rng)
    bold = altered(run, cov=0.25 * run.final.covariances)
    for part, one in pose_errors(run, of_truth(truth)).items():
        curve = one.coverage_curve()
        assert curve.shape == PROBABILITIES.shape
        assert curve[0] == 0.0
        assert curve[-1] == 1.0
        assert np.abs(curve - PROBABILITIES).max() < 0.12
        below = pose_errors(bold, of_truth(truth))[part].coverage_curve()
        assert (PROBABILITIES - below).max() > 0.4


def test_shares_within_multiples_are_those_of_normal_errors(rng):
    truth, run = drive(rng)
    one = pose_errors(run, of_truth(truth))["pose"]
    found = one.within()
    assert found.shape == (3, 6)
    assert np.allclose(found.T, [0.683, 0.954, 0.997], atol=0.1)
    # Of a claim of twice as much, those within one standard deviation are those within two.
    assert np.array_equal(replace(one, sigma=2.0 * one.sigma).within((1.0,))[0], found[1])


def reckoned(rng, runs, frames=200):
    """A winding drive, and many runs of dead reckoning over it with their exact covariances."""
    sigma = np.array([1e-4, 1e-4, 3e-4, 0.02, 0.01, 0.01])
    twist = np.zeros((frames, 6))
    twist[:, 3] = 1.0
    twist[:, 2] = 0.02 * np.sin(np.arange(frames) / 40.0)
    step = se3.exp(twist)
    truth, estimate, cov = [np.eye(4)], [np.tile(np.eye(4), (runs, 1, 1))], [1e-12 * np.eye(6)]
    for motion in step[1:]:
        back = se3.adjoint(se3.inverse(motion))
        truth.append(truth[-1] @ motion)
        estimate.append(estimate[-1] @ motion @ se3.exp(sigma * rng.normal(size=(runs, 6))))
        cov.append(back @ cov[-1] @ back.T + np.diag(sigma**2))
    return np.array(truth), np.array(estimate), np.array(cov)


@pytest.mark.statistical
def test_dead_reckoning_whose_errors_never_decorrelate_is_accused_no_more_often_than_stated(rng):
    truth, estimates, cov = reckoned(rng, runs=100)
    reference = of_truth(truth)
    sound = [p_values(made_run("one", estimates[:, k], cov=cov), reference) for k in range(100)]
    for part in PARTS:
        found = np.array([one[part] for one in sound])
        for nominal in (0.01, 0.05):
            assert np.sum(found < nominal) <= binom.ppf(0.999, 100, nominal)
    bold = [p_values(made_run("one", estimates[:, k], cov=cov / 9.0), reference) for k in range(100)]
    assert np.mean([one["pose"] < SUSPECT for one in bold]) > 0.8


def test_the_scale_gap_and_the_90_percent_region_are_those_of_the_medians(rng):
    """By hand, as an outside tool defines them: root of the median NEES over the median of chi-square."""
    whitened = 3.0 * rng.normal(size=(4000, 3))
    claim = Normalised("nees_position", np.arange(4000), whitened, np.ones((4000, 3)), whitened, "")
    by_hand = np.sqrt(np.median(np.sum(whitened**2, axis=1)) / 2.365974)
    assert claim.scale_gap() == pytest.approx(by_hand, rel=1e-6)
    assert claim.scale_gap() == pytest.approx(3.0, rel=0.05)
    held = np.mean(np.sum(whitened**2, axis=1) <= 6.251389)
    assert claim.coverage_curve(np.array([0.9]))[0] == pytest.approx(held, abs=1e-9)


def test_of_a_run_that_measured_gravity_roll_and_pitch_count(rng):
    """Worlds are joined by heading and position; of another run the whole first pose is free."""
    truth, run = drive(rng)
    off = se3.exp(np.array([0.0, 0.0, 2.1, 3.0, -1.0, 0.5])) @ se3.exp(np.array([0.02, -0.01, 0, 0, 0, 0]))
    tilted = altered(run, world_T_imu=off @ truth)
    free = pose_errors(tilted, of_truth(truth))["rotation"]
    upright = pose_errors(replace(tilted, upright=True), of_truth(truth))["rotation"]
    assert np.allclose(free.error, 0.0, atol=1e-9)
    assert np.allclose(np.linalg.norm(upright.error, axis=1), np.hypot(0.02, 0.01), rtol=1e-3)
    assert "by heading and position" in upright.convention
    turned = altered(
        run, world_T_imu=se3.exp(np.array([0.0, 0.0, 2.1, 3.0, -1.0, 0.5])) @ truth, upright=True
    )
    assert np.allclose(pose_errors(turned, of_truth(truth))["pose"].error, 0.0, atol=1e-9)


@pytest.mark.parametrize("planar", [True, False])
def test_an_alignment_takes_from_shared_errors_what_it_takes_from_the_poses(rng, planar):
    truth, _ = drive(rng)
    share = np.linspace(0.0, 1.0, FRAMES)[:, None]
    # A heading that goes off, which is nearly a turn of the world; a scale; something that comes and goes.
    shared = 0.3 * np.stack(
        [
            np.hstack([np.zeros((FRAMES, 3)), share**power * direction])
            for power, direction in ((2, [0.0, 1, 0]), (1, [1.0, 0, 0]), (3, [0.0, 0, 1]), (4, [0.5, 0.5, 0]))
        ]
    )
    reference = replace(surveyed(truth, 2 if planar else 3), imu_T_point=np.eye(4))
    reference = replace(reference, position=(MOVE @ truth)[:, : reference.position.shape[1], 3])
    cov = np.tile(1e-4 * np.eye(6), (FRAMES, 1, 1))
    whole, aligned = [], []
    for _ in range(40):
        error = np.einsum("c,cti->ti", rng.standard_normal(4), shared) + 0.01 * rng.standard_normal(
            (FRAMES, 6)
        )
        run = made_run("one", truth @ se3.exp(-error), cov=cov)
        grown = made_run("one", run.final.world_T_imu, cov=cov + np.einsum("cti,ctj->tij", shared, shared))
        whole.append(position_errors(grown, reference, planar=planar, reference_sigma=0.0).nees.mean())
        aligned.append(
            position_errors(run, reference, planar=planar, reference_sigma=0.0, shared=shared).nees.mean()
        )
    size = 2 if planar else 3
    assert np.mean(aligned) / size == pytest.approx(1.0, abs=0.25)
    assert np.mean(whole) < 0.8 * np.mean(aligned)
