"""Preintegration: against GTSAM, against 10 kHz, its derivatives, and its own covariance by simulation."""

import gtsam
import numpy as np
import pytest

from vislam.geometry import se3, so3
from vislam.models.imu import ImuNoise
from vislam.models.preintegration import preintegrate

NOISE = ImuNoise(gyro_density=2e-3, accel_density=2e-2, gyro_walk=3e-3, accel_walk=3e-2)
STEADY = ImuNoise(gyro_density=2e-3, accel_density=2e-2, gyro_walk=0.0, accel_walk=0.0)
ZERO = np.zeros(3)
EARTH = np.array([3e-5, 2e-5, 5.5e-5])


def samples(rng, m=20):
    force = rng.normal(size=(m, 3)) + np.array([0.0, 0.0, 9.8])
    return rng.uniform(0.003, 0.007, m), 0.8 * rng.normal(size=(m, 3)), force


def parameters(noise):
    found = gtsam.PreintegrationCombinedParams.MakeSharedU(noise.gravity)
    found.setIntegrationCovariance(np.zeros((3, 3)))
    found.setGyroscopeCovariance(noise.gyro_density**2 * np.eye(3))
    found.setAccelerometerCovariance(noise.accel_density**2 * np.eye(3))
    found.setBiasOmegaCovariance(noise.gyro_walk**2 * np.eye(3))
    found.setBiasAccCovariance(noise.accel_walk**2 * np.eye(3))
    return found


def integrated(kind, noise, data, bias):
    found = kind(parameters(noise), gtsam.imuBias.ConstantBias(bias[3:], bias[:3]))
    for dt, gyro, accel in zip(*data, strict=True):
        found.integrateMeasurement(accel, gyro, dt)
    return found


def in_gtsams_order(pre):
    """Covariance with p and v in the last body, as GTSAM has it, and its biases as first less last."""
    turn = np.zeros((15, 15))
    turn[:3, :3] = np.eye(3)
    turn[3:6, 3:6] = turn[6:9, 6:9] = pre.rotation.T
    turn[9:12, 12:] = turn[12:, 9:12] = -np.eye(3)
    return turn @ pre.cov @ turn.T


def relative(one, other):
    scale = np.sqrt(np.diagonal(other))
    return np.abs((one - other) / np.outer(scale, scale)).max()


def test_the_step_is_that_of_gtsams_galilean_group(rng):
    data, bias = samples(rng), rng.normal(size=6) * np.repeat([0.02, 0.1], 3)
    pre = preintegrate(*data, gyro_bias=bias[:3], accel_bias=bias[3:], noise=NOISE)
    theirs = integrated(gtsam.PreintegratedCombinedMeasurementsG, NOISE, data, bias)
    assert np.allclose(pre.rotation, theirs.deltaRij().matrix(), atol=1e-14)
    assert np.allclose(pre.position, theirs.deltaPij(), atol=1e-15)
    assert np.allclose(pre.velocity, theirs.deltaVij(), atol=1e-14)
    assert relative(in_gtsams_order(pre), theirs.preintMeasCov()) < 1e-8


def test_the_step_is_that_of_gtsams_default_but_for_its_integration(rng):
    """It takes positions by the rectangle rule, of an error that shrinks with the samples."""
    bias, gaps = np.zeros(6), []
    for m in (10, 100):
        long = np.full(m, 0.1 / m)
        data = long, np.tile([0.6, -0.8, 1.1], (m, 1)), np.tile([1.0, 2.0, 9.0], (m, 1))
        pre = preintegrate(*data, gyro_bias=ZERO, accel_bias=ZERO, noise=STEADY)
        theirs = integrated(gtsam.PreintegratedImuMeasurements, STEADY, data, bias)
        gaps.append(np.abs(pre.velocity - theirs.deltaVij()).max())
        turned = in_gtsams_order(pre)[:9, :9]
    assert gaps[1] < 0.11 * gaps[0]
    assert relative(turned, theirs.preintMeasCov()) < 0.02


