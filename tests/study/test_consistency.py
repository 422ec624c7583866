"""The study of the filters' consistency: its drives are what filters are told, and it tells them apart."""

from pathlib import Path

import numpy as np
import pytest

from vislam.comparison import config as configuration
from vislam.study import answers
from vislam.study.plan import Plan
from vislam.study.trial import run_trial
from vislam.study.trials import Trials

CONFIG = Path(__file__).parents[2] / "configs" / "consistency.yaml"


def trials(*, frames, seeds, estimators):
    """Trials of the shipped study, of fewer and shorter drives."""
    overrides = {"data.simulation.frames": frames, "study.seeds": seeds}
    config = configuration.load(CONFIG, overrides=overrides)
    chosen = {name: config.estimators[name] for name in estimators}
    plan = Plan.of(configuration.with_estimators(config, chosen))
    records = (
        {"seed": trial.seed, "point": {}, **run_trial(trial.point.tree, trial.seed)}
        for trial in plan.trials()
    )
    return Trials.of_records(records)


def test_the_motion_noise_is_that_which_is_told():
    """Dead reckoning is right about itself over a second, in which next to nothing is linearised."""
    found = trials(frames=10, seeds=30, estimators=["dead_reckoning"])
    nees = answers.pooled_nees(found, "dead_reckoning", rows=np.arange(30)).mean
    assert nees.low < 1.0 < nees.high
    assert nees.high - nees.low < 0.6


@pytest.mark.slow
def test_the_invariant_filter_is_consistent_and_the_standard_one_is_not():
    found = trials(frames=200, seeds=12, estimators=["ekf", "ekf_invariant"])
    rows = np.arange(12)
    standard, invariant = (
        answers.pooled_nees(found, name, rows=rows).mean for name in ("ekf", "ekf_invariant")
    )
    assert 0.7 < invariant.value < 1.3
    assert answers.pooled_coverage(found, "ekf_invariant", rows=rows).value > 0.98
    assert standard.value > 1.3 * invariant.value
    assert standard.low > 1.0
    # Where the world is turned to, no measurement can tell.
    gained = {name: found.value(name, "spurious_yaw_information").min() for name in ("ekf", "ekf_invariant")}
    assert gained["ekf"] > 1.0 > gained["ekf_invariant"]
