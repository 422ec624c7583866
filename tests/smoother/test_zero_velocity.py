"""Standing still: found in the data once, and the same measurement to filters and smoothers."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.inertial import PHONE, drive, ran, with_noise
from tests.smoother.test_inertial import SMALL
from vislam.comparison.compare import make_problem
from vislam.comparison.config import ZeroVelocityConfig
from vislam.comparison.inertia import started
from vislam.core.imu import ImuSeries
from vislam.estimators.ekf import motion as filters
from vislam.evaluation.normalised import pose_errors
from vislam.geometry import se3
from vislam.models.imu import STATES
from vislam.simulation import simulate

STOPPING = {"path": "urban", "frames": 160, "pixel": 0.5, "tracks": 40.0}


@dataclass(frozen=True)
class Even:
    """A path straight ahead at a constant speed [m/s]."""

    speed: float

    def pose(self, time):
        out = np.broadcast_to(np.eye(4), (len(time), 4, 4)).copy()
        out[:, 0, 3] = self.speed * time
        return out

    def twist(self, time):
        return np.broadcast_to([0.0, 0.0, 0.0, self.speed, 0.0, 0.0], (len(time), 6))

    def vertical_velocity(self, time):
        return np.zeros(len(time))


def on(config, **settings):
    return with_noise(config, zero_velocity=ZeroVelocityConfig(**settings))


def even(speed, *, frames=40, **settings):
    """Config and dataset of a body that moves evenly."""
    config, dataset = drive(frames=frames, **settings)
    sequence, _ = simulate(config.data.simulation, seed=3, name="even", path=Even(speed))
    return on(config), replace(dataset, sequence=sequence)


def frames_of(config, dataset):
    return make_problem(config, dataset).imu.standstill.frames


def speeds(dataset):
    step = np.diff(dataset.reference.pose[:, :3, 3], axis=0) / np.diff(dataset.sequence.stamp)[:, None]
    return np.linalg.norm(step, axis=1)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_stop_is_found_and_nothing_else(seed):
    config, dataset = drive(seed=seed, **STOPPING)
    found, speed = frames_of(on(config), dataset), speeds(dataset)
    assert np.count_nonzero(found) >= 0.9 * np.count_nonzero(speed < 1e-3)
    assert np.all(np.maximum(speed[1:], speed[:-1])[found[1:-1]] < 0.02)


@pytest.mark.parametrize("path", ["town", "highway", "straight"])
def test_a_drive_that_never_stops_has_none(path):
    config, dataset = drive(seed=2, path=path, frames=160, pixel=0.5, tracks=40.0)
    assert not frames_of(on(config), dataset).any()


@pytest.mark.parametrize(("speed", "share"), [(0.0, 0.9), (0.05, 0.0), (-0.05, 0.0), (1.0, 0.0)])
def test_a_slow_creep_is_no_standstill(speed, share):
    """Evenly, so that inertia does not tell the two apart."""
    found = frames_of(*even(speed, pixel=0.5, tracks=40.0))
    assert np.mean(found) >= share if share else not found.any()


@pytest.mark.parametrize("settings", [{"tracks": 3.0, "pixel": 0.5}, {"tracks": 40.0, "pixel": 8.0}])
def test_where_tracks_would_not_tell_a_creep_nothing_is_taken_for_a_standstill(settings):
    assert not frames_of(*even(0.0, frames=20, **settings)).any()


def test_samples_of_a_gap_are_not_steady():
    config, dataset = even(0.0, frames=25)
    whole = dataset.sequence.imu
    kept = (whole.stamp < 1.0) | (whole.stamp > 1.4)
    torn = ImuSeries(whole.stamp[kept], whole.gyro[kept], whole.accel[kept])
    found = frames_of(config, replace(dataset, sequence=replace(dataset.sequence, imu=torn)))
    assert not found[8:16].any()


def test_it_is_decided_once():
    """What is decided is not looked for again, with moved data neither."""
    config, dataset = even(0.0, frames=13)
    decided = started(config, dataset)
    blind = replace(decided, sequence=dataset.sequence.select(np.zeros(dataset.sequence.observations, bool)))
    assert frames_of(config, blind) is decided.standstill.frames
    assert make_problem(with_noise(config, zero_velocity=None), decided).imu.standstill is None


def test_it_is_not_used_unless_asked_for():
    config, dataset = drive(seed=0, **STOPPING)
    assert make_problem(config, dataset).imu.standstill is None


def test_the_measurement_says_nothing_of_where_the_world_is():
    """Whatever the estimate: along the four free motions its Jacobian is zero."""
    config, dataset = even(0.0, frames=13)
    problem = make_problem(config, dataset)
    motion = filters.make(problem)
    layout = filters.navigation(problem, motion).layout
    rng = np.random.default_rng(4)
    pose, nav = se3.exp(rng.normal(size=6)), rng.normal(size=layout.size)
    frames = list(dataset.sequence.frames(np.ones((dataset.sequence.observations, 3))))
    (found,) = motion.measurements(layout, pose, nav, frames[5])
    free = np.zeros((layout.size, 6))
    free[:6], free[6:] = se3.adjoint(se3.inverse(pose)), layout.moved(nav)
    assert np.abs(found.by_nav @ free).max() < 1e-12
    for j in range(layout.size):
        step = np.zeros(layout.size)
        step[j] = 1e-6
        there = motion.measurements(layout, se3.retract(pose, step[:6]), nav + step, frames[5])[0]
        assert (found.innovation - there.innovation) / 1e-6 == pytest.approx(found.by_nav[:, j], abs=1e-5)


def test_filter_and_smoother_agree_where_all_is_linear():
    config, dataset = even(0.0, frames=14, pixel=0.1, imu=SMALL, depth_min=3.0, depth_max=6.0)
    still = frames_of(config, dataset)
    assert np.count_nonzero(still) > 10
    _, eks = ran("eks", config, dataset, gate=False)
    _, batch = ran("batch", config, dataset)
    assert eks.information["zero velocity"] == batch.information["zero velocity"]
    assert np.abs(se3.local(eks.final.world_T_imu, batch.final.world_T_imu)).max() < 1e-6
    for name in STATES:
        off = eks.states[name].value[-1] - batch.states[name].value[-1]
        assert np.all(np.abs(off) < 0.02 * eks.states[name].sigma[-1])


@pytest.mark.parametrize("name", ["ekf", "ekf_fej", "ekf_invariant", "msckf", "isam2", "fixed_lag"])
def test_every_estimator_takes_it(name):
    """Through a stop its velocity is known better by it, and no other frames change before."""
    config, dataset = even(0.0, frames=20, tracks=12.0)
    _, without = ran(name, with_noise(config, zero_velocity=None), dataset, **covariances(name))
    _, found = ran(name, config, dataset, **covariances(name))
    assert found.complete, found.log.error
    assert np.all(found.states["velocity"].sigma[10] < without.states["velocity"].sigma[10])
    assert np.array_equal(found.filtered.world_T_imu[0], without.filtered.world_T_imu[0])


def covariances(name):
    return {"pose_cov_every": 10} if name in ("isam2", "fixed_lag") else {"gate": False}


def drifted(run, still):
    """How far a run moves from the first to the last frame of a stop [m]."""
    first, last = np.flatnonzero(still)[[0, -1]]
    return np.linalg.norm(run.filtered.world_T_imu[last, :3, 3] - run.filtered.world_T_imu[first, :3, 3])


@pytest.mark.statistical
def test_a_car_that_stops_drifts_less_and_is_as_right_as_it_says():
    """Eight drives with a phone's sensor and eight tracks; NEES of the last pose, false alarm 1e-3 each."""
    drives, members = 8, {"ekf_invariant": {"gate": False}, "isam2": {"marginals": "poses"}}
    nees, moved = dict.fromkeys(members, 0.0), {name: ([], []) for name in members}
    for seed in range(drives):
        config, dataset = drive(seed=seed, **{**STOPPING, "tracks": 8.0, "imu": PHONE})
        still = frames_of(on(config), dataset)
        for name, options in members.items():
            runs = [ran(name, one, dataset, **options)[1] for one in (on(config), config)]
            nees[name] += float(pose_errors(runs[0], dataset.reference)["pose"].nees[-1])
            for run, parts in zip(runs, moved[name], strict=True):
                parts.append(drifted(run, still))
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * drives)
    assert all(low < one < high for one in nees.values()), nees
    for using, without in moved.values():
        assert np.sum(np.square(using)) < np.sum(np.square(without)), moved
