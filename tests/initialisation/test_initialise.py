"""The first state of raw inertia: static or dynamic as the data are, and refusals in one line."""

from dataclasses import replace

import numpy as np
import pytest

from tests.inertial import IMU, drive
from vislam.core.imu import ImuSeries
from vislam.geometry import so3
from vislam.initialisation import NotFoundError, initialise
from vislam.models.imu import ImuNoise

NOISE = ImuNoise(IMU.gyro_density, IMU.accel_density, IMU.gyro_walk, IMU.accel_walk, IMU.gravity)


def tilt_error(found, dataset):
    """About the world's x and y, the headings joined [rad]."""
    up = dataset.reference.pose[0, 2, :3]
    return so3.log(so3.onto(found.world_R_imu.T @ [0.0, 0.0, 1.0], up))


def changed(dataset, *, accel=1.0, gyro=1.0):
    imu = dataset.sequence.imu
    return replace(dataset.sequence, imu=ImuSeries(imu.stamp, gyro * imu.gyro, accel * imu.accel))


def test_a_body_that_moves_is_aligned_with_its_tracks():
    _, dataset = drive(frames=25)
    found = initialise(dataset.sequence, NOISE)
    assert found.method == "dynamic"
    assert np.linalg.norm(tilt_error(found, dataset)) < 4.0 * np.sqrt(np.trace(found.cov[:2, :2]))


def test_a_body_at_rest_is_taken_for_one():
    _, dataset = drive(frames=25)
    moving, generator = dataset.sequence, np.random.default_rng(3)
    first = np.arange(moving.offset[1])
    rows = np.tile(first, len(moving))
    bias, up = np.array([0.01, -0.02, 0.005]), np.array([0.0, 0.6, 0.8])
    stamp = moving.imu.stamp
    gyro = bias + 0.005 * generator.normal(size=(len(stamp), 3))
    accel = NOISE.gravity * up + 0.05 * generator.normal(size=(len(stamp), 3))
    still = replace(
        moving,
        offset=len(first) * np.arange(len(moving) + 1),
        track=moving.track[rows],
        pixels=moving.pixels[rows] + 0.2 * generator.normal(size=(len(rows), 4)),
        row=np.arange(len(rows)),
        imu=ImuSeries(stamp, gyro, accel),
    )
    found = initialise(still, NOISE)
    assert found.method == "static"
    assert not found.velocity.any()
    assert np.abs(found.gyro_bias - bias).max() < 4.0 * np.sqrt(found.cov.diagonal()[5:8].max())
    assert np.linalg.norm(found.world_R_imu.T[:, 2] - up) < 0.005


def test_a_force_in_units_of_gravity_is_named():
    _, dataset = drive(frames=25)
    with pytest.raises(NotFoundError, match=r"it looks like g, divide by 0\.102"):
        initialise(changed(dataset, accel=1.0 / 9.80665), NOISE)


def test_rates_in_degrees_are_named():
    _, dataset = drive(frames=25)
    with pytest.raises(NotFoundError, match="it looks like deg/s"):
        initialise(changed(dataset, gyro=180.0 / np.pi), NOISE)


def test_samples_that_end_early_are_named():
    _, dataset = drive(frames=25)
    imu = dataset.sequence.imu
    early = imu.stamp < dataset.sequence.stamp[3]
    short = replace(dataset.sequence, imu=ImuSeries(imu.stamp[early], imu.gyro[early], imu.accel[early]))
    with pytest.raises(NotFoundError, match="inertial samples must cover 50%"):
        initialise(short, NOISE)
