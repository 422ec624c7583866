"""A simulated recording with its truth: one seed, one sequence, on any machine."""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.imu import ImuSeries
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.geometry import se3, so3
from vislam.geometry.axes import axes_rotation
from vislam.models import CAMERA_AXES, CameraErrors, StereoRig, odometry
from vislam.models.imu import ImuPrior
from vislam.models.shared_errors import (
    CAMERA_ROTATION,
    CLOCK,
    DISPARITY_OFFSET,
    FOCAL_SCALE,
    PRINCIPAL_POINT,
    VELOCITY_DIRECTION,
)
from vislam.simulation.imu import ImuTruth, first_guess, in_world_of, simulate_imu
from vislam.simulation.path import BodyPath, DrivePath
from vislam.simulation.room import RoomPath
from vislam.simulation.settings import SimulationConfig
from vislam.simulation.tracks import simulate_tracks

_SHARED = 1
"""Of the generator of the shared errors: what they are draws nothing from that of the rest."""
_IMU_STREAM = 2
"""Of a seed, the generator of raw inertia."""


@dataclass(frozen=True)
class Truth:
    """Exact truth of a simulated sequence.

    Attributes
    ----------
    world_T_imu : (T, 4, 4)
    bias : (6,) or (T, 6)
        Bias of the inertial samples (omega, v) [rad/s, m/s]; at each frame if it walks.
    points_world : (n, 3)
        The point that each observation of the unrepaired sequence saw [m]; a duplicated observation
        counts for the point that is followed from there on.
    shared : dict of str to (m,)
        What the sequence has of the errors that all tracks share (:mod:`vislam.models.shared_errors`).
    imu : ImuTruth or None
        States that raw inertia tells of; None where there is none.
    """

    world_T_imu: Array
    bias: Array
    points_world: Array
    shared: dict[str, Array]
    imu: ImuTruth | None = None


def simulate(
    config: SimulationConfig, *, seed: int, name: str, path: BodyPath | None = None
) -> tuple[Sequence, Truth]:
    """Simulate a sequence.

    Parameters
    ----------
    config : SimulationConfig
    seed : int
        Equal seeds give equal sequences.
    name : str
        Name of the sequence.
    path : BodyPath, optional
        What the body drives along; by default the shape that the config names.

    Returns
    -------
    Sequence
        As a recording would be read, faults included: nothing in it is repaired.
    Truth

    Raises
    ------
    ValueError
        If the config names a recorded path and none is given.
    """
    generator = np.random.default_rng(seed)
    shared = _shared(config, np.random.default_rng([seed, _SHARED]))
    config = replace(config, clock_offset=float(shared[CLOCK][0]))
    if path is None:
        if config.recorded is not None:
            raise ValueError("path: recorded needs the poses: see vislam.comparison.simulated")
        path = RoomPath(config, generator) if config.path == "room" else DrivePath(config, generator)
    stamp: Array = config.period * np.arange(config.frames, dtype=np.float64)
    world_T_imu = path.pose(stamp)
    origin = se3.inverse(world_T_imu[0])
    upright = se3.from_rotation_translation(world_T_imu[0, :3, :3], np.zeros(3))
    rig = stereo_rig(config)

    by_step = config.inertial_noise == "step"
    clean = _step_twist(config, stamp, world_T_imu) if by_step else _sampled_twist(config, stamp, path)
    sigma = np.repeat([config.gyro_sigma, config.velocity_sigma], 3)
    noise = sigma * generator.standard_normal(clean.shape)
    errors = CameraErrors.of(shared)
    actual = errors.rig(rig)
    tracks = simulate_tracks(
        replace(config, disparity_offset_px=errors.disparity_offset),
        actual,
        world_T_imu @ actual.imu_T_cam,
        generator,
    )
    # Drawn last, so that a walk changes nothing but the bias.
    bias = _bias(config, generator)
    twist = clean + (bias if bias.ndim == 1 else bias[: len(clean)]) + noise
    twist = twist + twist[:, 3:4] * (odometry.ACROSS @ shared[VELOCITY_DIRECTION])
    inertial_stamp = stamp
    if by_step:
        inertial_stamp, twist = piecewise_constant(stamp, twist)
        inertial_stamp = inertial_stamp + config.clock_offset

    start = upright @ origin
    inertia = None if config.imu is None else _inertia(config, path, stamp, start, seed=seed)
    sequence = Sequence(
        name=name,
        stamp=stamp,
        inertial_stamp=inertial_stamp,
        twist=twist,
        vertical_velocity=np.full(len(twist), np.nan),
        rig=_as_stored(config, rig),
        offset=tracks.offset,
        track=tracks.track,
        pixels=tracks.pixels,
        row=np.arange(len(tracks.track)),
        synthetic=True,
        digest=hashlib.sha256(tracks.pixels.tobytes() + twist.tobytes()).hexdigest(),
        counts={
            "frames": config.frames,
            "feature_columns": int(tracks.track.max(initial=-1)) + 1,
            "observations_read": len(tracks.track),
        },
    )
    points = se3.transform(start, tracks.points_world)
    if inertia is None:
        return sequence, Truth(start @ world_T_imu, bias, points, shared)
    series, guess, states = inertia
    counts = {**sequence.counts, **series.counts}
    with_imu = replace(sequence, imu=series, start=guess, counts=counts)
    return with_imu, Truth(start @ world_T_imu, bias, points, shared, states)


