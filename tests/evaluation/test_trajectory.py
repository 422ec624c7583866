"""Errors of trajectories whose errors are known, and KITTI's drift against its definition in loops."""

from dataclasses import replace
from itertools import pairwise
from math import acos, degrees, sqrt

import numpy as np
import pytest

from tests.evaluation.conftest import positions_of
from tests.evaluation.test_evaluation import circle, of_truth
from vislam.core.reference import Reference
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.kitti import kitti_drift
from vislam.evaluation.rpe import (
    displacement_by_distance,
    displacement_by_time,
    rpe_by_distance,
    rpe_by_time,
    worst_segments,
)
from vislam.evaluation.trajectory import ate, final_drift
from vislam.geometry import se3


def met(estimate, reference, keep=slice(None)):
    frame = np.arange(len(estimate))[keep]
    return associate(frame, 0.1 * frame, estimate[keep], reference)


def straight(rows=1000):
    """A metre a frame along x."""
    pose = np.tile(np.eye(4), (rows, 1, 1))
    pose[:, 0, 3] = np.arange(float(rows))
    return pose


def stretched(pose, by=1.02):
    longer = pose.copy()
    longer[:, :3, 3] *= by
    return longer


def turning(pose, degrees_a_frame):
    xi = np.zeros((len(pose), 6))
    xi[:, 2] = np.deg2rad(degrees_a_frame) * np.arange(len(pose))
    return pose @ se3.exp(xi)


def test_a_moved_trajectory_has_no_error_and_a_noisy_one_its_noise(rng):
    truth = circle()
    moved = met(se3.exp(rng.normal(size=6)) @ truth, of_truth(truth))
    assert ate(moved, find_alignment("se3", moved)).position.max < 1e-9
    noisy = truth.copy()
    noisy[:, :3, 3] += 0.3 * rng.normal(size=(400, 3))
    errors = ate(met(noisy, of_truth(truth)), find_alignment("se3", met(noisy, of_truth(truth))))
    assert errors.position.rmse == pytest.approx(0.3 * np.sqrt(3), rel=0.1)


def test_statistics_are_those_of_the_errors():
    pose = straight(4)
    off = pose.copy()
    off[:, 1, 3] = [3.0, 0.0, -4.0, 0.0]
    errors = ate(met(turning(off, 1.0), of_truth(pose)), find_alignment("none", met(off, of_truth(pose))))
    assert np.allclose(errors.position_error[:, 1], [3.0, 0.0, -4.0, 0.0])
    assert errors.position.rmse == pytest.approx(2.5)
    assert (errors.position.mean, errors.position.median, errors.position.max) == (1.75, 1.5, 4.0)
    assert np.allclose(np.rad2deg(errors.rotation_error), [0.0, 1.0, 2.0, 3.0])
    assert np.rad2deg(errors.rotation.max) == pytest.approx(3.0)


@pytest.mark.parametrize("measure", [rpe_by_distance, rpe_by_time])
def test_relative_errors_do_not_change_with_a_motion_of_the_estimate(drive, rng, measure):
    matched = drive.matched()
    moved = replace(matched, estimate=se3.exp(10.0 * rng.normal(size=6)) @ matched.estimate)
    before, after = measure(matched, 20.0), measure(moved, 20.0)
    assert np.allclose(before.translation_error, after.translation_error, atol=1e-9)
    assert np.allclose(before.rotation_error, after.rotation_error, atol=1e-9)


def test_relative_errors_of_a_stretched_and_turning_line():
    matched = met(turning(stretched(straight(200)), 0.1), of_truth(straight(200)))
    errors = rpe_by_time(matched, 5.0)
    whole = errors.last - errors.first == 50
    assert np.count_nonzero(whole) == 150
    assert np.allclose(np.rad2deg(errors.rotation_error[whole]), 5.0)
    aligned = met(stretched(straight(200)), of_truth(straight(200)))
    errors = rpe_by_distance(aligned, 50.0)
    assert np.allclose(errors.translation_error, 0.02 * (errors.last - errors.first))
    assert errors.translation.median == pytest.approx(1.0)


def test_segments_begin_and_end_where_a_search_by_hand_does(drive):
    """Among them the frames at which nothing moves."""
    pose = drive.reference.pose.copy()
    pose[100:140] = pose[100]
    pose[-30:] = pose[-30]
    reference = replace(drive.reference, pose=pose, position=pose[:, :3, 3])
    matched = replace(drive, reference=reference).matched()
    wanted = []
    for first in range(len(matched.frame) - 1):
        lengths = [far - matched.driven[first] for far in matched.driven[first + 1 :]]
        off = [abs(length - 30.0) for length in lengths]
        if min(off) <= 3.0:
            wanted.append((first, first + 1 + off.index(min(off))))
    errors = rpe_by_distance(matched, 30.0)
    assert np.array_equal(np.column_stack([errors.first, errors.last]), matched.frame[np.array(wanted)])


