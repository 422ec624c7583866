"""The budget of the final optimisation: it holds whatever the problem, and the best so far is the result."""

import itertools
import signal
from functools import partial
from types import SimpleNamespace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.smoother.drives import BUILD, drive
from vislam.base.errors import ConfigError, Interrupted
from vislam.cli.command import interruptible
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.loop import run
from vislam.estimators.smoother import descent
from vislam.estimators.smoother.batch import by_gtsam, minimise
from vislam.estimators.smoother.descent import Budget, descend

POINT = gtsam.symbol("p", 0)
ENDLESS = 10**6


@pytest.fixture(scope="module")
def simulated():
    """A drive on which batch takes about ten iterations and graduation more."""
    return drive(seed=9, frames=30, tracks_in_view=20, outlier_probability=0.05)


def valley(start):
    """A cost whose minimum Levenberg-Marquardt creeps up to: the root of x^4, and of y - x."""

    def error(factor, values, jacobians):
        x, y = values.atVector(factor.keys()[0])
        if jacobians is not None:
            jacobians[0] = np.array([[20.0 * x**9, 0.0], [-1.0, 1.0]])
        return np.array([2.0 * x**10, y - x])

    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), [POINT], error))
    values = gtsam.Values()
    values.insert(POINT, np.asarray(start, float))
    return graph, values


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    start=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
    iterations=st.integers(1, 40),
    rounds=st.integers(1, 10),
)
def test_no_problem_takes_more_than_its_iterations_and_the_best_is_kept(start, iterations, rounds):
    graph, values = valley(start)
    budget = Budget(iterations)
    # A restart that throws the estimate far away, as a triangulation can.
    shaken = itertools.cycle([2.5, -1.5])

    def restart(found):
        moved = gtsam.Values(found)
        moved.update(POINT, found.atVector(POINT) + next(shaken))
        return moved

    descent = partial(by_gtsam, graph)
    found = minimise(descent, values, cost=graph.error(values), restart=restart, rounds=rounds, budget=budget)
    assert budget.done <= iterations
    assert found.rounds <= rounds
    assert found.cost <= graph.error(values)
    assert found.cost == pytest.approx(graph.error(found.values))
    assert not (found.converged and found.stopped)
    if found.stopped:
        assert found.stopped == "max_iterations"
        assert budget.done == iterations


@pytest.mark.parametrize("start", [[2.0, 0.0], [-1.0, 3.0], [0.5, 0.5]])
def test_with_enough_iterations_a_descent_is_gtsams_own(start):
    graph, values = valley(start)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(descent.CONVERGED)
    parameters.setMaxIterations(descent.MOST_ITERATIONS)
    expected = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    budget = Budget(ENDLESS)
    found = descend(graph, values, solver="cholesky", budget=budget)
    assert np.array_equal(found.values.atVector(POINT), expected.atVector(POINT))
    assert not found.cut
    assert 1 <= budget.done <= descent.MOST_ITERATIONS


def estimated(name, simulated, told=None, **options):
    config, dataset = simulated
    estimator = BUILD[name](make_problem(config, dataset), options)
    if told is not None:
        estimator.tell = told
    return run(estimator, dataset.sequence, pixel_sigma(config, dataset), name=name)


@pytest.mark.parametrize("name", ["batch", "batch_schur", "batch_gnc"])
def test_a_run_whose_iterations_are_used_up_is_whole_and_says_so(name, simulated):
    told = []
    free, cut = estimated(name, simulated), estimated(name, simulated, told.append, max_iterations=2)
    assert free.complete
    assert free.log.counts["optimisation_iterations"] > 2
    assert not free.log.events
    assert cut.complete
    assert cut.log.counts["optimisation_iterations"] == 2
    (event,) = cut.log.events
    assert event.startswith(f"{'gnc' if name == 'batch_gnc' else 'batch'}: stopped after 2 iterations")
    assert "(max_iterations), cost" in event
    assert "still falling by" in event
    assert np.isfinite(cut.final.world_T_imu).all()
    assert [line.partition(": ")[2].partition(",")[0] for line in told] == [
        "iteration 1 of at most 2",
        "iteration 2 of at most 2",
    ]


def test_more_iterations_never_fit_worse(simulated):
    squares = [estimated("batch", simulated, max_iterations=most).fit[0] for most in (1, 2, 4, 300)]
    assert squares == sorted(squares, reverse=True)
    assert squares[0] > squares[-1]


def test_a_budget_that_is_not_used_up_changes_nothing(simulated):
    one, other = (estimated("batch", simulated, **more) for more in ({}, {"max_iterations": ENDLESS}))
    assert np.array_equal(one.final.world_T_imu, other.final.world_T_imu)
    assert one.log.counts == other.log.counts


@pytest.mark.parametrize("name", ["batch", "batch_schur", "batch_gnc", "isam2"])
def test_a_time_budget_ends_it_too(name, simulated, monkeypatch):
    # Each look at the clock is a second later.
    monkeypatch.setattr(descent, "time", SimpleNamespace(monotonic=itertools.count().__next__))
    found = estimated(name, simulated, final_iterations=10, budget_s=3.0)
    assert found.complete
    assert any("iterations (budget_s)" in event for event in found.log.events)


def test_smart_factors_are_bounded_as_well(simulated):
    found = estimated("batch", simulated, factors="smart", max_iterations=1)
    assert found.complete
    assert found.log.counts["optimisation_iterations"] == 1
    assert "batch: stopped after 1 iterations (max_iterations)" in found.log.events[0]


def test_ctrl_c_is_heard_between_iterations(simulated):
    told = []

    def interrupt(line):
        told.append(line)
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(Interrupted), interruptible():
        estimated("batch", simulated, interrupt)
    assert len(told) == 1


@pytest.mark.parametrize("options", [{"max_iterations": 0}, {"budget_s": 0.0}, {"budget_s": -1.0}])
def test_a_budget_of_nothing_is_refused(options, simulated):
    config, dataset = simulated
    with pytest.raises(ConfigError, match=next(iter(options))):
        BUILD["batch"](make_problem(config, dataset), options)


def test_iterations_are_logged_without_anybody_to_tell(simulated, caplog):
    with caplog.at_level("INFO", "vislam.estimators.smoother"):
        estimated("batch", simulated)
    assert "optimisation (cholesky): iteration 1 of at most 300, cost" in caplog.text
