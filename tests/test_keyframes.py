"""Keyframes by raw inertia: the same information for all, and what is known of the frames between."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.inertial import IMU, drive, errors, ran
from tests.smoother.test_inertial import SMALL
from vislam.base.errors import ConfigError
from vislam.comparison import config as configuration
from vislam.comparison.compare import make_problem
from vislam.comparison.config import Config
from vislam.comparison.open import open_dataset
from vislam.core.imu import ImuStep
from vislam.evaluation.normalised import pose_errors
from vislam.geometry import se3, so3
from vislam.models.imu import IMU_NAV, STATES, ImuNoise
from vislam.models.inertial_gap import InertialState, fill_gap


def keyed(every, **settings):
    """Config and dataset of a drive with keyframes."""
    config, _ = drive(**settings)
    config = replace(config, data=replace(config.data, keyframe_every=every))
    return config, open_dataset(config.data, seed=settings.get("seed", 1))


def test_observations_between_keyframes_are_dropped_counted_and_told():
    whole = drive()[1].sequence
    config, dataset = keyed(4)
    sequence = dataset.sequence
    assert np.flatnonzero(sequence.keyframe).tolist() == [0, 4, 8, 12, 16, 20, 24]
    assert set(sequence.frame_of.tolist()) == {0, 4, 8, 12, 16, 20, 24}
    dropped = whole.observations - sequence.observations
    assert sequence.counts["dropped_between_keyframes"] == dropped
    assert any(f"the {dropped} of frames between" in note for note in dataset.notes)
    flags = [frame.keyframe for frame in sequence.frames(np.ones((sequence.observations, 3)))]
    assert flags == sequence.keyframe.tolist()
    alone = sequence.at_keyframes()
    assert alone.stamp.tolist() == sequence.stamp[::4].tolist()
    assert np.array_equal(np.diff(alone.offset), np.diff(sequence.offset)[::4])
    part = sequence.part(2, 10)
    assert np.flatnonzero(part.keyframe).tolist() == [2, 6]
    # The tracker drifts on between keyframes.
    drifting = replace(config, noise=replace(config.noise, drift_px=0.1))
    assert make_problem(drifting, dataset).track_noise.drift == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motion": "odometry"}, r"data\.keyframe_every: 4 leaves frames .* motion is odometry; set it to 1"),
        ({"lags": [0, 5]}, r"lags: a smoother has no poses of the frames between"),
    ],
)
def test_keyframes_without_what_they_need_are_refused(changes, message):
    data = {"keyframe_every": 4, "simulation": {"frames": 20, "imu": {}}}
    tree = {"name": "keyed", "data": data, "motion": "imu"}
    assert configuration.parse(Config, tree).data.keyframe_every == 4
    with pytest.raises(ConfigError, match=message):
        configuration.parse(Config, {**tree, **changes})


def test_joined_steps_are_one_step():
    dataset = drive()[1]
    steps = list(dataset.sequence.imu.steps(dataset.sequence.stamp))[1:5]
    joined = ImuStep.joined(steps)
    whole = next(iter(list(dataset.sequence.imu.steps(dataset.sequence.stamp[[0, 4]]))[1:]))
    assert joined.dt.sum() == pytest.approx(whole.dt.sum())
    assert len(joined.known) == sum(len(step.known) for step in steps)
    noise, zero = ImuNoise(1e-3, 1e-2, 1e-4, 1e-3), np.zeros(3)
    # Where a sample is interpolated at the frames between, the lines are those of the whole step.
    one, other = (step.preintegrated(noise, zero, zero) for step in (joined, whole))
    assert np.allclose(one.rotation, other.rotation, atol=1e-6)
    assert np.allclose(one.position, other.position, atol=1e-5)
    assert ImuStep.joined(steps[:1]) is steps[0]


def test_states_in_a_gap_are_those_of_weighted_least_squares(rng):
    """Against the normal equations of all errors, for a known state at both ends."""
    noise, gravity = ImuNoise(1e-3, 1e-2, 1e-3, 1e-2), np.array([0.0, 0.0, -9.81])
    dataset = drive()[1]
    bias = 1e-2 * rng.standard_normal(6)
    samples = list(dataset.sequence.imu.steps(dataset.sequence.stamp))[1:5]
    steps = [step.preintegrated(noise, bias[:3], bias[3:]) for step in samples]
    pose = se3.from_rotation_translation(so3.exp(rng.standard_normal(3)), rng.standard_normal(3))
    before = InertialState(pose, rng.standard_normal(3), bias[:3], bias[3:])
    predicted = fill_gap(before, None, steps, gravity)
    after = predicted[-1].moved(1e-5 * rng.standard_normal(IMU_NAV))
    rows, right, places = [], [], [before, *predicted]
    for k, step in enumerate(steps):
        transition, spread = step.linear(places[k].pose[:3, :3])
        root = np.linalg.inv(np.linalg.cholesky(spread))
        row = np.zeros((IMU_NAV, 5 * IMU_NAV))
        row[:, k * IMU_NAV : (k + 1) * IMU_NAV] = -root @ transition
        row[:, (k + 1) * IMU_NAV : (k + 2) * IMU_NAV] = root
        rows.append(row)
        right.append(np.zeros(IMU_NAV))
    matrix, known = np.concatenate(rows), places[-1].to(after)
    inner = slice(IMU_NAV, 4 * IMU_NAV)
    solved = np.linalg.lstsq(matrix[:, inner], -matrix[:, 4 * IMU_NAV :] @ known, rcond=None)[0]
    found = fill_gap(before, after, steps, gravity)
    assert len(found) == 3
    moved = np.concatenate([one.to(other) for one, other in zip(predicted[:3], found, strict=True)])
    assert np.allclose(moved, solved, atol=1e-9)


LINEAR = {
    "seed": 6,
    "frames": 11,
    "period": 0.05,
    "speed": 0.5,
    "depth_min": 3.0,
    "depth_max": 6.0,
    "pixel": 0.1,
    "loss_probability": 0.0,
    "imu": SMALL,
}
"""Landmarks that all keyframes see."""


def test_filter_and_smoother_agree_at_keyframes_and_between():
    """The last frame is no keyframe, and predicted by both."""
    config, dataset = keyed(3, **LINEAR)
    _, eks = ran("eks", config, dataset, gate=False)
    _, batch = ran("batch", config, dataset, marginals="poses", pose_cov_every=1)
    assert eks.complete
    assert batch.complete, batch.log.error
    apart = np.abs(se3.local(eks.final.world_T_imu, batch.final.world_T_imu))
    assert apart.max() < 1e-6
    sigma = np.sqrt(np.diagonal(eks.final.covariances, axis1=1, axis2=2))
    theirs = np.sqrt(np.diagonal(batch.final.covariances, axis1=1, axis2=2))
    assert np.allclose(theirs[1:], sigma[1:], rtol=0.02)
    # Filtered, between as at keyframes.
    last = np.abs(se3.local(eks.filtered.world_T_imu, batch.filtered.world_T_imu))
    assert last.max() < 2e-6
    theirs = np.sqrt(np.diagonal(batch.filtered.covariances, axis1=1, axis2=2))
    sigma = np.sqrt(np.diagonal(eks.filtered.covariances, axis1=1, axis2=2))
    assert np.allclose(theirs[1:], sigma[1:], rtol=0.02)
    for name in STATES:
        assert np.allclose(batch.states[name].sigma, eks.states[name].sigma, rtol=0.02)
    again = dataset.sequence.seen_again()
    assert np.array_equal(batch.used, eks.used & again)
    assert again.sum() > 100


@pytest.mark.parametrize("name", ["ekf_invariant", "msckf", "isam2", "fixed_lag"])
def test_with_every_frame_a_keyframe_nothing_changes(name):
    config, dataset = drive(frames=12)
    all_of_them = replace(dataset, sequence=dataset.sequence.with_keyframes(1))
    one, other = (ran(name, config, data)[1] for data in (dataset, all_of_them))
    assert np.array_equal(one.final.world_T_imu, other.final.world_T_imu)
    assert np.array_equal(one.filtered.world_T_imu, other.filtered.world_T_imu)
    assert np.array_equal(one.filtered.covariances, other.filtered.covariances, equal_nan=True)
    assert np.array_equal(one.used, other.used)


@pytest.mark.parametrize("name", ["ekf", "ekf_fej", "eks", "msckf", "isam2", "fixed_lag", "batch"])
def test_a_drive_is_found_between_keyframes(name):
    config, dataset = keyed(4, seed=2, frames=30, loss_probability=0.01)
    options = {"lag_s": 1.5} if name == "fixed_lag" else {}
    _, run = ran(name, config, dataset, **options)
    assert run.complete, run.log.error
    assert len(run.final.world_T_imu) == 30
    position, turn = errors(run, dataset)
    assert position.max() < 1.0
    assert turn.max() < 0.04
    # Frames between are no worse than the keyframes around them: no jump is left.
    jumps = np.abs(np.diff(position[1:-2]))
    assert jumps.max() < 0.1
    assert run.used.any()


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["ekf_invariant", "eks", "isam2", "msckf"])
def test_poses_are_as_right_as_is_said_at_keyframes_and_between(name):
    """NEES over twelve drives at the last keyframe and the two frames before it; false alarm 1e-3 each."""
    drives, total = 12, {"filtered": np.zeros(3), "smoothed": np.zeros(3)}
    options = {"isam2": {"marginals": "poses", "pose_cov_every": 1}}.get(name, {"gate": False})
    for seed in range(drives):
        config, dataset = keyed(3, seed=200 + seed, frames=40, pixel=0.5, imu=IMU, loss_probability=0.01)
        _, run = ran(name, config, dataset, **options)
        for estimate in run.estimates:
            nees = pose_errors(run, dataset.reference, estimate=estimate)["pose"].nees
            total[estimate] += nees[-3:] if estimate == "filtered" else nees[-5:-2]
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * drives)
    for estimate in run.estimates:
        assert np.all((low < total[estimate]) & (total[estimate] < high)), (estimate, total)
