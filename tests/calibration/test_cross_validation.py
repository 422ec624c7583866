"""Blocks of time that are left out: one Newton step is the maximum without them, and what they gain."""

import numpy as np
import pytest

from vislam.calibration.cross_validation import FOLDS, block_of, left_out, predicted
from vislam.calibration.search import Bounds, Local, maximise


@pytest.mark.parametrize("frames", [24, 107, 1000])
def test_each_fold_has_blocks_all_along(frames):
    block = block_of(frames)
    assert len(block) == frames
    assert np.all(np.diff(block) >= 0)
    folds = block % FOLDS
    for fold in range(FOLDS):
        at = np.flatnonzero(folds == fold)
        assert at.min() < frames / 2 <= at.max() + 1
        assert 0.1 < len(at) / frames < 0.4


def test_a_short_recording_is_not_cross_validated():
    assert len(block_of(23)) == 0


def maximum_of(values, start, *, lowest):
    """Maximum of the mean of normal numbers, whose log likelihood is a square, so that each step is exact."""

    def differentiate(point):
        scores = (values - point[0])[:, None]
        return Local(point, -0.5 * float(np.sum(scores**2)), scores, np.array([[float(len(values))]]))

    return maximise(
        differentiate,
        lambda points: [-0.5 * float(np.sum((values - point[0]) ** 2)) for point in points],
        np.array([start]),
        bounds=Bounds(lowest, np.array([10.0])),
    )


def test_one_step_is_the_maximum_without_the_fold():
    values, lowest = np.random.default_rng(1).normal(3.0, 1.0, 200), np.array([-np.inf])
    maximum = maximum_of(values, 0.0, lowest=lowest)
    fold = block_of(200) % FOLDS == 2
    found = left_out(maximum, fold, lowest=lowest, largest=np.array([10.0]))
    assert found[0] == pytest.approx(values[~fold].mean(), abs=0.01)


def test_a_parameter_at_its_lowest_value_stays_there():
    values, lowest = np.random.default_rng(2).normal(-1.0, 1.0, 100), np.array([0.5])
    maximum = maximum_of(values, 1.0, lowest=lowest)
    fold = block_of(100) % FOLDS == 0
    assert left_out(maximum, fold, lowest=lowest, largest=np.array([10.0])) == lowest


def test_gains_are_those_of_the_fold_that_was_left_out():
    block = block_of(80)
    after = [np.full(80, 1.0 + fold) for fold in range(FOLDS)]
    found = predicted(np.zeros(80), after, block)
    assert found.gain == pytest.approx([10.0 * (1 + index % FOLDS) for index in range(8)])
    assert found.better == 8
    assert found.total == pytest.approx(200.0)


def test_a_filter_that_fails_loses_everything():
    block = block_of(80)
    assert predicted(np.zeros(80), [np.full(80, -np.inf)] * FOLDS, block).total < -1e9
