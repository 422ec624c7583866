"""Tracks carried over one frame by the recorded motion: residuals, and their derivatives by shared errors.

A track seen at ``z`` in one frame is triangulated, moved by the inertial twist u of the step and projected
into the next. What is left has noise of its own for each track, and parts that all tracks have in common: the
calibration of rig, mounting and clock, and the error of the twist. With the parameters theta of the rig as
what the true rig has beyond the stated one, the residual is linear in them,

    z' - h(M(u) g(z)) = D theta + B e + noise,   M(u) = cam_T_imu exp(-dt u) imu_T_cam,

g the back-projection, h the projection and e the error of the twist; B is that of
:mod:`vislam.core.pooled_fit`. The derivatives are analytic: each parameter moves the point (by g or M), its
image (by h), or the twist.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import MIXING, RigidFit, continuations, inertial_steps, robust_weight
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.models import StereoRig
from vislam.models.shared_errors import (
    CAMERA_ROTATION,
    CLOCK,
    DISPARITY_OFFSET,
    FOCAL_SCALE,
    PRINCIPAL_POINT,
    VELOCITY_DIRECTION,
)

BASELINE_SCALE = "baseline_scale"
"""Share by which the baseline is longer than stated: no state of an estimator, but what others look like."""
SHARED: Mapping[str, tuple[str, ...]] = {
    CAMERA_ROTATION: (" x", " y", " z"),
    DISPARITY_OFFSET: ("",),
    PRINCIPAL_POINT: (" column", " row"),
    FOCAL_SCALE: ("",),
    BASELINE_SCALE: ("",),
    CLOCK: ("",),
    VELOCITY_DIRECTION: (" left", " up"),
}
"""What the columns of :attr:`SharedResiduals.by_shared` are, in order: of each parameter, what tells its
components apart in words. Signs and frames are those of :mod:`vislam.models.shared_errors`."""


@dataclass(frozen=True)
class SharedResiduals:
    """Residuals ``z' - h(M g(z))`` of (mean column, disparity, row), and what they depend on.

    Attributes
    ----------
    frame : (m,)
        Frame into which each is carried, increasing.
    row : (m,)
        Row of the sequence that it was carried from.
    residual : (m, 3)
        Over ``spread``.
    own : (m, 3)
        The same under the robust rigid motion of the frame's own tracks.
    spread : (m, 3)
        Robust standard deviation of ``own`` in its frame [px].
    weight : (m,)
        Of the frame's robust fit: near 0 for what follows no rigid motion.
    by_shared : (m, 3, p)
        Derivative by the parameters of :data:`SHARED`, over ``spread``.
    by_twist : (m, 3, 6)
        Derivative by the error of the recorded twist of the step, over ``spread``.
    """

    frame: IntArray
    row: IntArray
    residual: Array
    own: Array
    spread: Array
    weight: Array
    by_shared: Array
    by_twist: Array


def shared_residuals(sequence: Sequence, fits: dict[int, RigidFit]) -> SharedResiduals:
    """Carry the tracks of all frames that have a rigid fit, under the recorded motion.

    Parameters
    ----------
    sequence : Sequence
        With disparities above zero.
    fits : dict of int to RigidFit
        By frame, of the same tracks; at least one.
    """
    rig, z, pairs = sequence.rig, sequence.z, continuations(sequence)
    known = sorted(fits)
    index = np.concatenate([np.arange(pairs.start[k], pairs.start[k + 1]) for k in known])
    own, spread = (np.concatenate([getattr(fits[k], name) for k in known]) for name in ("residual", "spread"))
    before, after = pairs.before[index], pairs.after[index]
    frame = sequence.frame_of[after]
    step = inertial_steps(sequence)
    carried = _carried(rig, z[before], step[frame])
    by_twist = carried.by_body @ _body_by_twist(sequence, step, frame, carried.body)
    columns = (_by_rotation(carried), _by_intrinsics(rig, z[before], carried))
    by_shared = np.concatenate([*columns, _by_motion(sequence, frame, by_twist)], axis=2)
    mixed = MIXING / spread[:, :, None]
    return SharedResiduals(
        frame,
        before,
        np.einsum("mij,mj->mi", mixed, z[after] - rig.project(carried.moved)),
        own,
        spread,
        robust_weight(np.einsum("mi,mi->m", own, own), 1.0),
        mixed @ by_shared,
        mixed @ by_twist,
    )


@dataclass(frozen=True)
class _Carried:
    """Points ``(m, 3)`` before, in camera and body, and after, in the camera, and what moves their images.

    Attributes
    ----------
    points, body, moved : (m, 3)
    step : (m, 4, 4)
        Motion of the body.
    by_points, by_body : (m, 3, 3)
        Derivative of the image by the point before in the camera, and by the one after in the body.
    by_moved : (m, 3, 3)
        By the one after in the camera.
    """

    points: Array
    body: Array
    moved: Array
    step: Array
    by_points: Array
    by_body: Array
    by_moved: Array


def _carried(rig: StereoRig, z: Array, step: Array) -> _Carried:
    points = rig.back_project(z)
    body = se3.transform(rig.imu_T_cam, points)
    moved = se3.transform(rig.cam_T_imu, se3.transform(step, body[:, None])[:, 0])
    moved[:, 2] = np.maximum(moved[:, 2], rig.nearest)
    by_moved = rig.projection_jacobian(moved)
    by_body = by_moved @ rig.cam_T_imu[:3, :3]
    by_points = by_body @ step[:, :3, :3] @ rig.imu_T_cam[:3, :3]
    return _Carried(points, body, moved, step, by_points, by_body, by_moved)


def _body_by_twist(sequence: Sequence, step: Array, frame: IntArray, body: Array) -> Array:
    """Derivative ``(m, 3, 6)`` of the moved points in the body by the error of the twist."""
    means, _ = sequence.step_means()
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    right = se3.right_jacobian(-means * dt[:, None]) * dt[:, None, None]
    fixed = np.broadcast_to(np.eye(3), (len(body), 3, 3))
    moved = step[frame][:, :3, :3] @ np.concatenate([-so3.hat(body), fixed], axis=2)
    return np.asarray(moved @ right[frame])


def _by_rotation(carried: _Carried) -> Array:
    """Derivative ``(m, 3, 3)`` of the image by the rotation: the body's step is turned from both sides."""
    after = se3.transform(carried.step, carried.body[:, None])[:, 0]
    turned = so3.hat(after) - carried.step[:, :3, :3] @ so3.hat(carried.body)
    return np.asarray(carried.by_body @ turned)


