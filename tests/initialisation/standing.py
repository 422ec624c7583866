"""A body that stands first, and then hovers through a room; what a first state is off by."""

from functools import cache

import numpy as np

from tests.inertial import IMU
from vislam.geometry import so3
from vislam.models.imu import ImuNoise
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.path import central_twist
from vislam.simulation.room import RoomPath

NOISE = ImuNoise(IMU.gyro_density, IMU.accel_density, IMU.gyro_walk, IMU.accel_walk, IMU.gravity)
ROOM = SimulationConfig(
    frames=26,
    period=0.1,
    path="room",
    speed=1.5,
    tracks_in_view=40,
    pixel_sigma_px=0.3,
    depth_min=1.5,
    depth_max=8.0,
    imu=IMU,
)
CAR = SimulationConfig(frames=26, period=0.1, tracks_in_view=40, pixel_sigma_px=0.3, imu=IMU)


class Standing:
    """A room's path that begins after some time of rest [s], with a continuous velocity and acceleration."""

    def __init__(self, config, generator, *, rest):
        self._path, self._rest = RoomPath(config, generator), rest

    def pose(self, time):
        since = np.maximum(np.asarray(time) - self._rest, 0.0)
        return self._path.pose(since**3 / (1.0 + since**2))

    def twist(self, time):
        return central_twist(self.pose, time)

    def vertical_velocity(self, time):
        half = 1e-3
        return (self.pose(time + half)[:, 2, 3] - self.pose(time - half)[:, 2, 3]) / (2.0 * half)


@cache
def standing(seed, *, rest, config=ROOM):
    """Sequence and truth of a body that is stationary for so long [s]."""
    path = Standing(config, np.random.default_rng(seed), rest=rest)
    return simulate(config, seed=seed, name="standing", path=path)


@cache
def moving(seed, config=ROOM):
    """Sequence and truth of a body that moves from the first frame on."""
    return simulate(config, seed=seed, name="moving")


def error_of(found, truth):
    """Error ``(11,)`` of a first state in the order of its covariance, after the headings are joined.

    The true attitude is a turn about the vertical times ``exp((tilt, 0)) found.world_R_imu``.
    """
    up = truth.world_T_imu[0, 2, :3]
    tilt = found.world_R_imu @ so3.log(so3.onto(up, found.world_R_imu.T @ [0.0, 0.0, 1.0]))
    turn = so3.exp(tilt) @ found.world_R_imu @ truth.world_T_imu[0, :3, :3].T
    velocity = turn @ truth.imu.velocity[0] - found.velocity
    gyro, accel = (getattr(truth.imu, name)[0] - getattr(found, name) for name in ("gyro_bias", "accel_bias"))
    return np.concatenate([tilt[:2], velocity, gyro, accel])
