"""What the filter may estimate or weigh beside pose, bias and landmarks: planted, and found again."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import from_first
from tests.records import made_record
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, KernelConfig, VerticalVelocityConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.estimator import find
from vislam.core.run import Run
from vislam.core.step import TWIST_BIAS
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.linear import Update
from vislam.estimators.ekf.state import JointState
from vislam.estimators.loop import run
from vislam.evaluation import evaluate
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.repair.inertial import Clock
from vislam.repair.pixels import Disparity

INVARIANT = {"error": "invariant", "landmarks": "anchored_uvd"}


def drive(
    short_config: Config, *, seed: int, frames: int = 150, noise=None, repair=None, **simulation
) -> tuple[Config, Dataset]:
    """A longer drive like the short one, and its config."""
    longer = replace(short_config.data.simulation, frames=frames, **simulation)
    data = DataConfig(simulation=longer, repair=repair or short_config.data.repair)
    config = replace(short_config, data=data, noise=replace(short_config.noise, **(noise or {})))
    return config, open_dataset(config.data, seed=seed)


def filtered(config: Config, dataset: Dataset, **options) -> tuple[Run, EkfEstimator]:
    estimator = EkfEstimator(make_problem(config, dataset), EkfOptions(**{**INVARIANT, **options}))
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="ekf")
    assert found.complete, found.log.error
    return found, estimator


@pytest.mark.parametrize(("taken_for", "left"), [(None, 0.03), (0.05, -0.02)])
def test_a_clock_offset_is_found(short_config: Config, taken_for, left):
    """With good samples: noise in them, averaged best half-way between two, draws the clock there."""
    repair = short_config.data.repair
    if taken_for is not None:
        repair = replace(repair, clock=Clock(offset=taken_for))
    root = np.sqrt(0.1046)
    config, dataset = drive(
        short_config,
        seed=5,
        noise={"clock_sigma": 0.05, "twist_density": (2e-4 * root,) * 3 + (2e-3 * root,) * 3},
        repair=repair,
        clock_offset=0.03,
        gyro_sigma=2e-4,
        velocity_sigma=2e-3,
    )
    _, estimator = filtered(config, dataset)
    clock = estimator.state.layout["clock"].start
    assert np.sqrt(estimator.state.cov[clock, clock]) < 0.003
    assert abs(estimator.state.nav[clock] - left) < 0.003


def test_a_disparity_offset_is_found(short_config: Config):
    config, dataset = drive(
        short_config,
        seed=6,
        noise={"disparity_offset_sigma_px": 1.0, "matching_bias_px": 0.0},
        disparity_offset_px=-0.4,
        matching_bias_px=0.0,
    )
    _, estimator = filtered(config, dataset)
    state = estimator.state
    offset = state.layout["disparity_offset"].start
    sigma = np.sqrt(state.cov[offset, offset])
    assert sigma < 0.05
    assert abs(state.nav[offset] + 0.4) < 4.0 * sigma


def test_a_state_with_no_prior_spread_stays_what_it_is(short_config: Config):
    fixed = (0.0, 0.0, 0.0, 0.0, 0.05, 0.02)
    config, dataset = drive(
        short_config, seed=7, frames=40, noise={"bias_sigma": fixed, "bias_walk": (0.0,) * 4 + (5e-4,) * 2}
    )
    found, estimator = filtered(config, dataset)
    assert np.all(found.states[TWIST_BIAS].value[:, :4] == 0.0)
    assert np.all(found.states[TWIST_BIAS].value[-1, 4:] != 0.0)
    assert list(estimator.state.layout) == ["pose", "twist_bias"]


def climbing(
    short_config: Config, *, vertical_velocity: VerticalVelocityConfig | None, **options
) -> tuple[Run, Dataset, EkfEstimator]:
    """A hilly drive with a levelled velocity, whose gyro's roll and pitch are poor."""
    repair = RepairConfig(consensus=None, navigation_frame_velocity=True)
    density = (0.01, 0.01, *short_config.noise.twist_density[2:])
    config, dataset = drive(
        short_config,
        seed=8,
        noise={"vertical_velocity": vertical_velocity, "twist_density": density},
        repair=repair,
        hills_m=10.0,
        navigation_frame_velocity=True,
        gyro_sigma=0.01,
    )
    found, estimator = filtered(config, dataset, **options)
    return found, dataset, estimator


