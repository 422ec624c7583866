"""What an estimator is given at a camera time: stereo observations and the inertial step that ends there."""

from dataclasses import dataclass

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.imu import ImuStep


@dataclass(frozen=True)
class StereoFrame:
    """Stereo observations of a frame. Arrays are read-only.

    Attributes
    ----------
    track : (n,)
        Track ids in view. An id that is missing comes back only if landmarks are kept (``Problem.kept``).
    z : (n, 3)
        Stereo measurements (uL, uR, v) [px].
    sigma : (n, 3)
        Their standard deviations [px].
    usable : (n,)
        Which of them may be fused; the others were rejected for all estimators of the comparison.
    """

    track: IntArray
    z: Array
    sigma: Array
    usable: BoolArray

    def __len__(self) -> int:
        """Return the number of observations."""
        return len(self.track)


@dataclass(frozen=True)
class OdometryStep:
    """Inertial motion over the step that ends at a frame. Arrays are read-only.

    Attributes
    ----------
    twist : (6,)
        Mean inertial twist (omega, v) over the step, body frame [rad/s, m/s].
    twist_change : (6,)
        Twist at this frame less that at the frame before; 0 for the first.
    vertical_velocity : float
        Mean vertical velocity over the step [m/s]; NaN where the recording has none.
    """

    twist: Array
    twist_change: Array
    vertical_velocity: float


@dataclass(frozen=True)
class Frame:
    """What an estimator is given at one camera time.

    Attributes
    ----------
    k : int
        Index of the frame.
    stamp : float
        Camera time [s].
    dt : float
        Time since the frame before [s]; 0 for the first.
    stereo : StereoFrame
    odometry : OdometryStep
    imu : ImuStep or None
        Samples of accelerometer and gyro since the frame before; None where the recording has none.
    keyframe : bool
        Whether its observations are given. If not, it has none, and tracks go on from the keyframe before to
        the one after; its pose is to be predicted.
    """

    k: int
    stamp: float
    dt: float
    stereo: StereoFrame
    odometry: OdometryStep
    imu: ImuStep | None = None
    keyframe: bool = True
