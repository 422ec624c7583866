"""Motions that lay an estimated trajectory on its reference, undoing what an estimate is free to choose.

A visual-inertial estimate is free in its position and in its turn about the vertical; a monocular one in its
scale as well. Zhang and Scaramuzza, *A Tutorial on Quantitative Trajectory Evaluation for Visual(-Inertial)
Odometry* (IROS 2018).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vislam.base.types import Array
from vislam.evaluation.association import Matched
from vislam.geometry import se3, so3

AlignmentKind = Literal["none", "first_pose", "yaw_position", "se3", "sim3", "planar"]
"""
none
    The estimate as it is.
first_pose
    The first pose on the reference's: error is what has gathered since.
yaw_position
    Turn about z and translation, by least squares over all positions.
se3
    Rotation and translation, by least squares.
sim3
    Rotation, translation and scale, by least squares.
planar
    Turn about z and translation in x and y, by least squares in the plane; heights are left alone.
"""

_STRAIGHT = 1e-12
"""Second singular value, as a share of the first, under which points lie on one line."""
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Alignment:
    """A similarity ``p -> scale * rotation @ p + translation`` from the estimate's world to the reference's.

    Attributes
    ----------
    kind : AlignmentKind
    rotation : (3, 3)
    translation : (3,)
        [m].
    scale : float
        1 except for ``sim3``.
    """

    kind: AlignmentKind
    rotation: Array
    translation: Array
    scale: float = 1.0

    def transform_points(self, points: Array) -> Array:
        """Points ``(..., 3)`` [m] in the reference's world."""
        return self.scale * points @ self.rotation.T + self.translation

    def transform_poses(self, poses: Array) -> Array:
        """Poses ``(..., 4, 4)`` in the reference's world; their positions alone are scaled."""
        rotation = self.rotation @ poses[..., :3, :3]
        return se3.from_rotation_translation(rotation, self.transform_points(poses[..., :3, 3]))


def admitted(matched: Matched) -> list[AlignmentKind]:
    """Kinds of alignment that the reference of a match allows."""
    if matched.planar:
        return ["none", "planar"]
    return [kind for kind in _FINDERS if kind != "first_pose" or matched.pose is not None]


def find_alignment(kind: AlignmentKind, matched: Matched) -> Alignment:
    """Alignment of one kind of a matched estimate with its reference.

    What the positions leave free (the turn about a straight line, any turn if nothing moves, the scale of a
    point) is not turned and not scaled.

    Raises
    ------
    ValueError
        If nothing is matched, the reference has no height and the kind needs it, or it has no poses and the
        kind needs them.
    """
    if not len(matched.frame):
        raise ValueError("an alignment must have 1 matched frame or more, got 0")
    if matched.planar and kind not in admitted(matched):
        raise ValueError(f"alignment with a planar reference must be none or planar, got {kind}")
    return _FINDERS[kind](matched)


def align(estimate: Array, reference: Array) -> tuple[Array, Array]:
    """Least-squares rigid motion from estimate to reference, in two or three dimensions.

    Umeyama (PAMI 1991), eqs. (40) to (42) without scale. Points on one line in space leave the turn about it
    free: of all rotations that fit, it is then the smallest.

    Parameters
    ----------
    estimate, reference : (n, d)
        Matched positions [m], n at least 1, d = 2 or 3.

    Returns
    -------
    rotation : (d, d)
    translation : (d,)
        ``reference ~ estimate @ rotation.T + translation``.
    """
    centre, target = _centre(estimate), _centre(reference)
    u, singular, vt = np.linalg.svd((reference - target).T @ (estimate - centre))
    if len(singular) == 3 and singular[1] <= _STRAIGHT * singular[0]:
        rotation = so3.onto(vt[0], u[:, 0])
    else:
        sign = np.eye(len(singular))
        sign[-1, -1] = np.sign(np.linalg.det(u @ vt))
        rotation = u @ sign @ vt
    return rotation, target - rotation @ centre


def _none(matched: Matched) -> Alignment:
    return Alignment("none", np.eye(3), np.zeros(3))


def _first_pose(matched: Matched) -> Alignment:
    if matched.pose is None:
        raise ValueError("alignment first_pose must have a reference with poses, got positions alone")
    motion = matched.pose[0] @ se3.inverse(matched.estimate[0])
    return Alignment("first_pose", motion[:3, :3], motion[:3, 3])


def _yaw_position(matched: Matched) -> Alignment:
    estimate = matched.estimate[:, :3, 3]
    rotation = _yaw(estimate, matched.position)
    return Alignment("yaw_position", rotation, _centre(matched.position) - rotation @ _centre(estimate))


def _planar(matched: Matched) -> Alignment:
    estimate = matched.estimate[:, :3, 3]
    rotation = _yaw(estimate, matched.position)
    shift = _centre(matched.position)[:2] - (rotation @ _centre(estimate))[:2]
    return Alignment("planar", rotation, np.append(shift, 0.0))


def _se3(matched: Matched) -> Alignment:
    return Alignment("se3", *align(matched.estimate[:, :3, 3], matched.position))


def _sim3(matched: Matched) -> Alignment:
    """Umeyama (PAMI 1991): the rotation is that without scale, eq. (42) the regression on what it turned."""
    estimate = matched.estimate[:, :3, 3]
    rotation, _ = align(estimate, matched.position)
    centre, target = _centre(estimate), _centre(matched.position)
    turned, wanted = (estimate - centre) @ rotation.T, matched.position - target
    moves = turned.any() and wanted.any()
    scale = float(np.sum(turned * wanted) / np.sum(turned**2)) if moves else 1.0
    return Alignment("sim3", rotation, target - scale * rotation @ centre, scale)


def _yaw(estimate: Array, reference: Array) -> Array:
    """Turn about z ``(3, 3)`` that takes x and y of centred points nearest to those of others.

    The angle maximises ``sum r . R(angle) e`` = ``cos(angle) sum e . r + sin(angle) sum e x r``.
    """
    own, other = (estimate - _centre(estimate))[:, :2], (reference - _centre(reference))[:, :2]
    cross = np.sum(own[:, 0] * other[:, 1] - own[:, 1] * other[:, 0])
    return so3.exp(np.arctan2(cross, np.sum(own * other)) * _Z)


def _centre(points: Array) -> Array:
    """Mean, taken from the first point on: that of equal points is then exactly that point."""
    return np.asarray(points[0] + np.mean(points - points[0], axis=0))


_FINDERS: Mapping[AlignmentKind, Callable[[Matched], Alignment]] = {
    "none": _none,
    "first_pose": _first_pose,
    "yaw_position": _yaw_position,
    "se3": _se3,
    "sim3": _sim3,
    "planar": _planar,
}
