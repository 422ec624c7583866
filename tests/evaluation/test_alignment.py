"""Association and alignments: what they recover, what they leave alone, and what has no answer."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.evaluation.conftest import positions_of
from vislam.core.reference import Reference
from vislam.evaluation.alignment import AlignmentKind, align, find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.trajectory import ate
from vislam.geometry import se3, so3

KINDS = get_args(AlignmentKind)
FREE = {
    "first_pose": [1, 1, 1, 1, 1, 1],
    "yaw_position": [0, 0, 1, 1, 1, 1],
    "se3": [1, 1, 1, 1, 1, 1],
    "sim3": [1, 1, 1, 1, 1, 1],
    "planar": [0, 0, 1, 1, 1, 0],
}
"""Components of a motion (omega, v) of the estimate's world that each kind undoes."""
seeds = st.integers(0, 2**32 - 1)


def drawn(generator, rows=30):
    return se3.exp(generator.normal(size=(rows, 6)) * [1, 1, 1, 20, 20, 20])


def met(estimate, pose):
    """The match of an estimate with a reference that has a pose for each of its."""
    frame = np.arange(len(pose))
    reference = Reference("made", "none", frame, pose[:, :3, 3], pose, np.eye(4))
    return associate(frame, 0.1 * frame, estimate, reference)


def on_a_line(direction, rows=20):
    """Poses along a straight line, all of the same attitude."""
    return se3.from_rotation_translation(np.eye(3), np.linspace(0.0, 50.0, rows)[:, None] * direction)


def test_frames_without_a_partner_are_dropped_and_counted(drive):
    whole = drive.matched()
    kept = np.flatnonzero(np.arange(len(drive.stamp)) % 7 != 3)
    some = drive.matched(kept)
    assert np.array_equal(some.frame, np.intersect1d(kept, drive.reference.frame))
    assert some.estimate_dropped == len(kept) - len(some.frame)
    assert some.reference_dropped == len(drive.reference.frame) - len(some.frame) > 0
    assert np.array_equal(some.stamp, drive.stamp[some.frame])
    where = np.isin(whole.frame, kept)
    for name in ("estimate", "position", "pose", "driven"):
        assert np.array_equal(getattr(some, name), getattr(whole, name)[where]), name


def test_the_estimate_is_moved_to_the_point_of_the_reference(drive):
    exact = drive.reference.pose @ se3.inverse(drive.reference.imu_T_point)
    matched = associate(drive.reference.frame, drive.stamp[drive.reference.frame], exact, drive.reference)
    # The rotations of the file are so to seven digits, and the point is a metre away.
    assert np.allclose(matched.estimate, matched.pose, atol=1e-6)
    assert not np.allclose(exact, matched.pose, atol=1e-2)


@settings(max_examples=50, deadline=None)
@given(seed=seeds, kind=st.sampled_from(sorted(FREE)))
def test_a_known_motion_is_recovered(seed, kind):
    generator = np.random.default_rng(seed)
    pose = drawn(generator)
    xi = generator.normal(size=6) * [1, 1, 1, 50, 50, 50] * FREE[kind]
    scale = 1.0 if kind != "sim3" else generator.uniform(0.2, 5.0)
    moved = se3.exp(xi) @ pose
    moved[:, :3, 3] /= scale
    found = find_alignment(kind, met(moved, pose))
    back = se3.inverse(se3.exp(xi))
    assert found.scale == pytest.approx(scale, rel=1e-12)
    assert np.allclose(found.rotation, back[:3, :3], atol=1e-12)
    assert np.allclose(found.translation, back[:3, 3], atol=1e-9)
    assert np.allclose(found.transform_poses(moved), pose, atol=1e-9)
    assert np.allclose(found.transform_points(moved[:, :3, 3]), pose[:, :3, 3], atol=1e-9)


@pytest.mark.parametrize("kind", sorted(FREE))
def test_errors_do_not_change_with_a_motion_that_the_alignment_undoes(drive, rng, kind):
    matched = drive.matched()
    motion = se3.exp(rng.normal(size=6) * [1, 1, 1, 50, 50, 50] * FREE[kind])
    moved = replace(matched, estimate=motion @ matched.estimate)
    before, after = (ate(one, find_alignment(kind, one)) for one in (matched, moved))
    assert np.allclose(before.position_error, after.position_error, atol=1e-9)
    assert np.allclose(before.rotation_error, after.rotation_error, atol=1e-9)