def test_a_change_of_the_bias_is_taken_to_first_order(rng):
    data, bias, step = samples(rng), rng.normal(size=6) * 0.02, 1e-5

    def at(change):
        return preintegrate(*data, gyro_bias=(bias + change)[:3], accel_bias=(bias + change)[3:], noise=NOISE)

    pre = at(np.zeros(6))
    for axis, change in enumerate(step * np.eye(6)):
        up, down = at(change), at(-change)
        slope = np.concatenate(
            [so3.log(down.rotation.T @ up.rotation), up.position - down.position, up.velocity - down.velocity]
        )
        assert np.allclose(pre.by_bias[:, axis], slope / (2.0 * step), atol=1e-9)
        rotation, position, velocity = pre.corrected(change)
        assert np.allclose(rotation, up.rotation, atol=1e-10)
        assert np.allclose([position, velocity], [up.position, up.velocity], atol=1e-9)


def signals(time):
    """A hand that shakes: rate and specific force at times ``(n,)``, in the body."""
    phase = np.outer(time, [31.0, 23.0, 17.0]) + np.array([0.1, 0.7, 1.9])
    gyro = np.array([0.9, -0.7, 1.2]) * np.sin(phase)
    accel = np.array([2.0, 3.0, 1.5]) * np.cos(1.3 * phase) + np.array([0.3, -0.2, 9.7])
    return gyro, accel


def brute(length, rate=10_000.0, earth_rate=ZERO, *, gravity=ZERO, velocity=ZERO):
    """Midpoint steps at 10 kHz in the frame of the first pose, which turns with the earth."""
    count = round(length * rate)
    dt = length / count
    gyro, accel = signals((np.arange(count) + 0.5) * dt)
    rotation, position = np.eye(3), np.zeros(3)
    for omega, force in zip(gyro, accel, strict=True):
        middle = rotation @ so3.exp(0.5 * dt * (omega - rotation.T @ earth_rate))
        change = middle @ force + gravity - 2.0 * np.cross(earth_rate, velocity)
        position = position + velocity * dt + 0.5 * change * dt**2
        velocity = velocity + change * dt
        rotation = so3.exp(-earth_rate * dt) @ rotation @ so3.exp(omega * dt)
    return rotation, position, velocity


def sampled(length, rate, *, noise=STEADY):
    stamp = np.linspace(0.0, length, round(length * rate) + 1)
    gyro, accel = signals(stamp)
    means = 0.5 * (gyro[1:] + gyro[:-1]), 0.5 * (accel[1:] + accel[:-1])
    return preintegrate(np.diff(stamp), *means, gyro_bias=ZERO, accel_bias=ZERO, noise=noise)


def test_samples_of_a_shaken_body_against_ten_kilohertz():
    """Straight lines between samples are of second order: four times the rate, a sixteenth of the error."""
    rotation, position, velocity = brute(0.1)
    errors = []
    for rate in (200.0, 800.0):
        pre = sampled(0.1, rate)
        turned = np.linalg.norm(so3.log(rotation.T @ pre.rotation))
        errors.append(
            [turned, np.linalg.norm(pre.position - position), np.linalg.norm(pre.velocity - velocity)]
        )
    # The noise of the samples makes 6e-4 rad, 4e-4 m and 6e-3 m/s of it.
    assert np.all(np.array(errors[0]) < 0.3 * np.array([6e-4, 4e-4, 6e-3]))
    assert np.all(np.array(errors[1]) < np.array(errors[0]) / 12.0)


def test_the_turn_of_the_earth_is_an_option():
    pre, gravity, velocity = sampled(0.1, 2000.0), STEADY.gravity_world, np.array([20.0, -3.0, 1.0])
    large = 100.0 * EARTH
    want = brute(0.1, earth_rate=large, gravity=gravity, velocity=velocity)
    without = pre.predict(np.eye(4), velocity, gravity)
    pose, speed = pre.predict(np.eye(4), velocity, gravity, earth_rate=large)
    for found, expected, before in (
        (pose[:3, :3], want[0], without[0][:3, :3]),
        (pose[:3, 3], want[1], without[0][:3, 3]),
        (speed, want[2], without[1]),
    ):
        assert np.abs(found - expected).max() < 0.02 * np.abs(before - expected).max()


def test_a_step_of_one_sample_and_one_without_cover(rng):
    one = preintegrate(
        np.array([0.1]), np.ones((1, 3)), np.ones((1, 3)), gyro_bias=ZERO, accel_bias=ZERO, noise=NOISE
    )
    assert np.allclose(one.rotation, so3.exp(0.1 * np.ones(3)))
    unknown = np.array([[0.25, 25.0]])
    blind = preintegrate(
        np.array([0.1]),
        np.ones((1, 3)),
        np.ones((1, 3)),
        gyro_bias=ZERO,
        accel_bias=ZERO,
        noise=NOISE,
        unknown=unknown,
    )
    assert np.allclose(np.diagonal(blind.cov - one.cov)[:3], 0.01 * 0.25, rtol=0.02)
    assert np.allclose(np.trace((blind.cov - one.cov)[6:9, 6:9]), 3 * 0.01 * 25.0, rtol=0.02)


