"""What an initialisation takes for granted: windows, thresholds and priors, none of them of one vehicle."""

from dataclasses import dataclass


@dataclass(frozen=True)
class InitialisationSettings:
    """Settings of an initialisation.

    Attributes
    ----------
    still_for : float
        A standstill at the first frame must last so long [s].
    still_px : float
        Median displacement of the tracks since the first frame, in pixels, up to which they stand still.
    still_noise : float
        Standard deviation of the samples up to which they are those of a body at rest, in units of that of
        their white noise: an engine or rotors shake a body that does not move.
    windows : tuple of float
        Lengths of the windows of a dynamic initialisation, the first that tells enough is taken [s].
    most_frames : int
        In a window.
    step : float
        Of the tracks and of inertia within a window, in whole frames [s].
    enough : float
        Standard deviation of the tilt, the accelerometer's bias given, with which no longer window is asked
        for [rad].
    needed : float
        The same above which there is no initialisation [rad].
    covered : float
        Share of a window that inertial samples must cover, and of its steps that tracks must tell.
    gyro_bias_sigma, accel_bias_sigma : float
        Prior of the biases, about 0 [rad/s, m/s^2].
    widened : float
        By how much the standard deviations that the data give are widened in the prior that estimators are
        given. They fuse the same data again, and what is used twice is ``1 / widened^2`` of the information.
    gauge_sigma : float
        Prior standard deviation of heading and position, which are free to be chosen [rad, m].
    """

    still_for: float = 1.0
    still_px: float = 1.0
    still_noise: float = 10.0
    windows: tuple[float, ...] = (1.0, 2.0, 3.0, 5.0)
    most_frames: int = 100
    step: float = 0.25
    enough: float = 0.005
    needed: float = 0.03
    covered: float = 0.5
    gyro_bias_sigma: float = 0.1
    accel_bias_sigma: float = 0.2
    widened: float = 5.0
    gauge_sigma: float = 1e-4
