"""Maxima by scores of the backward pass, between rounds of differences."""

from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.test_calibration import config_of, simulated
from vislam.base.errors import DivergedError
from vislam.calibration.likelihood import Evaluator, Stretch
from vislam.calibration.maxima import by_differences, moved_maximum, near_maximum
from vislam.calibration.parameters import parameters, point_of
from vislam.calibration.refinement import Bounds, refined
from vislam.calibration.search import Maximum, Round
from vislam.calibration.target import Point, Target
from vislam.estimators.ekf import EkfEstimator

FRAMES = 50
SIGMA = np.array([0.1, 0.2, 0.003])
BEST = np.array([-1.2, -2.3, 0.02])
LOWEST = np.array([-4.0, -5.0, -np.inf])
LARGEST = np.array([0.7, 0.7, 0.02])


class Known:
    """A likelihood whose maximum is known: normal about ``BEST``, flatter by ``bend`` where that is far."""

    def __init__(self, *, bend: float = 0.0, best=BEST) -> None:
        self.asked, self.bend, self.best = [], bend, best

    def __call__(self, value) -> Point:
        self.asked.append(value)
        away = (value - self.best) / SIGMA
        flatter = 1.0 + self.bend * float(away @ away)
        gradient = -away / SIGMA / flatter**2
        return Point(value, -0.5 * float(away @ away) / flatter, np.tile(gradient / FRAMES, (FRAMES, 1)))


def bounds(*free: bool) -> Bounds:
    return Bounds(LOWEST, LARGEST, np.array(free or (True, True, True)))


def found_by(known, start, *, factor=1.0, **settings) -> Point | None:
    information = np.diag(factor / SIGMA**2)
    return refined(known, np.asarray(start), information=information, bounds=bounds(), **settings)


def test_with_the_right_information_a_single_step_is_enough():
    known = Known()
    found = found_by(known, BEST + np.array([2.0, -1.5, 2.0]) * SIGMA)
    assert np.allclose(found.value, BEST)
    assert len(known.asked) == 2


@pytest.mark.parametrize("factor", [0.2, 2.0])
def test_information_that_is_off_is_mended_by_what_the_score_shows(factor):
    known = Known(bend=0.05)
    found = found_by(known, BEST + np.array([2.0, -1.5, 2.0]) * SIGMA, factor=factor)
    assert np.abs((found.value - BEST) / SIGMA).max() < 0.5
    assert len(known.asked) < 12


def test_a_step_is_the_best_within_the_largest_moves():
    start = BEST + np.array([3.0, 0.1, 0.003])
    here = Known()(start)
    correlated = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]])
    information = correlated / SIGMA[:, None] / SIGMA
    move, expected = bounds().step(here, information)
    assert move[0] == pytest.approx(-LARGEST[0])
    # The others are where the quadratic is highest, that one given.
    slope = here.gradient - information @ move
    inside = np.abs(move) < LARGEST - 1e-9
    assert np.allclose(slope[inside] * SIGMA[inside], 0.0, atol=1e-6)
    assert expected > 0.0


def test_a_level_is_held_at_its_lowest_value():
    known = Known(best=np.array([-1.2, -6.0, 0.02]))
    found = found_by(known, BEST)
    assert found.value[1] == LOWEST[1]
    assert np.allclose(found.value[[0, 2]], BEST[[0, 2]], atol=0.1 * SIGMA[[0, 2]])
    assert bounds().inside(found).tolist() == [True, False, True]


def test_what_is_not_free_does_not_move():
    start = BEST + SIGMA
    information = np.diag(1.0 / SIGMA**2)
    found = refined(Known(), start, information=information, bounds=bounds(True, False, True))
    assert found.value[1] == start[1]
    assert np.allclose(found.value[[0, 2]], BEST[[0, 2]])


def test_where_no_step_gains_anything_there_is_no_maximum():
    known = Known()

    def wrong(value):
        return replace(known(value), scores=-known(value).scores)

    def nowhere(value):
        return replace(known(value), log_likelihood=-np.inf)

    assert found_by(wrong, BEST + 3.0 * SIGMA) is None
    assert found_by(nowhere, BEST + 3.0 * SIGMA) is None


def test_rounds_are_reported_and_given_up():
    rounds, known = [], Known()
    start = BEST + np.array([5.0, 0.0, 0.0])
    assert found_by(known, start, most=3, on_round=rounds.append) is None
    assert [one.number for one in rounds] == [1, 2, 3]
    assert np.array_equal(rounds[-1].point, known.asked[-1])
    assert all(one.gain > 0.0 for one in rounds)


def only(*names):
    return [item for item in parameters(inertial=True) if item.name.endswith(names)]


def test_parameters_that_move_a_level_are_told_from_those_that_move_none():
    chosen = parameters(inertial=True)
    target = Target(config_of(), chosen, Evaluator(simulated(1, frames=3), config_of()), np.ones(0, bool))
    found = target.by_level(point_of(config_of(), chosen))
    moves = target.by_input(point_of(config_of(), chosen)).any(axis=(0, 1))
    names = [item.name for item in chosen]
    assert moves.tolist() == [name == "data.repair.clock.offset" for name in names]
    # Each moves its own levels in proportion.
    assert np.allclose(found[found != 0.0], 1.0)
    moved = dict(zip(names, (found != 0.0).sum(axis=0).tolist(), strict=True))
    assert moved.pop("data.repair.clock.offset") == 0
    assert moved.pop("noise.twist_density (gyro)") == 3
    assert set(moved.values()) == {1}