def drawn(rng, assumed, *, length, draws, size, rate=100.0):
    """Mean NEES of the first ``size`` of (theta, p, v, walk); samples and biases err as ``NOISE`` says."""
    dt = np.full(round(length * rate), 1.0 / rate)
    gyro, accel = signals(np.cumsum(dt) - 0.5 * dt)

    def step(errors):
        data = dt, gyro + errors[:, :3], accel + errors[:, 3:]
        return preintegrate(*data, gyro_bias=ZERO, accel_bias=ZERO, noise=assumed)

    true, total = step(np.zeros((len(dt), 6))), 0.0
    white = np.repeat([NOISE.gyro_density, NOISE.accel_density], 3) / np.sqrt(dt[:, None])
    walk = np.repeat([NOISE.gyro_walk, NOISE.accel_walk], 3) * np.sqrt(dt[:, None])
    for _ in range(draws):
        steps = walk * rng.normal(size=white.shape)
        pre = step(np.cumsum(steps, axis=0) - steps + white * rng.normal(size=steps.shape))
        turned, moved = so3.log(pre.rotation.T @ true.rotation), true.position - pre.position
        error = np.concatenate([turned, moved, true.velocity - pre.velocity, steps.sum(axis=0)])[:size]
        total += error @ np.linalg.solve(pre.cov[:size, :size], error)
    return total / draws


@pytest.mark.statistical
@pytest.mark.parametrize("length", [0.1, 1.0])
def test_the_covariance_is_that_of_the_errors(rng, length):
    """Chi-square of 15 degrees of freedom over 1000 draws; false alarm 1e-4 a case."""
    found = drawn(rng, NOISE, length=length, draws=1000, size=15)
    assert abs(found - 15.0) < 3.9 * np.sqrt(30.0 / 1000)


@pytest.mark.statistical
def test_a_bias_that_stands_still_within_a_long_step_is_refuted(rng):
    """Guards the test above, and is why the factor in use is the one with the walk within the step."""
    assert drawn(rng, STEADY, length=1.0, draws=300, size=9) > 9.0 + 3.9 * np.sqrt(18.0 / 300)


def test_prediction_is_that_of_gtsam(rng):
    data, bias = samples(rng), np.zeros(6)
    pre = preintegrate(*data, gyro_bias=ZERO, accel_bias=ZERO, noise=NOISE)
    theirs = integrated(gtsam.PreintegratedCombinedMeasurementsG, NOISE, data, bias)
    pose, velocity = se3.exp(rng.normal(size=6)), rng.normal(size=3)
    found, faster = pre.predict(pose, velocity, NOISE.gravity_world)
    want = theirs.predict(gtsam.NavState(gtsam.Pose3(pose), velocity), gtsam.imuBias.ConstantBias())
    assert np.allclose(found, want.pose().matrix(), atol=1e-13)
    assert np.allclose(faster, want.velocity(), atol=1e-13)


def test_what_is_not_known_varies_within_an_interval():
    """One interval without samples is as many short ones of the same density, and of full rank."""

    def cov(intervals):
        dt = np.full(intervals, 0.25 / intervals)
        rest = np.tile([0.0, 0.0, 9.81], (intervals, 1))
        return preintegrate(
            dt,
            np.zeros_like(rest),
            rest,
            gyro_bias=np.zeros(3),
            accel_bias=np.zeros(3),
            noise=ImuNoise(1e-6, 1e-6, 0.0, 0.0),
            unknown=np.full((intervals, 2), [1e-8, 25.0]) * intervals,
        ).cov[:9, :9]

    one = cov(1)
    assert np.allclose(one[3:6, 3:6], 25.0 * 0.25**4 / 3.0 * np.eye(3), rtol=1e-6, atol=1e-8)
    assert np.allclose(one[3:, 3:], cov(200)[3:, 3:], rtol=1e-4, atol=1e-7)
    assert np.linalg.matrix_rank(one, tol=1e-16) == 9
