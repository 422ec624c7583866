"""A ladder whose errors are known by hand."""

import numpy as np
import pytest

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import made_record
from vislam.core.reference import Reference
from vislam.evaluation import Evaluation, evaluate
from vislam.evaluation.attribution import attribute
from vislam.evaluation.evaluate import Metric

LADDER = {"low": "inertial samples", "middle": "the camera", "high": "smoothing"}
ERRORS = {"low": (10.0, 10.0), "middle": (4.0, 4.5), "high": (5.0, 8.0)}
"""Final and causal error of each run [m]."""


def made_ladder(key, **changes):
    """Runs in another order than the ladder's, with made-up scores."""
    runs = {name: made_run(name, circle(10), **changes.get(name, {})) for name in sorted(ERRORS)}
    scores = [
        Metric(name, key + suffix, value, "m", "truth")
        for name, pair in ERRORS.items()
        for suffix, value in zip(("", "_causal"), pair, strict=True)
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
    runs, scores = made_ladder("ate_planar_rmse" if planar else "ate_rmse")
    low, middle, high = attribute(LADDER, runs, scores, reference)
    assert [rung.run for rung in (low, middle, high)] == list(LADDER)
    assert [rung.adds for rung in (low, middle, high)] == list(LADDER.values())
    assert (low.error, low.change, low.causal_less_final) == (10.0, None, 0.0)
    assert (middle.error, middle.causal, middle.change, middle.causal_less_final) == (4.0, 4.5, -6.0, 0.5)
    # A rung may make it worse than the one below, though it is better than it was at the time.
    assert (high.change, high.causal_less_final) == (1.0, 3.0)
    assert middle.change + high.change == high.error - low.error


def test_an_incomplete_run_is_no_rung_to_stand_on():
    runs, scores = made_ladder("ate_rmse", middle={"error": "frame 5: lost"})
    low, middle, high = attribute(LADDER, runs, scores, of_truth(circle(10)))
    assert (low.error, middle.error, high.error) == (10.0, None, 5.0)
    assert middle.change is None
    assert middle.causal_less_final is None
    assert high.change is None


def test_without_a_reference_nobody_knows():
    runs, _ = made_ladder("ate_rmse")
    assert attribute(LADDER, runs, evaluate(runs, made_record()), None) == []