def _by_intrinsics(rig: StereoRig, z: Array, carried: _Carried) -> Array:
    """Derivative ``(m, 3, 5)`` of the image by offset, principal point, focal length and baseline.

    Each moves the point before, which the motion carries on, and its image after.
    """
    points, image = carried.points, rig.project(carried.moved)
    depth, zero = points[:, 2], np.zeros(len(points))
    before = np.stack(
        [
            rig.back_projection_jacobian(z)[:, :, 1],
            np.column_stack([-depth / rig.fx, zero, zero]),
            np.column_stack([zero, -depth / rig.fy, zero]),
            np.column_stack([zero, zero, depth]),
            points,
        ],
        axis=2,
    )
    at_image = np.zeros_like(before)
    at_image[:, 1, 0] = -1.0
    at_image[:, :2, 1] = at_image[:, 2, 2] = 1.0
    at_image[:, :, 3] = image - [rig.cx, rig.cx, rig.cy]
    at_image[:, 1, 4] = image[:, 1] - image[:, 0]
    return np.asarray(carried.by_points @ before + at_image)


def _by_motion(sequence: Sequence, frame: IntArray, by_twist: Array) -> Array:
    """Derivative ``(m, 3, 3)`` of the residual by the clock and the velocity's direction."""
    later = -twist_rates(sequence)[frame]
    forward = sequence.step_means()[0][frame, 3]
    clock = by_twist @ later[:, :, None]
    return np.concatenate([clock, by_twist[:, :, 4:] * forward[:, None, None]], axis=2)


def twist_rates(sequence: Sequence) -> Array:
    """Change of the mean twist ``(T, 6)`` of each step with the inertial clock [rad/s^2, m/s^2]."""
    at = sequence.stamp + sequence.clock_offset
    ends = np.column_stack([np.interp(at, sequence.inertial_stamp, axis) for axis in sequence.twist.T])
    rates = np.zeros_like(ends)
    rates[1:] = np.diff(ends, axis=0) / np.diff(sequence.stamp)[:, None]
    return rates
