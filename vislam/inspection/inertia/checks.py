"""The checks of raw inertia in their order: each works on the samples as mended by what was found before."""

from dataclasses import asdict, replace

import numpy as np

from vislam.base.types import Array
from vislam.comparison.config import Config
from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral
from vislam.core.sequence import Sequence
from vislam.initialisation import InitialisationSettings
from vislam.inspection.finding import Finding
from vislam.inspection.inertia import axes, levels, noise, samples, start, turns, units
from vislam.inspection.inertia.camera import CameraRun, camera_runs
from vislam.inspection.inertia.forces import Forces, fall
from vislam.inspection.motion import LAGS_S, judged_clock
from vislam.models.imu import ImuNoise

_FEWEST_STEPS = 20
_ON_AXES = ("imu gravity", "imu biases", "imu noise", "imu first state")
"""Checks that rest on right axes."""
_SEEN = ("imu clock", "imu axes", "imu gravity", "imu biases")
_NOTHING = 1e-6
"""Largest velocity that is none [m/s]."""
_CLOCK = {"sure": 3.0, "unclear": 0.0075}
"""Standard deviations that make a fault of the clock, and the one with which 15 ms are not excluded [s]."""
_EXPLAINED, _EDGE = 0.5, 0.95
"""Share of the variance that a clock explains, and of the lags that are tried within which it lies."""


def takes_raw_inertia(sequence: Sequence, config: Config) -> bool:
    """Whether raw inertia is what predicts the motion: it is configured, or has no velocity beside it."""
    if sequence.imu is None:
        return False
    return config.motion == "imu" or without_velocity(sequence)


def without_velocity(sequence: Sequence) -> bool:
    """Whether the recorded velocity is 0 throughout: none was recorded."""
    return float(np.abs(sequence.twist[:, 3:]).max(initial=0.0)) < _NOTHING


def check_inertia(sequence: Sequence, config: Config) -> list[tuple[Finding, dict[str, Array]]]:
    """Check accelerometer and gyro by themselves and against the camera.

    Parameters
    ----------
    sequence : Sequence
        With ``imu``; duplicated tracks cut, disparities above zero, mounted and timed as configured.
    config : Config

    Returns
    -------
    list of (Finding, dict)
        Each with the series of its figure.
    """
    series = sequence.imu
    assert series is not None
    alone = [
        samples.check_samples(series, covered=_covered(sequence, series)),
        samples.check_saturation(series),
    ]
    against, drawn = _against_tracks(sequence, series, config)
    return [(one, drawn if one.check == "imu clock" else {}) for one in (*alone, *against)]


def _against_tracks(
    sequence: Sequence, series: ImuSeries, config: Config
) -> tuple[list[Finding], dict[str, Array]]:
    """Check what takes the camera's own motion to see, as far as that is seen."""
    runs = camera_runs(sequence)
    seen = turns.Turns.of(series, sequence, runs, clock_offset=sequence.clock_offset)
    if len(seen) < _FEWEST_STEPS:
        text = f"only {len(seen)} steps with samples all around them show the camera's motion"
        unit, _, _ = units.check_units(series, None, config.data.repair.imu_units)
        unknown = {"data.repair.clock": text, "data.repair.axes": text, "data.repair.extrinsic": text}
        told = [Finding(check, "unclear", text, unknown=unknown) for check in _SEEN]
        return [unit, *told, noise.check_noise(sequence, _noise(config))], {}
    return _against_camera(sequence, series, runs, seen, config)


def _noise(config: Config) -> ImuNoise:
    return ImuNoise(**asdict(config.noise.imu))


def _covered(sequence: Sequence, series: ImuSeries) -> float:
    """Share of the recording that lies within a series."""
    begin, end = sequence.stamp[[0, -1]] + sequence.clock_offset
    inside = min(end, series.stamp[-1]) - max(begin, series.stamp[0])
    return float(np.clip(inside / (end - begin), 0.0, 1.0))


def _against_camera(
    sequence: Sequence, series: ImuSeries, runs: list[CameraRun], seen: turns.Turns, config: Config
) -> tuple[list[Finding], dict[str, Array]]:
    """Units, clock, axes, gravity, biases and noise."""
    lag, sigma, cost = turns.lag_of(seen, around=sequence.clock_offset)
    turning = turns.turning(seen.measured(lag), seen.seen)
    unit, by_rate, by_force = units.check_units(series, turning, config.data.repair.imu_units)
    # As configured is what is right, where the turns do not tell it.
    inside = abs(lag - sequence.clock_offset) < _EDGE * LAGS_S[-1]
    explained = turning.correlation > _EXPLAINED and inside
    clock = judged_clock("imu clock", lag, sigma, now=sequence.clock_offset, explained=explained, **_CLOCK)
    offset = lag if clock.verdict == "fault" else sequence.clock_offset
    scaled = replace(series, gyro=series.gyro / by_rate, accel=series.accel / by_force)
    seen = replace(seen, gyro=Integral(scaled.stamp, scaled.gyro))
    lever = sequence.rig.cam_T_imu[:3, 3]
    forces = Forces.of(scaled, runs, lever=lever, clock_offset=offset)
    settings = InitialisationSettings()
    prior = (settings.gyro_bias_sigma, settings.accel_bias_sigma)
    mounted, reading = axes.check_axes(seen, forces, sequence.rig, offset=offset, bias_sigma=prior[1])
    drawn = {"clock_lag": LAGS_S + sequence.clock_offset, "clock_cost": cost}
    if mounted.verdict == "fault" and not mounted.proposal:
        reason = "not looked at before the axes are mended"
        return [unit, clock, mounted, *(Finding(check, "unclear", reason) for check in _ON_AXES)], drawn
    cam_R_imu = reading.matrix(sequence.rig)
    falling = fall(forces, cam_R_imu, bias_sigma=prior[1])
    gravity = levels.check_gravity(falling, configured=config.noise.imu.gravity)
    biases = levels.check_biases(seen, falling, cam_R_imu, offset=offset, sigma=prior)
    mended = replace(
        sequence,
        imu=scaled,
        twist=_twist(sequence, scaled),
        clock_offset=offset,
        rig=replace(sequence.rig, imu_T_cam=_turned(sequence.rig.imu_T_cam, cam_R_imu)),
    )
    level = float(gravity.proposal.get("noise.imu.gravity", config.noise.imu.gravity))
    white = noise.check_noise(mended, replace(_noise(config), gravity=level))
    first = start.check_start(
        mended, replace(_noise(config), gravity=level), alone=without_velocity(sequence)
    )
    return [unit, clock, mounted, gravity, biases, white, first], drawn


def _twist(sequence: Sequence, scaled: ImuSeries) -> Array:
    """Twist ``(S, 6)``, which rigid fits begin with, its rates scaled where they are those of the gyro."""
    assert sequence.imu is not None
    if not np.array_equal(sequence.twist[:, :3], sequence.imu.gyro):
        return sequence.twist
    return np.hstack([scaled.gyro, sequence.twist[:, 3:]])


def _turned(imu_T_cam: Array, cam_R_imu: Array) -> Array:
    """Extrinsic with another rotation, the sensor where it was in the camera."""
    out = imu_T_cam.copy()
    out[:3, :3] = cam_R_imu.T
    out[:3, 3] = cam_R_imu.T @ imu_T_cam[:3, :3].T @ imu_T_cam[:3, 3]
    return out
