"""Raw inertia as the filter's model of motion: its derivatives, what stays unobservable, what it reports."""

from dataclasses import replace

import numpy as np
import pytest

from tests.inertial import IMU, drive, errors, ran
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.imu import ImuSeries
from vislam.estimators.ekf.inertial import InertialMotion
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.motion import navigation
from vislam.geometry import se3, so3
from vislam.models.imu import STATES, VELOCITY
from vislam.models.odometry import POSE


def motion_of(config, dataset):
    problem = make_problem(config, dataset)
    motion = InertialMotion(problem)
    return motion, navigation(problem, motion)


def test_transition_is_the_derivative_of_the_step(rng):
    config, dataset = drive()
    motion, start = motion_of(config, dataset)
    layout = start.layout
    *_, frame = dataset.sequence.first(4).frames(pixel_sigma(config, dataset))
    pose, nav = se3.exp(rng.normal(size=6)), rng.normal(size=layout.size)
    found = motion.propagate(layout, pose, nav, frame)
    after, means = pose @ found.prev_T_next, nav + found.change
    for axis in range(layout.size):
        ends = []
        for sign in (1.0, -1.0):
            error = np.zeros(layout.size)
            error[axis] = 1e-5 * sign
            moved = se3.retract(pose, error[POSE])
            other = motion.propagate(layout, moved, nav + error, frame)
            end = nav + error + other.change - means
            end[POSE] = se3.local(after, moved @ other.prev_T_next)
            ends.append(end)
        assert np.allclose(found.transition[:, axis], (ends[0] - ends[1]) / 2e-5, atol=2e-7)


def test_motions_of_the_world_stay_what_they_are(rng):
    """But for the turns about x and y, which gravity shows."""
    config, dataset = drive()
    motion, start = motion_of(config, dataset)
    layout = start.layout
    *_, frame = dataset.sequence.first(4).frames(pixel_sigma(config, dataset))
    pose, nav = se3.exp(rng.normal(size=6)), rng.normal(size=layout.size)
    found = motion.propagate(layout, pose, nav, frame)

    def directions(pose, nav):
        return np.concatenate([se3.adjoint(se3.inverse(pose)), layout.moved(nav)])

    before = directions(pose, nav)
    after = directions(pose @ found.prev_T_next, nav + found.change)
    assert np.allclose((found.transition @ before)[:, 2:], after[:, 2:], atol=1e-12)
    assert np.abs((found.transition @ before - after)[:, :2]).max() > 0.1


def test_time_without_samples_is_uncertain():
    config, dataset = drive()
    motion, start = motion_of(config, dataset)
    whole = dataset.sequence.imu
    kept = (whole.stamp < 0.21) | (whole.stamp > 0.29)
    torn = ImuSeries(whole.stamp[kept], whole.gyro[kept], whole.accel[kept])
    steps = []
    for series in (whole, torn):
        sequence = replace(dataset.sequence, imu=series).first(4)
        *_, frame = sequence.frames(pixel_sigma(config, dataset))
        steps.append(motion.propagate(start.layout, start.world_T_imu, start.nav, frame))
    grown = np.diagonal(steps[1].noise - steps[0].noise)
    assert frame.imu.missing == pytest.approx(0.08, abs=0.011)
    # The samples over the gap, less those of the noise, are what a line misses.
    missed = frame.imu.dt**2 @ frame.imu.missed
    bridged = np.sum(frame.imu.dt[~frame.imu.known]) * (motion._inertia.noise.gyro_density**2)
    assert np.allclose(grown[:3], missed[0], rtol=0.05, atol=0.2 * bridged)
    assert np.allclose(grown[6:9].sum(), 3.0 * missed[1], rtol=0.2)
    turned = so3.log(steps[0].prev_T_next[:3, :3].T @ steps[1].prev_T_next[:3, :3])
    assert np.linalg.norm(turned) < 4.0 * np.sqrt(3.0 * (missed[0] + 2.0 * bridged))


def gained(config, dataset, **options):
    options = {"gate": False, "marginalised_landmarks": "filtered", "observability": True, **options}
    _, run = ran("ekf", config, dataset, **options)
    assert run.complete
    return run.innovations.spurious_information.sum(axis=0)[2:]


def test_four_directions_stay_unobservable():
    config, dataset = drive()
    standard = gained(config, dataset)
    assert np.all(standard > 1.0)
    for error in ("first_estimates", "invariant"):
        for landmarks in ("point", "disparity"):
            found = gained(config, dataset, error=error, landmarks=landmarks)
            assert np.all(found < 1e-9 * standard), error
    for error in ("first_estimates", "invariant"):
        _, run = ran("msckf", config, dataset, gate=False, error=error)
        assert np.all(run.innovations.spurious_information.sum(axis=0)[2:] < 1e-9 * standard)


def test_a_velocity_that_is_not_reset_is_seen(monkeypatch):
    """Guards the test above: the velocity is of the group."""
    config, dataset = drive()
    standard = gained(config, dataset)
    monkeypatch.setattr(NavLayout, "moves", False)
    for error in ("first_estimates", "invariant"):
        assert gained(config, dataset, error=error)[0] > 1e-6 * standard[0]


@pytest.mark.parametrize("name", ["ekf_fej", "ekf_invariant", "eks", "msckf"])
def test_a_drive_and_its_states_are_found(name):
    config, dataset = drive()
    _, run = ran(name, config, dataset, gate=False)
    assert run.complete, run.log.error
    position, turn = errors(run, dataset)
    assert position[-1] < 1.0
    assert turn.max() < 0.04
    assert set(run.states) == set(STATES)
    velocity = run.states[VELOCITY]
    truth = np.diff(dataset.reference.position[-2:], axis=0)[0] / 0.1
    # Of the last step, half a period before.
    assert np.all(np.abs(velocity.value[-1] - truth) < 4.0 * velocity.sigma[-1] + 0.2)
    assert np.all(run.states["gyro_bias"].sigma[-1] < 0.2 * IMU.gyro_bias_sigma)


def test_data_that_lack_what_it_takes_are_told():
    config, dataset = drive()
    imu = dataset.sequence.imu
    early = ImuSeries(imu.stamp[:20], imu.gyro[:20], imu.accel[:20])
    for change, told in (
        ({"imu": None}, "motion: imu needs an accelerometer and a gyro"),
        ({"start": None, "imu": early}, "motion: imu starts from attitude, velocity and biases"),
    ):
        lacking = replace(dataset, sequence=replace(dataset.sequence, **change))
        with pytest.raises(ConfigError, match=told):
            make_problem(config, lacking)


def test_settings_of_the_twist_are_refused():
    config, dataset = drive()
    clocked = replace(config, noise=replace(config.noise, clock_sigma=0.01))
    with pytest.raises(ConfigError, match=r"set noise.clock_sigma to 0"):
        make_problem(clocked, dataset)
