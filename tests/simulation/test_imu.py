"""Raw inertia of a simulated drive: what its samples integrate to, its noise, and the first guess."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.geometry import se3, so3
from vislam.models.imu import ImuNoise
from vislam.models.preintegration import preintegrate
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.settings import ImuSimulation

CLEAN = ImuSimulation(
    gyro_density=0.0,
    accel_density=0.0,
    gyro_walk=0.0,
    accel_walk=0.0,
    gyro_bias_sigma=1e-12,
    accel_bias_sigma=1e-12,
)


def drive(imu, path="town", seed=4, frames=30, **settings):
    config = SimulationConfig(frames=frames, path=path, tracks_in_view=5, imu=imu, **settings)
    return simulate(config, seed=seed, name="drive")


@pytest.mark.parametrize("path", ["town", "room"])
def test_clean_samples_lead_from_frame_to_frame(path):
    sequence, truth = drive(replace(CLEAN, rate=500.0), path, speed=2.0 if path == "room" else 12.0)
    noise = ImuNoise(1e-4, 1e-3, 0.0, 0.0, gravity=9.81)
    steps = list(sequence.imu.steps(sequence.stamp))
    for k in range(1, len(sequence)):
        pre = preintegrate(
            steps[k].dt,
            steps[k].mean_gyro,
            steps[k].mean_accel,
            gyro_bias=np.zeros(3),
            accel_bias=np.zeros(3),
            noise=noise,
        )
        pose, velocity = pre.predict(truth.world_T_imu[k - 1], truth.imu.velocity[k - 1], noise.gravity_world)
        assert np.abs(se3.local(truth.world_T_imu[k], pose)).max() < 2e-5
        assert np.abs(velocity - truth.imu.velocity[k]).max() < 2e-4


def test_noise_and_bias_are_as_stated():
    stated = ImuSimulation(
        rate=1000.0, gyro_density=1e-3, accel_density=1e-2, gyro_walk=1e-3, accel_walk=1e-2
    )
    noisy, truth = drive(stated, frames=100)
    clean, _ = drive(replace(CLEAN, rate=1000.0), frames=100)
    error = np.hstack([noisy.imu.gyro - clean.imu.gyro, noisy.imu.accel - clean.imu.accel])
    white = np.diff(error, axis=0).std(axis=0) / np.sqrt(2.0) / np.sqrt(1000.0)
    assert np.allclose(white, np.repeat([1e-3, 1e-2], 3), rtol=0.05)
    bias = np.hstack([truth.imu.gyro_bias, truth.imu.accel_bias])
    walk = np.diff(bias, axis=0).std(axis=0) / np.sqrt(0.1046)
    assert np.allclose(walk, np.repeat([1e-3, 1e-2], 3), rtol=0.35)
    at = np.searchsorted(noisy.imu.stamp, noisy.stamp)
    smooth = np.array([error[max(0, i - 25) : i + 25].mean(axis=0) for i in at])
    assert np.abs(smooth - bias)[5:-5].max() < 6.0 * 1e-2 * np.sqrt(1000.0 / 50.0)


def test_raw_inertia_changes_no_track():
    with_imu, _ = drive(ImuSimulation())
    without, truth = drive(None)
    assert np.array_equal(with_imu.pixels, without.pixels)
    assert np.array_equal(with_imu.twist, without.twist)
    assert truth.imu is None
    assert without.imu is None
    assert without.start is None
    assert with_imu.counts["imu_samples"] == len(with_imu.imu)


@pytest.mark.statistical
def test_the_first_guess_is_off_as_its_covariance_says():
    errors, tilts = [], []
    for seed in range(150):
        sequence, truth = drive(ImuSimulation(rate=50.0), seed=seed, frames=2)
        guess = sequence.start
        error = np.concatenate(
            [
                se3.local(guess.world_T_imu, truth.world_T_imu[0]),
                truth.imu.velocity[0] - guess.velocity,
                truth.imu.gyro_bias[0],
                truth.imu.accel_bias[0],
            ]
        )
        # Heading and position are chosen, not estimated.
        known = np.array([0, 1, *range(6, 15)])
        errors.append(error[known] / np.sqrt(np.diagonal(guess.cov)[known]))
        up = guess.world_T_imu[:3, :3].T @ truth.world_T_imu[0, :3, :3]
        tilts.append(np.linalg.norm(so3.log(up)))
    # Of 150 draws, and roll and pitch near the world's axes.
    assert np.all(np.abs(np.mean(np.square(errors), axis=0) - 1.0) < 4.0 * np.sqrt(2.0 / 150))
    assert np.mean(np.square(tilts)) == pytest.approx(2e-4, rel=0.4)


def test_late_stamps_and_vibration():
    plain, _ = drive(replace(CLEAN, rate=200.0))
    late, _ = drive(replace(CLEAN, rate=200.0), clock_offset=0.05)
    assert np.allclose(late.imu.stamp - plain.imu.stamp, 0.05)
    assert np.array_equal(late.imu.gyro, plain.imu.gyro)
    shaken, _ = drive(replace(CLEAN, vibration_accel=0.5, vibration_gyro=0.02))
    assert np.allclose((shaken.imu.accel - plain.imu.accel).std(axis=0), 0.5, rtol=0.15)
    assert np.allclose((shaken.imu.gyro - plain.imu.gyro).std(axis=0), 0.02, rtol=0.15)