def _inertia(
    config: SimulationConfig, path: BodyPath, stamp: Array, start: Array, *, seed: int
) -> tuple[ImuSeries, ImuPrior, ImuTruth]:
    """Raw inertia, what is known of the first state, and the true states, in the world of ``start (4, 4)``.

    Of a generator of its own: a drive with raw inertia has the tracks of the one without.
    """
    assert config.imu is not None
    generator = np.random.default_rng([seed, _IMU_STREAM])
    series, truth = simulate_imu(
        config.imu, path, stamp, clock_offset=config.clock_offset, generator=generator
    )
    truth = in_world_of(start, truth)
    guess = first_guess(config.imu, start @ path.pose(stamp[:1])[0], truth, generator)
    return series, guess, truth


def _shared(config: SimulationConfig, generator: np.random.Generator) -> dict[str, Array]:
    """Errors that all tracks share, with what the seed adds to them, by name."""
    stated = {
        CAMERA_ROTATION: (config.camera_rotation, config.camera_rotation_sigma),
        DISPARITY_OFFSET: ((config.disparity_offset_px,), config.disparity_offset_sigma_px),
        PRINCIPAL_POINT: (config.principal_point_px, config.principal_point_sigma_px),
        FOCAL_SCALE: ((config.focal_scale,), config.focal_scale_sigma),
        CLOCK: ((config.clock_offset,), config.clock_sigma),
        VELOCITY_DIRECTION: (config.velocity_direction, config.velocity_direction_sigma),
    }
    return {
        name: np.array(value) + sigma * generator.standard_normal(len(value))
        for name, (value, sigma) in stated.items()
    }


def _bias(config: SimulationConfig, generator: np.random.Generator) -> Array:
    """Bias ``(6,)`` or, if it walks, at each frame ``(T, 6)``, kept through the step that follows."""
    constant = np.array([*config.gyro_bias, *config.velocity_bias])
    sigma = np.array([*config.gyro_bias_sigma, *config.velocity_bias_sigma])
    if sigma.any():
        constant = constant + sigma * generator.standard_normal(6)
    walk = np.repeat([config.gyro_bias_walk, config.velocity_bias_walk], 3)
    if not walk.any():
        return constant
    steps = np.sqrt(config.period) * walk * generator.standard_normal((config.frames - 1, 6))
    return np.asarray(constant + np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)]))


def _sampled_twist(config: SimulationConfig, stamp: Array, path: BodyPath) -> Array:
    """Twist ``(T, 6)`` of the samples without bias and noise."""
    sampled_at = stamp - config.clock_offset
    twist = path.twist(sampled_at)
    if config.navigation_frame_velocity:
        twist[:, 5] = path.vertical_velocity(sampled_at)
    if config.navigation_frame_rates:
        twist[:, :3] = _about_level_axes(twist[:, :3], path.pose(sampled_at)[:, :3, :3])
    return twist


def _step_twist(config: SimulationConfig, stamp: Array, world_T_imu: Array) -> Array:
    """Mean twist ``(T - 1, 6)`` of the steps without bias and noise."""
    period = np.diff(stamp)[:, None]
    twist = se3.local(world_T_imu[:-1], world_T_imu[1:]) / period
    if config.navigation_frame_velocity:
        twist[:, 5:] = np.diff(world_T_imu[:, 2:3, 3], axis=0) / period
    if config.navigation_frame_rates:
        midway = world_T_imu[:-1, :3, :3] @ so3.exp(0.5 * period * twist[:, :3])
        twist[:, :3] = _about_level_axes(twist[:, :3], midway)
    return twist


def _about_level_axes(rates: Array, world_R_body: Array) -> Array:
    """Rates ``(n, 3)`` about forward, left and up, of those about the body's axes."""
    forward = world_R_body[:, :, 0] * np.array([1.0, 1.0, 0.0])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    world_R_level = np.stack([forward, np.cross(up, forward), np.broadcast_to(up, forward.shape)], axis=2)
    return np.asarray(np.einsum("nij,nik,nk->nj", world_R_level, world_R_body, rates))


def _as_stored(config: SimulationConfig, rig: StereoRig) -> StereoRig:
    """Rig as a faulty recording states it: the repairs of the same names bring the true one back."""
    turn = se3.from_rotation_translation(axes_rotation(config.extrinsic_axes), np.zeros(3))
    wanted = se3.inverse(turn) @ rig.imu_T_cam
    rotation, translation = wanted[:3, :3], wanted[:3, 3]
    if config.extrinsic_rotation == "inverse":
        rotation = rotation.T
    if config.extrinsic_translation == "inverse":
        translation = -rotation @ translation
    stored = se3.from_rotation_translation(rotation, translation)
    return replace(rig, imu_T_cam=stored, baseline=config.stated_baseline or rig.baseline)


def stereo_rig(config: SimulationConfig) -> StereoRig:
    """Stereo rig of a simulation."""
    rig = config.rig
    tilt = so3.exp(np.array([0.0, np.deg2rad(rig.pitch_deg), 0.0]))
    mounting = se3.from_rotation_translation(tilt @ CAMERA_AXES, np.array(rig.position_imu))
    return StereoRig(rig.fx, rig.fy, rig.cx, rig.cy, rig.baseline, mounting)
