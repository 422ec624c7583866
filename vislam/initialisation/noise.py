"""How noisy inertia is against the tracks: what data sheets do not say.

A data sheet states the white noise of a sensor at rest. A body that is shaken, stamps that are off and
samples that are filtered add to it: on real recordings preintegration is off by several times what the sheet
has. The tracks tell by how much: their own covariance comes from their residuals, so that what is left over
where inertia and tracks are fused is inertia's.
"""

from dataclasses import replace

from vislam.core.sequence import Sequence
from vislam.initialisation.alignment import align
from vislam.initialisation.refinement import refine
from vislam.initialisation.settings import InitialisationSettings
from vislam.initialisation.window import Window, window_of
from vislam.models.imu import ImuNoise

_STEP, _MOST = 2.0**0.5, 100.0


def noise_factor(
    sequence: Sequence, noise: ImuNoise, settings: InitialisationSettings | None = None
) -> float:
    """By what the densities of the noise are to be multiplied so that inertia and tracks agree.

    The smallest factor, in steps of sqrt(2), at which the sum of squares of the residuals over the longest
    window at the beginning is no more than its redundancy; 1 if that holds for the noise as it is.

    Parameters
    ----------
    sequence : Sequence
        With ``imu``; one that :func:`vislam.initialisation.initialise` takes.
    noise : ImuNoise
        As stated.
    settings : InitialisationSettings, optional
    """
    settings = InitialisationSettings() if settings is None else settings
    window = window_of(sequence, seconds=settings.windows[-1], most=settings.most_frames, step=settings.step)
    return factor_over(window, noise, settings)


def factor_over(window: Window, noise: ImuNoise, settings: InitialisationSettings) -> float:
    """Return the same over a window, which has four steps or more."""
    aligned = align(window, noise)
    factor = 1.0
    while factor < _MOST and refine(window, aligned, scaled(noise, factor), settings).variance_factor > 1.0:
        factor *= _STEP
    return factor


def scaled(noise: ImuNoise, factor: float) -> ImuNoise:
    """The noise with its white densities multiplied by a factor; the walks of the biases stay."""
    return replace(
        noise, gyro_density=factor * noise.gyro_density, accel_density=factor * noise.accel_density
    )