@pytest.fixture(scope="module")
def short() -> Evaluator:
    return Evaluator(simulated(4, frames=12, tracks=4.0), config_of(clock=0.02))


def all_of(evaluator: Evaluator) -> np.ndarray:
    return np.ones(evaluator.dataset.sequence.observations, bool)


def test_the_score_of_a_target_is_the_slope_of_its_likelihood(short):
    chosen = only("pixel_sigma_px", "(lateral)", "clock.offset")
    target = Target(
        config_of(clock=0.02, pixel_sigma_px=0.35), chosen, short, all_of(short), (Stretch(0, 12),)
    )
    value = point_of(target.begin, chosen)
    assert target.others(value) == []
    found = target.scored(value)
    for index, item in enumerate(chosen):
        h = np.zeros(3)
        h[index] = item.step
        above, below = (float(part.sum()) for part in target.evaluate([value + h, value - h]))
        scale = np.abs(found.scores[:, index]).sum()
        assert found.gradient[index] == pytest.approx((above - below) / (2.0 * item.step), abs=0.05 * scale)


def test_what_moves_neither_noise_nor_motion_is_by_differences(short):
    chosen = [item for item in parameters(disparity_offset=True) if "disparity" in item.name]
    target = Target(config_of(clock=0.02), chosen, short, all_of(short), (Stretch(0, 12),))
    value = point_of(target.begin, chosen)
    assert target.others(value) == [0]
    above, below = (float(part.sum()) for part in target.evaluate([value + 0.02, value - 0.02]))
    assert target.scored(value).gradient[0] == pytest.approx((above - below) / 0.04)


def test_a_half_goes_on_from_the_state_before_it(short):
    config = config_of(clock=0.02)
    gated = short.gated(config)
    assert not gated.run.gated.any()
    assert [(one.begin, one.end) for one in gated.halves] == [(0, 6), (6, 12)]
    (whole,) = short.log_likelihoods([config], usable=all_of(short))
    assert np.allclose(whole, gated.run.innovations.log_likelihood, rtol=1e-12)
    scored, others = short.scored(config, [config], usable=all_of(short), stretches=gated.halves)
    assert np.allclose(scored.log_likelihood, whole, rtol=1e-12)
    assert np.array_equal(others[0], scored.log_likelihood)
    assert len(scored.scores.levels) == len(scored.scores.inputs) == 12


def test_a_stretch_that_the_filter_fails_on_has_no_likelihood(short, monkeypatch):
    def failing(self, frame):
        raise DivergedError("lost")

    monkeypatch.setattr(EkfEstimator, "process", failing)
    found, _ = short.scored(config_of(), [], usable=all_of(short), stretches=[Stretch(0, 12)])
    assert np.isneginf(found.log_likelihood).all()
    assert not found.scores.levels.any()


class Biased(Target):
    """A target whose score is off by a constant, as that of points of linearisation that move."""

    off = np.array([0.0, 0.0])

    def scored(self, value):
        found = super().scored(value)
        return replace(found, scores=found.scores + self.off / len(found.scores))


def biased(short, off, **noise):
    kind = type("Off", (Biased,), {"off": np.array(off)})
    chosen = only("pixel_sigma_px", "drift_px")
    return kind(config_of(clock=0.02, **noise), chosen, short, all_of(short), (Stretch(0, 12),))


def test_what_a_score_lacks_is_found_where_the_search_begins(short):
    rounds = []
    target = biased(short, [25.0, -8.0], pixel_sigma_px=0.36, drift_px=0.12)
    point = near_maximum(target, rounds.append)
    assert rounds
    found = by_differences(replace(target, begin=target.config(point)), lambda ended: None)
    assert np.abs((found.point - point) / found.sigma).max() < 0.6
    assert found.rounds <= 2
    # From the maximum of all observations to that of all but some.
    usable = np.ones(len(target.usable), bool)
    usable[5::40] = False
    fewer = replace(target, usable=usable)
    moved = moved_maximum(found, target, fewer, lambda ended: None)
    again = by_differences(replace(fewer, begin=fewer.config(found.point)), lambda ended: None)
    assert moved is not None
    assert np.abs((moved.point - again.point) / again.sigma).max() < 0.6
    assert np.array_equal(moved.sigma, found.sigma)


def test_where_scores_lead_nowhere_differences_begin_where_these_have_ended(short, monkeypatch):
    def lost(scored, start, *, on_round, **_):
        on_round(Round(1, start + 0.25, 0.0, 1.0))

    monkeypatch.setattr("vislam.calibration.maxima.refined", lost)
    target = biased(short, [0.0, 0.0])
    assert np.allclose(near_maximum(target, lambda ended: None), point_of(target.begin, target.chosen) + 0.25)
    near = Maximum(np.zeros(2), np.ones(2), 0.0, 1, np.zeros((12, 2)), np.eye(2))
    assert moved_maximum(near, target, target, lambda ended: None) is None
