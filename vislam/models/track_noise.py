"""Errors of a stereo track's pixels: white noise, tracker drift and stereo-matching bias.

Measured on recorded sequences against tracks triangulated from reference poses, the three differ in kind:

* white noise, new in every frame, the same for uL, vL, uR and vR;
* drift: the tracker slowly goes over to another point, so column and row walk randomly along the track;
* match: the right patch follows another point of the same surface than the left one. That shifts the first
  disparity by a pixel or so, and from then on the shift scales with the disparity:
  ``uL - uR = (1 + e) f b / z`` with one e a track.

A filter can hold drift and match in its state. Whoever can only take independent noise a measurement is given
:func:`independent_sigma`, one figure of the same mean variance; that it is not independent is lost.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray

SHARES = np.sqrt([1.0, 1.0, 0.5])
"""White noise of (uL, uR, v) in shares of that of a single pixel coordinate: v is the mean of two."""
_SMALLEST_BIAS_PX = 1e-3


@dataclass(frozen=True)
class TrackNoise:
    """Levels of the three errors.

    Attributes
    ----------
    white : float
        Standard deviation of a pixel coordinate [px].
    drift : float
        Step of the random walk of column and of row, a frame [px].
    match : float
        Standard deviation of the disparity of the first observation that stays with the track [px].
    """

    white: float
    drift: float
    match: float

    @property
    def sigma(self) -> Array:
        """White noise of (uL, uR, v), ``(3,)`` [px]."""
        return self.white * SHARES

    def match_sigma(self, disparity: Array) -> Array:
        """Standard deviation of e for tracks that start with a disparity ``(n,)`` [px]; never zero."""
        return max(self.match, _SMALLEST_BIAS_PX) / disparity


def independent_sigma(noise: TrackNoise, *, age: IntArray, disparity: Array, first_disparity: Array) -> Array:
    """Standard deviation ``(n, 3)`` [px] of (uL, uR, v) in place of the three errors, the same for all.

    Parameters
    ----------
    noise : TrackNoise
    age : (n,)
        Frames since the first observation of the track.
    disparity, first_disparity : (n,)
        Disparity of each observation and of the first one of its track [px].
    """
    drift = noise.drift**2 * age
    match = (noise.match * disparity / first_disparity) ** 2
    # Half of the bias is in each of the two columns; the mean is over coordinates and observations.
    variance = noise.white**2 + float(np.mean(drift + 0.5 * match)) if len(age) else noise.white**2
    return np.broadcast_to(np.sqrt(variance) * SHARES, (len(age), 3))
