"""Likelihood, scores and information of a filter, from runs a short step of each parameter away."""

import numpy as np
import pytest

from tests.calibration.test_calibration import config_of, simulated
from vislam.base.errors import DivergedError
from vislam.calibration import likelihood
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.parameters import parameters, point_of
from vislam.calibration.target import Target
from vislam.estimators.ekf import EkfEstimator

NAMES = ("pixel_sigma_px", "drift_px", "(lateral)", "(gyro)", "clock.offset", "disparity_offset.pixels")


class Jobs:
    """Does what processes do, in this one, and says that there are so many."""

    def __init__(self, processes: int) -> None:
        self.processes = processes

    def map(self, work, jobs):
        return [work(job) for job in jobs]


def target_of(workers=None) -> Target:
    config, dataset = config_of(clock=0.0213, pixel_sigma_px=0.35), simulated(4, frames=30, tracks=8.0)
    usable = np.ones(dataset.sequence.observations, bool)
    chosen = [item for item in parameters(inertial=True, disparity_offset=True) if item.name.endswith(NAMES)]
    assert len(chosen) == len(NAMES)
    return Target(config, chosen, Evaluator(dataset, config, workers), usable)


@pytest.fixture(scope="module")
def found():
    target = target_of()
    return target, target.differentiate(point_of(target.begin, target.chosen))


def test_scores_are_the_slopes_of_the_likelihood(found):
    target, local = found
    assert local.log_likelihood == pytest.approx(target.evaluate([local.value])[0], rel=1e-12)
    assert local.scores.shape == (30, len(NAMES))
    for index, item in enumerate(target.chosen):
        moved = 10.0 * item.step * np.eye(len(NAMES))[index]
        above, below = target.evaluate([local.value + moved, local.value - moved])
        sigma = 1.0 / np.sqrt(local.information[index, index])
        # Of what the gradient changes by over a standard deviation. Curvature is taken out of the step as it
        # is expected to be, and may be as little as half of that.
        slope = (above - below) / (20.0 * item.step)
        assert local.gradient[index] * sigma == pytest.approx(
            slope * sigma, abs=0.02 + 0.25 * item.step / sigma
        )


def test_information_is_that_of_the_predictions(found, monkeypatch):
    """Against matrices: from innovations and whole covariances of each run."""
    target, local = found
    seen: list[list[tuple[np.ndarray, np.ndarray]]] = []

    def whole(first, others, generator):
        del generator
        seen.append(
            [(value, factor @ factor.T) for value, factor in (u.predicted() for u in (first, *others))]
        )
        count = len(others)
        return np.zeros((0, count)), np.zeros((0, count))

    monkeypatch.setattr(likelihood, "_differences", whole)
    target.differentiate(local.value)
    steps = np.array([item.step for item in target.chosen])
    expected = np.zeros((len(steps), len(steps)))
    for (value, spread), *moved in seen:
        inverse = np.linalg.inv(spread)
        change = [(other - value) / step for (other, _), step in zip(moved, steps, strict=True)]
        bend = [inverse @ (other - spread) / step for (_, other), step in zip(moved, steps, strict=True)]
        for i in range(len(steps)):
            for j in range(len(steps)):
                expected[i, j] += change[i] @ inverse @ change[j] + 0.5 * np.trace(bend[i] @ bend[j])
    scale = 1.0 / np.sqrt(np.diagonal(expected))
    # The sketch is of 276 pairs a measurement, thirty times.
    assert np.abs((local.information - expected) * scale * scale[:, None]).max() < 0.1
    assert np.linalg.eigvalsh(local.information * scale * scale[:, None]).min() > 0.0
    # Correlations are there to be missed.
    assert np.abs(expected * scale * scale[:, None] - np.eye(len(steps))).max() > 0.2


@pytest.mark.parametrize("processes", [2, 9])
def test_it_is_the_same_however_many_processes_share_it(found, processes):
    _, local = found
    shared = target_of(Jobs(processes)).differentiate(local.value)
    assert shared.log_likelihood == local.log_likelihood
    assert np.array_equal(shared.scores, local.scores)
    assert np.array_equal(shared.information, local.information)


def test_where_the_filter_fails_there_is_no_likelihood(found, monkeypatch):
    target, local = found

    def failing(self, frame):
        raise DivergedError("lost")

    monkeypatch.setattr(EkfEstimator, "process", failing)
    lost = target.differentiate(local.value)
    assert np.isneginf(lost.log_likelihood)
    assert not lost.scores.any()
    assert np.isneginf(target.evaluate([local.value])[0])
