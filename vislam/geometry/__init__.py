"""The conventions of this project, stated once. ``tests/geometry/test_conventions.py`` asserts each one.

Frames
    ``world`` is the body frame of the first pose, turned so that z points up where the recording
    allows it. ``imu`` is the body frame: x forward, y left, z up. ``cam`` is the left camera of
    the rectified stereo pair: x right, y down, z forward.

Poses
    A pose is a float64 array ``(..., 4, 4)``. ``a_T_b`` takes coordinates in b to coordinates in a,
    so ``world_T_cam = world_T_imu @ imu_T_cam`` and equal inner names cancel. Rotations read
    ``a_R_b``. Points and covariances end in the frame they are written in.

Tangent vectors
    Rotation first: ``xi = (omega, v)``, in rad and m. The perturbation is on the right, in the body
    frame: ``retract(T, xi) = T @ exp(xi)`` and ``local(a, b) = log(inverse(a) @ b)``. The
    covariance of a pose is that of ``xi``. This is the order and the retraction of GTSAM's
    ``Pose3`` and the exponential of SciPy's ``RigidTransform``, so covariances cross untouched.

Twists
    ``(omega, v)`` again, in rad/s and m/s, in the body frame: ``T(t + dt) = T(t) @ exp(dt * twist)``.

Stereo measurement
    ``z = (uL, uR, v)`` in px, v being the mean row of the left and the right image.

Quaternions
    In files only, scalar last: ``x y z w``.
"""

from vislam.geometry import se3, so3

__all__ = ["se3", "so3"]
