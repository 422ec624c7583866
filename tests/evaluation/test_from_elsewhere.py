"""Trajectories from elsewhere: matched on the stamps of both, conventions noticed, claims scored."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vislam.core.reference import Reference
from vislam.core.stamped import Stamped, nearest
from vislam.evaluation.clock import estimate_offset
from vislam.evaluation.clouds import cloud_errors
from vislam.evaluation.covariance_conventions import Covariances
from vislam.evaluation.matching import Matching, match
from vislam.evaluation.normalised import pose_errors
from vislam.evaluation.own_clock import Elsewhere, Unmatched, on_own_clock
from vislam.evaluation.proper_scores import energy_score, log_score
from vislam.evaluation.trajectory_scores import score_trajectory
from vislam.geometry import se3
from vislam.geometry.pose_covariance import FRAMES, ORDERS, CovarianceConvention, from_right

REFERENCE = Reference("truth", "none", np.empty(0, np.int64), np.empty((0, 3)), None, np.eye(4))


def path(stamp):
    """A drive through curves and over hills, with its attitudes."""
    place = np.column_stack([30 * np.sin(0.2 * stamp), 22 * np.sin(0.31 * stamp), 4 * np.sin(0.5 * stamp)])
    yaw, pitch, roll = 0.9 * np.sin(0.3 * stamp), 0.3 * np.sin(0.4 * stamp), 0.2 * np.cos(0.7 * stamp)
    angles = np.column_stack([yaw, pitch, roll])
    turn = Rotation.from_euler("zyx", angles).as_matrix()
    pose = se3.from_rotation_translation(turn, place)
    return Stamped(stamp, place, pose)


DENSE = path(np.arange(0.0, 40.0, 0.01))
SPARSE = path(np.arange(0.3, 38.0, 0.1))


def scored(estimate, reference=DENSE, *, like=REFERENCE, settings=None, **values):
    return on_own_clock(Elsewhere("x", estimate, **values), like, reference, settings or Matching())


def ate(clock, kind="se3"):
    found = score_trajectory(clock.run.frame, clock.run.stamp, clock.run.final.world_T_imu, clock.reference)
    return found.absolute[kind].position.rmse


def moved(stamped, pose):
    return replace(stamped, pose=pose, position=pose[:, :3, 3])


def test_a_perfect_trajectory_has_no_error_whichever_side_is_denser():
    assert ate(scored(SPARSE)) < 1e-12
    assert ate(scored(DENSE, SPARSE)) < 1e-12
    assert scored(SPARSE).noticed == ()


def test_stamps_between_those_of_the_reference_are_interpolated():
    off = path(SPARSE.stamp + 0.004)
    exact = scored(off, settings=Matching("interpolate"))
    near = scored(off, settings=Matching("nearest"))
    assert ate(exact) < 1e-3
    assert ate(near) > 0.01
    assert any("--association interpolate" in line for line in near.noticed)
    # 0.05 s off all of them, nearest matches nothing: the half that auto asks for.
    found = match(path(SPARSE.stamp + 0.05), SPARSE, Matching("auto", 0.01))
    assert found.interpolated
    assert len(found) > 300


def test_gaps_are_not_bridged():
    holed = SPARSE.take((SPARSE.stamp < 10) | (SPARSE.stamp > 20))
    found = match(DENSE, holed, Matching("interpolate"))
    assert not ((found.estimate.stamp > 10.1) & (found.estimate.stamp < 19.9)).any()
    dense = match(SPARSE, DENSE.take((DENSE.stamp < 10) | (DENSE.stamp > 20)), Matching("interpolate"))
    assert not ((dense.estimate.stamp > 10.1) & (dense.estimate.stamp < 19.9)).any()


def test_interpolation_gives_rows_themselves_at_their_stamps():
    found = DENSE.interpolated(DENSE.stamp[5:50])
    assert np.array_equal(found.position, DENSE.position[5:50])
    assert np.array_equal(found.pose, DENSE.pose[5:50])
    middle = DENSE.interpolated(DENSE.stamp[:-1] + 0.005)
    assert np.allclose(middle.pose, path(middle.stamp).pose, atol=1e-4)


def test_each_row_is_taken_once():
    own, other = nearest(np.array([0.0, 0.004, 1.0, 5.0]), np.array([0.005, 1.02, 2.0]), 0.01)
    assert own.tolist() == [1]
    assert other.tolist() == [0]
    assert all(len(part) == 0 for part in nearest(np.empty(0), np.arange(3.0), 1.0))


def test_a_span_is_cropped_by_the_time_of_the_reference():
    clock = scored(SPARSE, settings=Matching(start=5.0, end=15.0))
    assert clock.run.stamp.min() >= 5.0
    assert clock.run.stamp.max() <= 15.0
    assert 97.0 < clock.facts["completion"] <= 100.0


def test_a_share_that_is_low_is_said():
    clock = scored(path(np.concatenate([SPARSE.stamp[:100], 100.0 + SPARSE.stamp])))
    assert clock.facts["share_matched"] < 25.0
    assert "of the rows are matched" in clock.noticed[0]
    assert clock.facts["rows_matched"] == 100


@pytest.mark.parametrize("scaled", [False, True])
def test_a_clock_that_is_off_is_found_with_its_interval(rng, scaled):
    noisy = replace(
        SPARSE, position=SPARSE.position * (0.1 if scaled else 1.0) + rng.normal(0, 0.02, (377, 3))
    )
    found = estimate_offset(noisy.shifted(0.3), DENSE, reach=1.0, scaled=scaled)
    assert found.low < -0.3 < found.high
    assert found.high - found.low < 0.02
    assert abs(found.value + 0.3) < 0.01


def test_clocks_with_no_time_in_common_are_laid_on_each_other_by_the_speeds():
    own = SPARSE.shifted(1.4e9)
    with pytest.raises(Unmatched, match=r"they fit with clock_offset=-1400000000\.0000"):
        scored(own)
    clock = scored(own, clock_offset="estimate")
    assert ate(clock) < 1e-3
    assert np.isclose(clock.facts["clock_offset"], -1.4e9, rtol=0, atol=1e-4)


def wxyz(pose):
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return se3.from_rotation_translation(Rotation.from_quat(quaternion).as_matrix(), pose[:, :3, 3])


def conjugated(pose):
    return se3.from_rotation_translation(pose[:, :3, :3].transpose(0, 2, 1), pose[:, :3, 3])


def without_turn(position):
    return se3.from_rotation_translation(np.eye(3), position)


ARM = se3.exp(np.array([0.0, 0.0, 0.0, 0.7, -0.3, 1.1]))
TURNED = se3.exp(np.array([0.3, 0.2, -0.9, 0.0, 0.0, 0.0]))
WRONG = {
    "wxyz": (lambda own: moved(own, wxyz(own.pose)), "quaternion=wxyz"),
    "conjugated": (lambda own: moved(own, conjugated(own.pose)), "conjugated=true"),
    "inverted": (lambda own: moved(own, se3.inverse(own.pose)), "inverted=true"),
    "late": (lambda own: own.shifted(0.3), "clock_offset=-0.3"),
    "scale": (lambda own: replace(own, position=0.05 * own.position), "alignment=sim3"),
    "turned": (lambda own: moved(own, own.pose @ TURNED), "body frame is turned by 55."),
    "arm": (lambda own: moved(own, own.pose @ ARM), "its point is 1.34 m from the reference's"),
    "no turns": (
        lambda own: replace(own, pose=se3.from_rotation_translation(np.eye(3), own.position)),
        "the same",
    ),
    "no attitudes": (lambda own: replace(own, pose=None), "no attitudes"),
}


@pytest.mark.parametrize("case", sorted(WRONG))
def test_conventions_that_would_fool_the_scores_are_noticed_in_any_world(case, rng):
    change, message = WRONG[case]
    noise = se3.exp(rng.normal(0, 1, (len(SPARSE), 6)) * [2e-3, 2e-3, 2e-3, 0.02, 0.02, 0.02])
    own = change(moved(SPARSE, SPARSE.pose @ noise))
    world = se3.exp(np.array([0.4, -0.2, 2.0, 30.0, 4.0, 5.0]))
    if own.pose is not None and case != "inverted":
        pose = world @ se3.from_rotation_translation(own.pose[:, :3, :3], own.position)
        # The turn of its world is on the other side of attitudes that are conjugated or in another order.
        own = own if case in ("wxyz", "conjugated", "no turns") else moved(own, pose)
    found = scored(own).noticed
    assert any(message in line for line in found), found
    assert len(found) == 1, found


def test_sound_trajectories_of_some_noise_are_left_in_peace(rng):
    for _ in range(5):
        noise = se3.exp(rng.normal(0, 1, (len(SPARSE), 6)) * [2e-3, 2e-3, 2e-3, 0.05, 0.05, 0.05])
        drift = se3.exp(
            np.cumsum(rng.normal(0, 1, (len(SPARSE), 6)), axis=0) * [1e-4, 1e-4, 4e-4, 5e-3, 5e-3, 5e-3]
        )
        assert scored(moved(SPARSE, SPARSE.pose @ drift @ noise)).noticed == ()


def test_a_scale_that_is_fitted_goes_into_every_error():
    clock = scored(replace(SPARSE, position=0.05 * SPARSE.position, pose=None), alignment="sim3")
    assert np.isclose(clock.facts["scale"], 20.0)
    assert ate(clock) < 1e-9
    assert clock.noticed == ("it has no attitudes: positions alone are scored",)


def claimed(rng, convention):
    """Poses drawn from covariances that differ along the path, in a world of their own."""
    size = np.array([0.02, 0.01, 0.03, 0.3, 0.1, 0.05])
    turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    root = np.diag(size) @ turn
    cov = (root @ np.diag(rng.uniform(0.2, 2.0, 6)) @ root.T)[None] * rng.uniform(0.5, 2, (len(SPARSE), 1, 1))
    error = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.normal(size=(len(SPARSE), 6)))
    error[0] = 0.0
    pose = SPARSE.pose @ se3.inverse(se3.exp(error))
    own = moved(SPARSE, pose)
    return own, Covariances(from_right(pose, cov, convention), pose, pose, False, np.eye(4), None), cov


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("frame", FRAMES)
def test_the_convention_of_covariances_is_found_by_what_fits(order, frame, rng):
    convention = CovarianceConvention(order, frame)
    own, given, cov = claimed(rng, convention)
    clock = scored(own, covariances=given)
    assert any(f"read as {convention}" in line for line in clock.told), clock.told
    assert np.allclose(clock.run.final.cov, cov, atol=1e-12)
    nees = pose_errors(clock.run, clock.reference)["pose"]
    assert 0.9 < nees.statistic().value < 1.1
    assert abs(nees.coverage_curve(np.array([0.5]))[0] - 0.5) < 0.1


def test_a_convention_that_was_given_and_does_not_fit_is_said(rng):
    own, given, _ = claimed(rng, CovarianceConvention("position_first", "right"))
    wrong = replace(given, convention=CovarianceConvention("rotation_first", "right"))
    told = scored(own, covariances=wrong).told
    assert any("cov_order=position_first" in line for line in told), told


def test_the_uncertainty_of_the_reference_itself_is_counted(rng):
    own, given, _ = claimed(rng, CovarianceConvention("position_first", "right"))
    noise = se3.exp(rng.normal(size=(len(DENSE), 6)) * np.repeat([np.deg2rad(1.0), 0.5], 3))
    measured = moved(DENSE, DENSE.pose @ noise)
    bare = scored(own, measured, covariances=given)
    known = replace(REFERENCE, sigma=0.5, sigma_rotation=float(np.deg2rad(1.0)))
    honest = scored(own, measured, like=known, covariances=given)
    values = [pose_errors(one.run, one.reference)["pose"].statistic().value for one in (bare, honest)]
    assert values[0] > 5.0
    assert 0.7 < values[1] < 1.4


def test_covariances_of_positions_alone_have_a_nees(rng):
    cov = np.full((len(SPARSE), 6, 6), np.nan)
    cov[:, 3:, 3:] = 0.04 * np.eye(3)
    error = rng.normal(0, 0.2, (len(SPARSE), 3))
    error[0] = 0.0
    pose = se3.from_rotation_translation(SPARSE.pose[:, :3, :3], SPARSE.position + error)
    given = Covariances(cov, pose, pose, False, np.eye(4), None)
    clock = scored(moved(SPARSE, pose), covariances=given)
    found = pose_errors(clock.run, clock.reference)
    assert list(found) == ["position"]
    assert 0.9 < found["position"].statistic().value < 1.1


def test_the_energy_score_in_one_dimension_is_the_crps():
    """Gneiting and Raftery (2007), eq. 20: the CRPS of a normal distribution in closed form."""
    from scipy.stats import norm

    error = np.linspace(-3, 3, 13)[:, None]
    factor = np.full((13, 1, 1), 2.0)
    z = error[:, 0]
    exact = 2.0 * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    assert np.allclose(energy_score(error, factor), exact, atol=0.06)
    assert np.allclose(log_score(error, factor), -norm.logpdf(2.0 * z, scale=2.0))


def test_the_energy_score_is_that_of_the_distances_of_its_draws(rng):
    """Gneiting and Raftery (2007), eq. 21, draw by draw."""
    root = rng.normal(size=(7, 3, 3))
    factor = np.linalg.cholesky(root @ root.transpose(0, 2, 1) + 0.1 * np.eye(3))
    error = rng.normal(size=(7, 3)) * 2.0
    half = np.random.default_rng(0).standard_normal((128, 3))
    for which, found in enumerate(energy_score(error, factor)):
        draws = [factor[which] @ one for one in [*half, *-half]]
        apart = [np.linalg.norm(one - factor[which] @ error[which]) for one in draws]
        spread = np.sqrt(2.0) * np.mean(np.linalg.norm(draws, axis=1))
        assert found == pytest.approx(np.mean(apart) - 0.5 * spread, rel=1e-9)


def test_proper_scores_are_least_for_the_claim_that_is_true(rng):
    error = rng.normal(size=(600, 3)) * 0.3
    for rule in (log_score, energy_score):
        values = [
            float(rule(error / sigma, np.tile(sigma * np.eye(3), (600, 1, 1))).mean())
            for sigma in (0.1, 0.3, 0.9)
        ]
        assert values[1] < min(values[0], values[2])


def test_points_are_compared_with_the_nearest_up_to_a_share_of_their_depth(rng):
    other = rng.uniform(-50, 50, (400, 3)) + np.array([0, 0, 100.0])
    points = np.concatenate([other[:300] + rng.normal(0, 0.05, (300, 3)), rng.uniform(900, 999, (100, 3))])
    found = cloud_errors(points, other, np.zeros((1, 3)), baseline=0.5)
    assert 0.74 < found.within < 0.78
    assert 0.74 < found.complete < 0.9
    assert 0.03 < np.median(found.near) < 0.12
    assert cloud_errors(points, np.empty((0, 3)), np.zeros((1, 3)), baseline=0.5) is None
