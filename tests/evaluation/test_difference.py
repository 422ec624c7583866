"""Whether one ATE is larger than another by more than luck."""

import numpy as np
import pytest
from scipy.signal import lfilter

from vislam.evaluation.difference import ate_difference
from vislam.evaluation.trajectory import AbsoluteErrors


def staying(rng, length, *, frames=600):
    """Errors ``(n, 3)`` that stay for about ``length`` frames."""
    keep = np.exp(-1.0 / length)
    white = rng.normal(size=(frames + 10 * length, 3))
    return lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)[-frames:]


def errors(values):
    return AbsoluteErrors(np.arange(len(values)), values, None)


def test_the_difference_is_of_the_ates_on_common_frames(rng):
    one, other = staying(rng, 2), staying(rng, 2)
    first = AbsoluteErrors(np.arange(600), one, None)
    second = AbsoluteErrors(np.arange(100, 700), other, None)
    found = ate_difference(first, second)
    rms = [np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (one[100:], other[:500])]
    assert found.value == pytest.approx(rms[0] - rms[1], rel=1e-12)
    assert found.low < found.value < found.high
    turned = ate_difference(second, first)
    assert turned == found.turned() or turned.value == pytest.approx(-found.value)
    assert ate_difference(first, AbsoluteErrors(np.arange(700, 1300), one, None)) is None


def test_it_is_the_same_every_time_and_nothing_between_equals(rng):
    one, other = errors(staying(rng, 5)), errors(staying(rng, 5))
    assert ate_difference(one, other) == ate_difference(one, other)
    same = ate_difference(one, one)
    assert (same.value, same.low, same.high, same.real) == (0.0, 0.0, 0.0, False)


def test_blocks_are_as_long_as_errors_stay(rng):
    blocks = [ate_difference(errors(staying(rng, n)), errors(staying(rng, n))).blocks for n in (2, 20)]
    assert blocks[0] > 4.0 * blocks[1]
    few = ate_difference(errors(staying(rng, 400)), errors(staying(rng, 400)))
    assert not few.known
    assert not few.real
    assert np.isnan(few.low)


def test_what_rounding_leaves_of_an_error_has_no_blocks(rng):
    exact, other = 1e-15 * staying(rng, 400), staying(rng, 3)
    found = ate_difference(errors(exact), errors(other))
    assert found.blocks > 20
    assert found.real
    assert ate_difference(errors(1e14 * exact), errors(other)).blocks < 4


@pytest.mark.statistical
def test_luck_is_called_real_seldom_and_a_real_difference_mostly():
    rng = np.random.default_rng(5)
    false, true = [], []
    for _ in range(150):
        common = staying(rng, 5)
        one, other = common + 0.5 * staying(rng, 5), common + 0.5 * staying(rng, 5)
        false.append(ate_difference(errors(one), errors(other)).real)
        true.append(ate_difference(errors(1.3 * one), errors(other)).real)
    assert np.mean(false) < 0.11
    assert np.mean(true) > 0.9