@pytest.mark.parametrize(
    "options",
    [{}, {"error": "standard", "landmarks": "point", "track_errors": "states"}],
    ids=["invariant", "ekf"],
)
def test_the_vertical_velocity_holds_the_height(short_config: Config, options):
    with_climb, dataset, estimator = climbing(
        short_config, vertical_velocity=VerticalVelocityConfig(), **options
    )
    without, _, _ = climbing(short_config, vertical_velocity=None, **options)
    height = dataset.reference.pose[:, 2, 3] - dataset.reference.pose[0, 2, 3]
    found = with_climb.levelled().final.world_T_imu[:, 2, 3]
    assert np.abs(found - height).max() < 0.3
    lost = from_first(dataset.reference.pose)[:, 2, 3] - without.final.world_T_imu[:, 2, 3]
    assert np.abs(lost).max() > 2.0 * np.abs(found - height).max()
    # The vertical in the body's first frame, which is the world.
    true_up = dataset.reference.pose[0, 2, :3]
    sigma = np.sqrt(np.diagonal(estimator.state.cov)[estimator.state.layout["tilt"]])
    assert np.linalg.norm(with_climb.up - true_up) < 4.0 * np.linalg.norm(sigma) + 0.003
    metrics = evaluate({"ekf": with_climb}, made_record())
    assert np.isclose(metrics.value("ekf", "height_end"), found[-1])


def test_the_vertical_velocity_needs_to_be_there(short: Dataset, short_config: Config):
    config = replace(
        short_config, noise=replace(short_config.noise, vertical_velocity=VerticalVelocityConfig())
    )
    with pytest.raises(ConfigError, match=r"noise\.vertical_velocity: simulation has no vertical velocity"):
        make_problem(config, short)


def test_who_cannot_take_the_same_information_says_so(short: Dataset, short_config: Config):
    config = replace(short_config, noise=replace(short_config.noise, disparity_offset_sigma_px=0.1))
    with pytest.raises(ConfigError, match=r"isam2_between: .*noise\.disparity_offset_sigma_px to 0"):
        find("isam2_between")(make_problem(config, short), {})


def test_the_kernel_bears_outliers_that_nothing_gates(short_config: Config):
    repair = RepairConfig(consensus=None, disparity=Disparity(row_difference_px=100.0))
    config, dataset = drive(short_config, seed=9, repair=repair, outlier_probability=0.03)
    plain, _ = filtered(config, dataset, gate=False)
    weighted, _ = filtered(replace(config, kernel=KernelConfig()), dataset, gate=False)
    assert not weighted.innovations.dof.any()
    runs = {"plain": replace(plain, name="plain"), "robust": replace(weighted, name="robust")}
    score = evaluate(runs, made_record(dataset.reference))
    assert score.value("robust", "ate_rmse") < 0.7 * score.value("plain", "ate_rmse")


def test_iterations_end_at_the_most_probable_state(short: Dataset, short_config: Config, monkeypatch):
    """There the correction is ``P H^T R^-1`` times what is left of the innovation, H taken there, too."""
    problem = make_problem(short_config, short)
    estimator = EkfEstimator(
        problem,
        EkfOptions(gate=False, iterations=20, marginalised_landmarks="filtered", track_errors="states"),
    )
    checked = []

    def check(state: JointState, update: Update) -> None:
        correction = update.correction
        there = se3.retract(state.world_T_imu, correction[:6])
        landmarks = state.landmarks + correction[state.layout.size :].reshape(-1, 4)
        predicted = estimator._camera.view(there, state.nav, state.anchors, landmarks).measurement()
        left = (seen.pop() - predicted).reshape(-1) / np.tile(problem.track_noise.sigma**2, len(predicted))
        pull = update.jacobian.transposed_times(left[:, None], size=len(state.cov))
        scale = np.sqrt(np.diagonal(state.cov)) + 1e-12
        checked.append(np.abs((state.cov @ pull)[:, 0] - correction) / scale)
        true(state, update)

    true, seen = JointState.correct, []
    monkeypatch.setattr(JointState, "correct", check)
    for frame in short.sequence.frames(pixel_sigma(short_config, short)):
        order = {int(track): row for row, track in enumerate(frame.stereo.track)}
        known = [order[int(track)] for track in estimator.state.track if int(track) in order]
        seen[:] = [frame.stereo.z[known]]
        estimator.process(frame)
    assert len(checked) > 15
    assert max(change.max() for change in checked) < 5e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"iterations": 0}, "iterations must be at least 1, got 0"),
        ({"iterations": 3, "error": "invariant"}, "only the standard error can be iterated"),
        ({"smoothed": True, "marginalised_landmarks": "filtered"}, "smoothed poses need the backward pass"),
        ({"landmarks": "line"}, r"ekf\.landmarks: .*'point' or 'anchored_uvd', got 'line'"),
    ],
)
def test_options_without_a_meaning_get_a_line(short: Dataset, short_config: Config, options, message):
    with pytest.raises(ConfigError, match=message):
        find("ekf")(make_problem(short_config, short), options)


