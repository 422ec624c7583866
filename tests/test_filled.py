"""Poses of a reference that were filled in are found, and what was measured is not taken for such."""

from dataclasses import replace

import numpy as np
import pytest

from tests.smoother.drives import drive
from vislam.core.filled import filled, measured
from vislam.core.reference import Reference
from vislam.geometry import se3, so3
from vislam.inspection.tracks import check_stamps


def driven(n=200, seed=0):
    """Positions of a vehicle whose speed and heading change, and its attitudes."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.01 * rng.standard_normal(n))
    speed = 1.0 + 0.002 * np.cumsum(rng.standard_normal(n))
    step = speed[:, None] * np.stack([np.cos(heading), np.sin(heading), 0.01 * np.ones(n)], axis=1)
    turn = so3.exp(np.stack([0 * heading, 0 * heading, heading], axis=1))
    return np.cumsum(step, axis=0), turn


def fill(position, first, last, at):
    out = position.copy()
    share = (at[first : last + 1] - at[first]) / (at[last] - at[first])
    out[first : last + 1] = position[first] + share[:, None] * (position[last] - position[first])
    return out


@pytest.mark.parametrize(
    ("first", "last", "expected"),
    [(0, 12, range(12)), (40, 52, range(41, 52)), (187, 199, range(188, 200))],
    ids=["at the beginning", "within", "at the end"],
)
def test_rows_between_two_in_equal_steps_are_filled_and_their_ends_are_not(first, last, expected):
    position, _ = driven()
    frame = np.arange(200.0)
    found = filled(fill(position, first, last, frame), frame)
    assert list(np.flatnonzero(found)) == list(expected)


def test_what_was_driven_stood_still_or_has_few_digits_is_measured():
    position, _ = driven()
    frame = np.arange(200.0)
    assert not filled(position, frame).any()
    assert not filled(np.round(position, 2), frame).any()
    standing = position.copy()
    standing[50:100] = standing[50]
    assert not filled(standing, frame).any()
    assert not filled(np.round(position * 0.004, 2), frame).any()


def test_few_in_a_row_may_be_chance():
    position, _ = driven()
    frame = np.arange(200.0)
    assert not filled(fill(position, 40, 44, frame), frame).any()
    assert filled(fill(position, 40, 45, frame), frame).sum() == 4


@pytest.mark.parametrize("in_time", [False, True])
def test_a_reference_keeps_what_was_measured_and_says_what_not(in_time):
    position, turn = driven()
    stamp = np.cumsum(np.random.default_rng(1).uniform(0.08, 0.12, 200))
    position = fill(position, 60, 80, stamp if in_time else np.arange(200.0))
    reference = Reference(
        "poses of a file",
        "none",
        np.arange(200),
        position,
        se3.from_rotation_translation(turn, position),
        np.eye(4),
    )
    kept, remark = measured(reference, stamp)
    assert list(np.setdiff1d(reference.frame, kept.frame)) == list(range(61, 80))
    assert np.array_equal(kept.pose, reference.pose[kept.frame])
    assert "19 of 200 poses, of frames 61 to 79" in remark


def test_a_reference_of_equal_steps_throughout_is_left_as_it_is():
    frame = np.arange(50)
    position = 1.5 * frame[:, None] * np.array([1.0, 0.0, 0.0]) + np.array([np.pi, 0.0, 0.0])
    reference = Reference("straight", "none", frame, position, None, np.eye(4))
    kept, remark = measured(reference, 0.1 * frame)
    assert kept is reference
    assert "50 of 50 poses" in remark
    assert "scored all the same" in remark


def test_inspect_says_which_samples_were_filled_in():
    sequence = drive(seed=3, frames=60, tracks_in_view=4)[1].sequence
    assert check_stamps(sequence, in_seconds=sequence).counts["inertial_filled"] == 0
    lost = replace(sequence, twist=fill(sequence.twist, 20, 32, sequence.inertial_stamp))
    found = check_stamps(lost, in_seconds=lost)
    assert found.verdict == "note"
    assert found.counts["inertial_filled"] == 11
    assert "11 inertial samples from" in found.text
