"""The first state of raw inertia: at rest if the body is, else from how inertia and tracks move."""

from dataclasses import replace

import numpy as np

from vislam.core.sequence import Sequence
from vislam.initialisation.alignment import align
from vislam.initialisation.found import ACCEL, TILT, Found, NotFoundError
from vislam.initialisation.plausible import check_force, check_gravity, check_turns
from vislam.initialisation.refinement import refine
from vislam.initialisation.settings import InitialisationSettings
from vislam.initialisation.still import Still, at_rest, standstill
from vislam.initialisation.window import Window, window_of
from vislam.models.imu import ImuNoise

_FEWEST_STEPS = 4
_LARGE = 3.0
"""Standard deviations are said to be too small if residuals are so many times larger."""


def initialise(sequence: Sequence, noise: ImuNoise, settings: InitialisationSettings | None = None) -> Found:
    """State at the first frame of a sequence with raw inertia, chosen by the data.

    Where the tracks stay where they are and the samples are quiet from the first frame on, the body is at
    rest; else its motion by the tracks and by inertia are aligned.

    Parameters
    ----------
    sequence : Sequence
        With ``imu``.
    noise : ImuNoise
    settings : InitialisationSettings, optional

    Raises
    ------
    NotFoundError
        In one line, what is missing or cannot be right.
    """
    settings = InitialisationSettings() if settings is None else settings
    if sequence.imu is None:
        raise NotFoundError("there are no samples of accelerometer and gyro")
    whole = window_of(sequence, seconds=settings.windows[-1], most=settings.most_frames, step=settings.step)
    if whole.covered < settings.covered:
        raise NotFoundError(
            f"inertial samples must cover {settings.covered:.0%} of the first {whole.length:.1f} s, got "
            f"{max(whole.covered, 0.0):.0%}: look at their clock, or begin the recording later"
        )
    check_force(whole, noise)
    still = standstill(sequence, whole, noise, settings)
    if still.length >= settings.still_for:
        return _static(whole, still, noise, settings)
    return _dynamic(whole, still, noise, settings)


def _static(whole: Window, still: Still, noise: ImuNoise, settings: InitialisationSettings) -> Found:
    steps = int(np.searchsorted(whole.stamp, whole.stamp[0] + still.length + 1e-9, side="right")) - 1
    found = at_rest(whole.first(steps), still, noise, settings)
    return _told(found, f"at rest for the first {still.length:.1f} s")


def _dynamic(whole: Window, still: Still, noise: ImuNoise, settings: InitialisationSettings) -> Found:
    """From the shortest window that tells enough, else from the longest."""
    rest = f"at rest for {still.length:.1f} s of the {settings.still_for:g} s that a static one takes"
    told = np.count_nonzero(whole.told)
    if len(whole) < _FEWEST_STEPS or told < settings.covered * len(whole):
        raise NotFoundError(
            f"{rest}, and tracks must tell {settings.covered:.0%} of the steps, {_FEWEST_STEPS} at least, "
            f"got {told} of {len(whole)}: more tracks are needed at the beginning"
        )
    check_turns(whole)
    found, window, tilt = None, whole, np.inf
    for seconds in settings.windows:
        steps = int(np.searchsorted(whole.stamp, whole.stamp[0] + seconds + 1e-9, side="right")) - 1
        window = whole.first(steps)
        if steps < _FEWEST_STEPS or np.count_nonzero(window.told) < settings.covered * steps:
            continue
        aligned = align(window, noise)
        check_gravity(aligned, noise)
        found = refine(window, aligned, noise, settings)
        tilt = _tilt_by_data(found)
        if tilt <= settings.enough or steps == len(whole):
            break
    if found is None or not tilt <= settings.needed:
        raise NotFoundError(
            f"{rest}, and {window.length:.1f} s of motion tell the vertical to {np.degrees(tilt):.2g} deg "
            f"only, {np.degrees(settings.needed):.2g} needed: a longer recording, more tracks, or a "
            "standstill at its beginning would"
        )
    return _told(found, f"motion by tracks and inertia aligned over {window.length:.1f} s ({rest})")


def _tilt_sigma(found: Found) -> float:
    """Standard deviation of the tilt [rad]."""
    return float(np.sqrt(np.linalg.eigvalsh(found.cov[TILT, TILT])[-1]))


def _tilt_by_data(found: Found) -> float:
    """The same with the accelerometer's bias given, from which a car does not tell it."""
    total = found.information + found.prior
    given = np.linalg.inv(total[: ACCEL.start, : ACCEL.start])
    return float(np.sqrt(np.linalg.eigvalsh(given[TILT, TILT])[-1]))


def _told(found: Found, how: str) -> Found:
    """The same with its account."""
    sigma = np.sqrt(np.diagonal(found.cov))
    tilt = np.degrees(_tilt_sigma(found))
    account = (
        f"{found.method}: {how}; tilt to {tilt:.2g} deg, speed {np.linalg.norm(found.velocity):.2f} "
        f"+- {sigma[2:5].max():.2g} m/s, gyro bias {_triple(1e3 * found.gyro_bias)} "
        f"+- {1e3 * sigma[5:8].max():.2g} mrad/s, accelerometer bias {_triple(found.accel_bias)} "
        f"+- {sigma[8:].max():.2g} m/s^2"
    )
    if found.variance_factor > _LARGE**2:
        account += (
            f"; inertia and tracks differ by {np.sqrt(found.variance_factor):.1f} times what their noises "
            "allow, noise.imu is too small or a calibration is off"
        )
    return replace(found, account=account)


def _triple(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2g}" for value in values) + ")"