@pytest.mark.parametrize("member", ["ekf", "ekf_fej", "ekf_invariant"])
def test_the_covariance_stays_symmetric_and_positive(short_config: Config, member):
    config, dataset = drive(short_config, seed=11, frames=80)
    estimator = find(member)(make_problem(config, dataset), {"marginalised_landmarks": "filtered"})
    for frame in dataset.sequence.frames(pixel_sigma(config, dataset)):
        estimator.process(frame)
        known = np.diagonal(estimator.state.cov) > 0.0
        cov = estimator.state.cov[np.ix_(known, known)]
        sigma = np.sqrt(np.diagonal(cov))
        correlation = cov / np.outer(sigma, sigma)
        assert np.abs(correlation - correlation.T).max() < 1e-11
        assert np.linalg.eigvalsh(correlation)[0] > 0.0


@pytest.mark.parametrize("member", ["ekf", "ekf_iterated", "ekf_fej", "ekf_invariant", "eks"])
@pytest.mark.parametrize("first", [0, 30], ids=["from the start", "on the way"])
def test_frames_without_tracks_are_bridged(short_config: Config, member, first):
    config, dataset = drive(short_config, seed=3, frames=80)
    frame = dataset.sequence.frame_of
    sequence = dataset.sequence.select((frame < first) | (frame >= first + 20))
    # An id that is missing once never comes back.
    later = np.where(sequence.frame_of >= first + 20, sequence.track + 10_000, sequence.track)
    dataset = replace(dataset, sequence=replace(sequence, track=later))
    found = run(
        find(member)(make_problem(config, dataset), {}),
        dataset.sequence,
        pixel_sigma(config, dataset),
        name=member,
    )
    assert found.complete, found.log.error
    assert np.array_equal(found.landmarks.track, np.unique(later))
    assert np.isfinite(found.landmarks.points_cov).all()
    error = found.final.world_T_imu[:, :3, 3] - from_first(dataset.reference.pose)[:, :3, 3]
    assert np.abs(error[-1]).max() < 2.0


def test_pose_and_climbed_height_meet_where_their_variances_say(short_config: Config):
    """The height of the pose is that which the vertical velocity has led to: each gives way by its share."""
    config, dataset = drive(
        short_config,
        seed=1,
        frames=5,
        noise={"vertical_velocity": VerticalVelocityConfig(walk=0.1)},
        navigation_frame_velocity=True,
    )
    rates = replace(dataset.sequence, vertical_velocity=np.zeros(len(dataset.sequence.vertical_velocity)))
    estimator = EkfEstimator(make_problem(config, replace(dataset, sequence=rates)), EkfOptions())
    state = estimator.state
    height = state.layout["height"].start
    state.world_T_imu[2, 3], state.nav[height] = 1.0, 0.0
    state.cov[:] = np.diag(np.full(len(state.cov), 1e-12))
    state.cov[5, 5], state.cov[height, height] = 3.0, 1.0
    estimator._measure(state, next(iter(dataset.sequence.frames(pixel_sigma(config, dataset)))))
    assert state.world_T_imu[2, 3] == pytest.approx(0.25, abs=1e-3)
    assert state.nav[height] == pytest.approx(0.25, abs=1e-3)
