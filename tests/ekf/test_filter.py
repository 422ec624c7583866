"""The working filter: against the dense one, on noise-free data, its gate, its landmarks."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import from_first
from vislam.base.errors import DivergedError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.run import Run
from vislam.core.step import TWIST_BIAS
from vislam.estimators.ekf import EkfEstimator, EkfOptions, parametrisation
from vislam.estimators.ekf.dense import DenseFilter
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.linear import Jacobian, Update
from vislam.estimators.ekf.propagation import Measurement
from vislam.estimators.ekf.state import JointState
from vislam.estimators.loop import run
from vislam.models import StereoRig
from vislam.models.odometry import BIAS
from vislam.repair import RepairConfig
from vislam.repair.pixels import Disparity
from vislam.simulation import SimulationConfig


def filtered(config: Config, dataset: Dataset) -> Run:
    estimator = EkfEstimator(make_problem(config, dataset), EkfOptions())
    return run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="ekf")


def test_it_equals_the_dense_filter(short: Dataset, short_config: Config):
    problem = make_problem(short_config, short)
    working, dense = (
        EkfEstimator(problem, EkfOptions(gate=False, track_errors="states")),
        DenseFilter(problem),
    )
    for frame in short.sequence.frames(pixel_sigma(short_config, short)):
        step = working.process(frame)
        dense.process(frame)
        assert np.allclose(step.pose, dense.world_T_imu, atol=1e-9)
        assert np.allclose(working.state.nav[BIAS], dense.bias, atol=1e-9)
        # Relative to the variances: the dense filter loses symmetry in the last digits.
        assert np.allclose(step.pose_cov, dense.cov[:6, :6], rtol=1e-6, atol=1e-13)
    assert frame.k == len(short.sequence) - 1


def test_landmarks_in_view_equal_the_dense_filters(short: Dataset, short_config: Config):
    problem = make_problem(short_config, short)
    working, dense = (
        EkfEstimator(problem, EkfOptions(gate=False, track_errors="states")),
        DenseFilter(problem),
    )
    for frame in short.sequence.frames(pixel_sigma(short_config, short)):
        working.process(frame)
        dense.process(frame)
    slots = [dense.track.index(int(track)) for track in working.state.track]
    assert len(slots) > 5
    assert np.allclose(working.state.landmarks, dense.landmarks[slots], atol=1e-8)
    rows = np.concatenate([np.arange(12), *(12 + 4 * slot + np.arange(4) for slot in slots)])
    own = np.arange(len(working.state.cov))
    cov = working.state.cov[np.ix_(own, own)]
    assert np.allclose(cov, dense.cov[np.ix_(rows, rows)], rtol=1e-6, atol=1e-10)


def test_without_noise_it_ends_at_the_truth(short_config: Config):
    clean = SimulationConfig(frames=40, pixel_sigma_px=0.0, gyro_sigma=0.0, velocity_sigma=0.0)
    config = replace(short_config, data=DataConfig(simulation=clean))
    dataset = open_dataset(config.data, seed=1)
    result = filtered(config, dataset)
    assert result.complete
    error = result.final.world_T_imu[:, :3, 3] - from_first(dataset.reference.pose)[:, :3, 3]
    # What is left is the straight line between inertial samples, not the filter's.
    assert np.abs(error).max() < 5e-3


def test_the_bias_is_found(short_config: Config):
    biased = SimulationConfig(frames=180, gyro_bias=(0.01, -0.012, 0.008), pixel_sigma_px=0.3)
    config = replace(short_config, data=DataConfig(simulation=biased))
    dataset = open_dataset(config.data, seed=2)
    result = filtered(config, dataset)
    assert np.allclose(result.states[TWIST_BIAS].value[-1, :3], biased.gyro_bias, atol=1e-3)


def test_the_gate_refuses_planted_outliers_and_little_else(short_config: Config):
    planted = SimulationConfig(frames=120, outlier_probability=0.05, pixel_sigma_px=0.3)
    config = replace(
        short_config,
        data=DataConfig(
            simulation=planted,
            repair=RepairConfig(consensus=None, disparity=Disparity(row_difference_px=100.0)),
        ),
    )
    dataset = open_dataset(config.data, seed=4)
    result = filtered(config, dataset)
    rows = dataset.sequence.pixels[:, 1] - dataset.sequence.pixels[:, 3]
    wrong = (np.abs(rows) > 3.0) & (dataset.sequence.age() > 0)
    fused_later = dataset.sequence.age() > 0
    assert result.gated[wrong].mean() > 0.9
    # Tracks that begin with an outlier have all their good observations refused: hence not 0.3 %.
    assert result.gated[fused_later & ~wrong].mean() < 0.2
    assert not np.any(result.used & result.gated)


@pytest.mark.parametrize("probability", [0.8, 0.9])
def test_the_gate_refuses_the_share_that_it_is_set_to(short_config: Config, probability: float):
    planted = SimulationConfig(
        frames=150, pixel_sigma_px=0.3, loss_probability=0.02, outlier_probability=0.0, tracks_in_view=30
    )
    unrepaired = RepairConfig(consensus=None, disparity=Disparity(row_difference_px=100.0))
    config = replace(
        short_config,
        data=DataConfig(simulation=planted, repair=unrepaired),
        noise=replace(short_config.noise, pixel_sigma_px=0.3, drift_px=0.0, matching_bias_px=0.0),
        gate_probability=probability,
    )
    dataset = open_dataset(config.data, seed=2)
    estimator = EkfEstimator(make_problem(config, dataset), EkfOptions())
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="ekf")
    seen = found.gated | (found.used & (dataset.sequence.age() > 0))
    # Innovations have three degrees of freedom: with the bound of two, the share would be twice as large.
    assert found.gated[seen].mean() == pytest.approx(1.0 - probability, rel=0.3)


def test_nis_is_that_of_the_model(short: Dataset, short_config: Config):
    options = EkfOptions(gate=False, track_errors="states")
    ungated = EkfEstimator(make_problem(short_config, short), options)
    result = run(ungated, short.sequence, pixel_sigma(short_config, short), name="ekf")
    ratio = result.innovations.nis.sum() / result.innovations.dof.sum()
    # Five standard deviations of a chi-square of that size.
    assert abs(ratio - 1.0) < 5.0 * np.sqrt(2.0 / result.innovations.dof.sum()) + 0.03


def test_a_lost_covariance_raises_with_its_smallest_eigenvalue():
    layout = NavLayout({"twist_bias": 6, "clock": 1})
    size = layout.size
    jacobian = Jacobian(np.eye(3, size), np.empty((0, 3, 4)), np.empty(0, np.int64), nav=size)
    projected = -np.eye(3, size)
    with pytest.raises(DivergedError, match="smallest eigenvalue of H P H' is -1"):
        Update.of(jacobian, projected, -np.eye(3), np.zeros(3))
    camera_free = parametrisation.make("point", StereoRig(1.0, 1.0, 0.0, 0.0, 1.0, np.eye(4)))
    state = JointState(camera_free, "standard", layout, nav=np.zeros(size), cov=0.25 * np.eye(size))
    with pytest.raises(DivergedError, match=r"covariance lost, smallest eigenvalue -0\.75"):
        state.correct(Update.of(jacobian, np.eye(3, size), np.eye(3), np.zeros(3)))


def test_without_drift_and_match_error_both_ways_of_taking_them_are_one(short: Dataset, short_config: Config):
    plain = replace(short_config, noise=replace(short_config.noise, drift_px=0.0, matching_bias_px=0.0))
    problem, sigma = make_problem(plain, short), pixel_sigma(plain, short)
    runs = [
        run(EkfEstimator(problem, EkfOptions(track_errors=how)), short.sequence, sigma, name=how)
        for how in ("states", "independent")
    ]
    assert np.allclose(runs[0].final.world_T_imu, runs[1].final.world_T_imu, atol=1e-6)
    assert np.isclose(
        runs[0].innovations.log_likelihood.sum(), runs[1].innovations.log_likelihood.sum(), rtol=1e-4
    )


def test_the_states_explain_tracks_that_drift_better_than_white_noise(short: Dataset, short_config: Config):
    sigma = pixel_sigma(short_config, short)
    problem = make_problem(short_config, short)
    states, white = (
        run(EkfEstimator(problem, EkfOptions(gate=False, track_errors=how)), short.sequence, sigma, name=how)
        for how in ("states", "independent")
    )
    assert states.innovations.log_likelihood.sum() > white.innovations.log_likelihood.sum() + 50.0


def test_what_is_measured_at_a_frame_is_weighed_together(short: Dataset, short_config: Config, monkeypatch):
    """Two equal measurements of one component are as one of half the variance, each from the same state."""
    problem = make_problem(short_config, short)
    solver = EkfEstimator(problem, EkfOptions())
    frame = next(iter(short.sequence.frames(pixel_sigma(short_config, short))))
    bias = solver.state.layout["twist_bias"].start
    prior, variance = solver.state.cov[bias, bias], 2.0 * solver.state.cov[bias, bias]
    by_nav = np.eye(1, solver.state.layout.size, bias)
    twice = [Measurement(np.array([1e-3]), by_nav, np.array([variance]))] * 2
    monkeypatch.setattr(solver._motion, "measurements", lambda *_: twice)
    before = solver.state.nav[bias]
    solver._measure(solver.state, frame)
    assert solver.state.nav[bias] - before == pytest.approx(1e-3 * prior / (prior + variance / 2.0))