def test_the_freer_the_alignment_the_smaller_the_error(drive):
    matched = drive.matched()
    rmse = {kind: ate(matched, find_alignment(kind, matched)).position.rmse for kind in KINDS}
    assert rmse["sim3"] < rmse["se3"] < rmse["yaw_position"] < rmse["none"]
    assert rmse["se3"] < rmse["first_pose"]
    flat = ate(matched, find_alignment("yaw_position", matched)).position_error[:, :2]
    assert rmse["planar"] == pytest.approx(np.sqrt(np.mean(np.sum(flat**2, axis=1))), rel=1e-12)


def test_yaw_and_position_are_those_of_a_general_solver(drive):
    matched = drive.matched()

    def residual(parameters):
        turned = matched.estimate[:, :3, 3] @ so3.exp(parameters[0] * np.array([0.0, 0.0, 1.0])).T
        return (turned + parameters[1:] - matched.position).ravel()

    found = find_alignment("yaw_position", matched)
    start = np.append(Rotation.from_matrix(found.rotation).as_rotvec()[2] + 0.3, np.zeros(3))
    solved = least_squares(residual, start, jac="3-point", x_scale="jac", ftol=None, xtol=1e-15, gtol=None)
    assert np.allclose(found.rotation, so3.exp(solved.x[0] * np.array([0.0, 0.0, 1.0])), atol=1e-9)
    assert np.allclose(found.translation, solved.x[1:], atol=1e-6)
    rmse = np.sqrt(2.0 * solved.cost / len(matched.frame))
    assert ate(matched, found).position.rmse == pytest.approx(rmse, rel=1e-9)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_mirrored_reference_does_not_mirror_the_estimate(rng, dimensions):
    points = rng.normal(size=(30, dimensions))
    flip = np.ones(dimensions)
    flip[-1] = -1.0
    rotation, _ = align(points, points * flip)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("far", [0.0, 4e6])
@pytest.mark.parametrize("shape", ["line", "two points", "one row", "standing", "estimate stands", "other"])
def test_degenerate_trajectories_have_a_proper_alignment(kind, far, shape):
    line = on_a_line(np.array([0.6, 0.8, 0.0]))
    pose = {"two points": line[:2], "one row": line[:1], "standing": line[[3] * 9]}.get(shape, line)
    estimate = {"estimate stands": line[[3] * 20], "other": line[:, :, [1, 0, 2, 3]]}.get(shape, pose)
    pose = se3.from_rotation_translation(np.eye(3), far * np.ones(3)) @ pose
    matched = met(estimate, pose)
    if shape == "other":
        # The reference is the one that stands.
        matched = met(line, np.repeat(pose[:1], len(pose), axis=0))
    found = find_alignment(kind, matched)
    assert np.allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    # At 4000 km a position is good to a nanometre, and a direction over 50 m to as many radians.
    assert np.allclose(found.rotation, np.eye(3), atol=1e-9)
    assert found.scale == pytest.approx(1.0, abs=1e-9)
    if kind not in ("none", "planar") and shape not in ("estimate stands", "other"):
        assert ate(matched, found).position.max < 1e-7


@pytest.mark.parametrize("kind", ["se3", "sim3"])
def test_a_straight_line_is_turned_by_the_smallest_rotation(kind):
    ahead, wanted = np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.0, 0.8])
    matched = met(on_a_line(ahead), on_a_line(wanted))
    found = find_alignment(kind, matched)
    assert np.allclose(found.rotation, so3.onto(ahead, wanted), atol=1e-12)
    backwards = find_alignment(kind, met(on_a_line(ahead), on_a_line(-ahead)))
    assert ate(met(on_a_line(ahead), on_a_line(-ahead)), backwards).position.max < 1e-9
    assert np.linalg.det(backwards.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_planar_reference_admits_planar_alignments_alone(drive, kind):
    planar = replace(drive, reference=positions_of(drive.reference, slice(None)))
    matched = planar.matched()
    if kind in ("none", "planar"):
        errors = ate(matched, find_alignment(kind, matched))
        whole = ate(drive.matched(), find_alignment(kind, drive.matched()))
        assert np.allclose(errors.position_error, whole.position_error[:, :2])
        assert errors.rotation_error is None
        assert errors.rotation is None
    else:
        with pytest.raises(ValueError, match=f"must be none or planar, got {kind}"):
            find_alignment(kind, matched)


def test_the_first_pose_needs_a_pose(drive):
    matched = replace(drive.matched(), pose=None)
    with pytest.raises(ValueError, match="first_pose must have a reference with poses"):
        find_alignment("first_pose", matched)


def test_nothing_matched_cannot_be_aligned(drive):
    matched = drive.matched(slice(0))
    assert matched.reference_dropped == len(drive.reference.frame)
    with pytest.raises(ValueError, match="1 matched frame or more, got 0"):
        find_alignment("none", matched)
