"""Simulated drives with raw inertia, and estimators on them."""

from dataclasses import replace
from functools import cache

import numpy as np

from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, ImuNoiseConfig, NoiseConfig
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find
from vislam.estimators import loop
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig
from vislam.simulation.settings import ImuSimulation

IMU = ImuSimulation(rate=200.0, gyro_density=5e-4, accel_density=5e-3, gyro_walk=1e-4, accel_walk=1e-3)
PHONE = ImuSimulation(
    rate=100.0,
    gyro_density=1e-3,
    accel_density=1e-2,
    gyro_walk=1e-4,
    accel_walk=1e-2,
    gyro_bias_sigma=0.03,
    accel_bias_sigma=0.3,
)
"""The sensor of a phone."""


@cache
def drive(*, seed=1, frames=25, pixel=0.3, imu=IMU, tracks=25.0, period=0.1, **settings):
    """Config and dataset; the noise is as simulated."""
    simulation = SimulationConfig(
        frames=frames, tracks_in_view=tracks, pixel_sigma_px=pixel, imu=imu, period=period, **settings
    )
    names = ("gyro_density", "accel_density", "gyro_walk", "accel_walk", "gravity")
    config = Config(
        name="inertial",
        data=DataConfig(simulation=simulation, repair=RepairConfig(consensus=None)),
        noise=NoiseConfig(
            pixel_sigma_px=pixel, imu=ImuNoiseConfig(**{name: getattr(imu, name) for name in names})
        ),
        motion="imu",
        common_set_from=(),
    )
    return config, open_dataset(config.data, seed=seed)


def ran(name, config, dataset, **options):
    """Run of an estimator that is found by name."""
    solver = find(name)(make_problem(config, dataset), options)
    return solver, loop.run(solver, dataset.sequence, pixel_sigma(config, dataset), name=name)


def pose_error(run, dataset):
    """Error ``(T, 6)`` of the poses, on their right, in the world that both share."""
    return se3.local(run.final.world_T_imu, dataset.reference.pose)


def errors(run, dataset):
    """Errors of position [m] and attitude [rad], ``(T,)`` each, in the world that both share."""
    error = pose_error(run, dataset)
    return np.linalg.norm(error[:, 3:], axis=1), np.linalg.norm(error[:, :3], axis=1)


def with_noise(config, **changes):
    return replace(config, noise=replace(config.noise, **changes))
