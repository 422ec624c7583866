"""An ablation chain whose errors are known by hand."""

import numpy as np
import pytest

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import made_record
from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES
from vislam.evaluation import Evaluation, evaluate
from vislam.evaluation.attribution import attribute
from vislam.evaluation.evaluate import Metric

CHAIN = {"low": "inertial samples", "middle": "the camera", "high": "smoothing"}
ERRORS = {"low": (10.0, None), "middle": (4.5, 4.0), "high": (8.0, 5.0)}
"""Error of the filtered and of the smoothed poses of each run [m]."""


def made_chain(key, **changes):
    """Runs in another order than the chain's, with made-up scores."""
    runs = {name: made_run(name, circle(10), **changes.get(name, {})) for name in sorted(ERRORS)}
    scores = [
        Metric(name, key, value, "m", "truth", estimate=estimate)
        for name, pair in ERRORS.items()
        for estimate, value in zip(ESTIMATES, pair, strict=True)
        if value is not None
    ]
    return runs, Evaluation(scores)


@pytest.mark.parametrize("planar", [False, True])
def test_each_rung_is_held_against_the_one_below(planar):
    truth = circle(10)
    reference = (
        Reference("poles", "planar", np.arange(10), truth[:, :2, 3], None, np.eye(4))
        if planar
        else of_truth(truth)
    )
    runs, scores = made_chain("ate_planar_rmse" if planar else "ate_rmse")
    low, middle, high = attribute(CHAIN, runs, scores, reference)
    assert [step.run for step in (low, middle, high)] == list(CHAIN)
    assert [step.adds for step in (low, middle, high)] == list(CHAIN.values())
    assert (low.filtered, low.filtered_change, low.smoothed, low.smoothing) == (10.0, None, None, None)
    assert (middle.filtered, middle.smoothed, middle.filtered_change) == (4.5, 4.0, -5.5)
    # There is nothing smoothed below: what smoothing does is told within the run.
    assert (middle.smoothed_change, middle.smoothing) == (None, -0.5)
    # A step may make it worse than the one before, though smoothing makes it better.
    assert (high.filtered_change, high.smoothed_change, high.smoothing) == (3.5, 1.0, -3.0)


def test_an_incomplete_run_is_no_rung_to_stand_on():
    runs, scores = made_chain("ate_rmse", middle={"error": "frame 5: lost"})
    low, middle, high = attribute(CHAIN, runs, scores, of_truth(circle(10)))
    assert (low.filtered, middle.filtered, high.filtered) == (10.0, None, 8.0)
    assert (middle.filtered_change, middle.smoothed, middle.smoothing) == (None, None, None)
    assert (high.filtered_change, high.smoothed_change, high.smoothing) == (None, None, -3.0)


def test_without_a_reference_nobody_knows():
    runs, _ = made_chain("ate_rmse")
    assert attribute(CHAIN, runs, evaluate(runs, made_record()), None) == []