def test_a_gap_of_the_estimate_does_not_change_the_errors_of_other_segments(drive):
    whole = drive.matched()
    gone = np.isin(np.arange(len(drive.stamp)), np.arange(200, 260))
    some = rpe_by_distance(drive.matched(~gone), 50.0)
    full = rpe_by_distance(whole, 50.0)
    known = {(i, j): error for i, j, error in zip(full.first, full.last, full.translation_error, strict=True)}
    same = [known.get((i, j)) for i, j in zip(some.first, some.last, strict=True)]
    agree = [a == b for a, b in zip(same, some.translation_error, strict=True) if a is not None]
    assert all(agree)
    assert len(agree) > 0.9 * len(some.first) > 500


def test_too_long_a_segment_has_no_errors():
    errors = rpe_by_distance(met(straight(50), of_truth(straight(50))), 100.0)
    assert len(errors.first) == 0
    assert errors.translation is None
    assert errors.rotation is None
    single = met(straight(50), of_truth(straight(50)), slice(1))
    assert len(rpe_by_time(single, 1.0).first) == 0


def test_positions_alone_have_no_relative_poses(drive):
    matched = replace(drive, reference=positions_of(drive.reference, slice(None))).matched()
    for measure in (rpe_by_distance, rpe_by_time):
        with pytest.raises(ValueError, match="must have a reference with poses"):
            measure(matched, 10.0)
    assert kitti_drift(matched) is None
    assert final_drift(matched) is None


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_displacements_of_a_stretched_line_in_bursts(yaw):
    """Ten frames there, thirty missing: the straight line joins them."""
    truth = straight(400)
    reference = Reference(
        "poles", "in bursts", np.arange(400), truth[:, :2, 3], pose=None, imu_T_point=np.eye(4)
    )
    reference = positions_of(reference, np.arange(400) % 40 < 10)
    xi = np.array([0.0, 0.0, yaw, 7.0, -5.0, 3.0])
    matched = met(se3.exp(xi) @ stretched(truth), reference)
    for measure, wanted, there in ((displacement_by_distance, 80.0, 80), (displacement_by_time, 8.0, 80)):
        errors = measure(matched, wanted)
        # The last burst ends at frame 369, and for a tenth of the 80 frames before its last segment's start.
        exact = errors.last - errors.first == there
        assert np.array_equal(errors.first[exact], reference.frame[reference.frame + 80 <= 369])
        assert np.allclose(errors.translation_error, 0.02 * (errors.last - errors.first), atol=1e-9)
        assert errors.rotation_error is None
        assert errors.rotation is None
        assert errors.translation.median == pytest.approx(1.6)


def test_displacements_are_those_of_the_aligned_positions(drive):
    matched = drive.matched()
    planar = replace(drive, reference=positions_of(drive.reference, slice(None))).matched()
    off = ate(matched, find_alignment("planar", matched)).position_error
    errors = displacement_by_time(planar, 10.0)
    first, last = (np.searchsorted(planar.frame, frame) for frame in (errors.first, errors.last))
    assert np.allclose(errors.translation_error, np.linalg.norm(off[last] - off[first], axis=1))


def test_the_worst_segments_are_where_the_estimate_slipped(drive):
    pose = drive.reference.pose.copy()
    for frame, slip in ((400, 3.0), (650, 5.0)):
        pose[frame:, 1, 3] += slip
    estimate = pose @ se3.inverse(drive.reference.imu_T_point)
    matched = met(estimate, replace(drive.reference, frame=np.arange(len(pose))))
    found = worst_segments(matched, 50.0, 2)
    assert [segment.error for segment in found] == pytest.approx([5.0, 3.0], abs=1e-4)
    assert [segment.first < slip <= segment.last for segment, slip in zip(found, (650, 400), strict=True)]
    assert found[0].start == pytest.approx(matched.driven[found[0].first])


@pytest.mark.parametrize("poses", [True, False])
def test_the_worst_segments_are_the_worst_clear_of_each_other(drive, poses):
    reference = drive.reference if poses else positions_of(drive.reference, slice(3, None))
    matched = replace(drive, reference=reference).matched()
    found = worst_segments(matched, 40.0, 5)
    errors = (rpe_by_distance if poses else displacement_by_distance)(matched, 40.0)
    assert found[0].error == errors.translation_error.max()
    assert len(found) == 5
    for rank, segment in enumerate(found):
        before = found[:rank]
        assert all(segment.last <= other.first or other.last <= segment.first for other in before)
        clear = np.ones(len(errors.first), bool)
        for other in before:
            clear &= (errors.last <= other.first) | (errors.first >= other.last)
        assert segment.error == errors.translation_error[clear].max()
    assert len(worst_segments(matched, 40.0, 1000)) <= matched.driven[-1] / 36.0


