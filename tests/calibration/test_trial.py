"""What speaks against a config: worse held-out tracks, a path off the inertial one, too small errors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.test_calibration import config_of, simulated
from vislam.calibration.trial import Trial, inertial_length, objections
from vislam.evaluation.held_out import HeldOutScore

TRACKS = 200


def scored(median: float) -> HeldOutScore:
    rms = median * np.random.default_rng(0).uniform(0.5, 1.5, TRACKS)
    return HeldOutScore(np.arange(TRACKS), np.arange(TRACKS), rms * median / np.median(rms))


BEFORE = Trial(scored(0.5), 1.0, np.array([0.01, 0.1]))


@pytest.fixture(scope="module")
def sequence():
    return simulated(1, frames=40).sequence


def against(after, sequence, before=BEFORE):
    return objections(after, before, sequence=sequence, config=config_of())


def test_nothing_speaks_against_what_is_as_before(sequence):
    assert against(BEFORE, sequence) == []
    assert BEFORE.overclaim(BEFORE) == pytest.approx(1.0)


def test_held_out_tracks_that_are_predicted_worse(sequence):
    found = against(replace(BEFORE, held_out=scored(0.6)), sequence)
    assert any("held-out tracks are predicted worse: 0.500 px before, 0.600 px" in one for one in found)


def test_a_path_that_leaves_the_inertial_one(sequence):
    duration = sequence.stamp[-1] - sequence.stamp[0]
    allowed = config_of().noise.bias_sigma[3] * duration / inertial_length(sequence)
    assert against(replace(BEFORE, path=1.0 + 0.9 * allowed), sequence) == []
    (found,) = against(replace(BEFORE, path=1.0 - 1.2 * allowed), sequence)
    assert "off the inertial one" in found
    # What was off before is not held against it.
    off = replace(BEFORE, path=1.0 - 1.2 * allowed)
    assert against(off, sequence, off) == []


def test_smaller_standard_deviations_are_to_be_earned(sequence):
    half = replace(BEFORE, sigma=0.5 * BEFORE.sigma)
    assert half.overclaim(BEFORE) == pytest.approx(2.0)
    (found,) = against(half, sequence)
    assert "2.00 times too small" in found
    earned = replace(half, held_out=scored(0.25))
    assert against(earned, sequence) == []


def test_without_held_out_tracks_or_covariances_nothing_is_said_of_them(sequence):
    bare = Trial(None, float("nan"), np.full(2, np.nan))
    assert against(bare, sequence, bare) == []
    assert bare.overclaim(BEFORE) == 1.0


def test_a_smoothed_filter_that_does_not_finish_is_worse(sequence):
    failed = Trial(None, float("nan"), np.full(2, np.nan))
    assert against(failed, sequence) == ["the smoothed filter does not finish"]