def test_the_drift_at_the_end_is_a_share_of_the_way():
    matched = met(se3.exp(np.ones(6)) @ stretched(straight(500)), of_truth(straight(500)))
    assert final_drift(matched) == pytest.approx(2.0)
    # From where the match begins, not from where the reference does.
    assert final_drift(met(stretched(straight(500)), of_truth(straight(500)), slice(300, None))) == (
        pytest.approx(2.0)
    )
    standing = np.repeat(straight(1), 20, axis=0)
    assert final_drift(met(standing, of_truth(standing))) is None


def by_definition(estimate, reference):
    """KITTI's drift over consecutive frames, step by step: rows of (first, last, length, shares)."""
    driven = [0.0]
    for before, after in pairwise(reference):
        dx, dy, dz = after[:3, 3] - before[:3, 3]
        driven.append(driven[-1] + sqrt(dx * dx + dy * dy + dz * dz))
    rows = []
    for first in range(0, len(reference), 10):
        for length in (100, 200, 300, 400, 500, 600, 700, 800):
            last = next((k for k in range(first, len(driven)) if driven[k] > driven[first] + length), None)
            if last is None:
                continue
            true_motion = np.linalg.inv(reference[first]) @ reference[last]
            own_motion = np.linalg.inv(estimate[first]) @ estimate[last]
            error = np.linalg.inv(own_motion) @ true_motion
            cosine = 0.5 * (error[0, 0] + error[1, 1] + error[2, 2] - 1.0)
            x, y, z = error[:3, 3]
            angle = acos(max(min(cosine, 1.0), -1.0))
            rows.append((first, last, length, sqrt(x * x + y * y + z * z) / length, angle / length))
    return rows


def test_the_drift_of_kitti_is_its_definition(drive):
    matched = drive.matched()
    assert np.all(np.diff(matched.frame) == 1)
    rows = by_definition(matched.estimate, matched.pose)
    drift = kitti_drift(matched)
    found = np.column_stack([drift.first, drift.last, drift.length, drift.translation, drift.rotation])
    assert np.allclose(found, rows, rtol=1e-9, atol=0.0)
    assert drift.t_rel == pytest.approx(100.0 * sum(row[3] for row in rows) / len(rows), rel=1e-9)
    assert drift.r_rel == pytest.approx(100.0 * degrees(sum(row[4] for row in rows) / len(rows)), rel=1e-9)
    for length, part in drift.by_length().items():
        shares = [row[3] for row in rows if row[2] == length]
        assert part.t_rel == pytest.approx(100.0 * sum(shares) / len(shares), rel=1e-9)
    assert sorted(drift.by_length()) == sorted({row[2] for row in rows})


def test_the_drift_of_kitti_begins_at_tenth_frames_whatever_is_missing(drive):
    full = kitti_drift(drive.matched())
    known = dict(zip(zip(full.first, full.length, strict=True), full.translation, strict=True))
    frame = np.arange(len(drive.stamp))
    keep = ~np.isin(frame, [5, 13, 44, 45, 200, 410, 411, 412, 413, 414])
    some = kitti_drift(drive.matched(keep))
    found = dict(zip(zip(some.first, some.length, strict=True), some.translation, strict=True))
    assert all(known[key] == share for key, share in found.items())
    assert 0.9 * len(known) < len(found) < len(known)
    assert not {start for start, _ in found} & {200, 410}
    assert kitti_drift(drive.matched(slice(0, None, 2))) is None


def test_the_drift_of_kitti_of_a_stretched_line():
    drift = kitti_drift(met(stretched(straight()), of_truth(straight())))
    # A segment ends at the first frame beyond its length, one frame late at the most.
    assert drift.t_rel == pytest.approx(2.0, rel=0.02)
    # The arc cosine of a number next to 1 is good to half the digits.
    assert drift.r_rel == pytest.approx(0.0, abs=1e-6)
    assert np.array_equal(drift.last - drift.first, drift.length + 1)
    assert kitti_drift(met(straight(50), of_truth(straight(50)))) is None


def test_the_drift_of_kitti_of_a_steady_turn():
    drift = kitti_drift(met(turning(straight(500), 0.01), of_truth(straight(500))))
    assert drift.r_rel == pytest.approx(1.0, rel=0.02)
