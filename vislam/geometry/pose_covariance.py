"""Covariances of poses in the conventions of others, taken to ours: (omega, v) on the right.

Let ``T`` be the estimate and ``R`` its rotation. With the error of each convention

========  ==========================================  =======================================
name      error of the pose                           ours, (omega, v), is
========  ==========================================  =======================================
right     ``truth = T exp(xi)``                       ``xi``
left      ``truth = exp(xi) T``                       ``Ad(T^-1) xi``
split     ``R exp(omega)``, ``p + v``                 ``(omega, R^T v)``
world     ``exp(omega) R``, ``p + v``                 ``(R^T omega, R^T v)``
========  ==========================================  =======================================

to first order. ``split`` is OpenVINS' (quaternion error on the body's side, position in the world), ``world``
that of ROS messages (rotation about the fixed axes of the parent frame), ``right`` and ``left`` those of
GTSAM, manif and smfeval. All these maps have determinant 1, so that the log-density of an error is comparable
between conventions.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3

Order = Literal["rotation_first", "position_first"]
Frame = Literal["right", "left", "split", "world"]
ORDERS: tuple[Order, ...] = get_args(Order)
FRAMES: tuple[Frame, ...] = get_args(Frame)


@dataclass(frozen=True)
class CovarianceConvention:
    """How a covariance of a pose is to be read.

    Attributes
    ----------
    order : "rotation_first" or "position_first"
        Of its rows and columns.
    frame : "right", "left", "split" or "world"
        Where its error stands, for which see the module.
    """

    order: Order
    frame: Frame

    def __str__(self) -> str:
        return f"{self.order.replace('_', ' ')}, {self.frame}"


OURS = CovarianceConvention("rotation_first", "right")


def to_right(pose: Array, cov: Array, convention: CovarianceConvention) -> Array:
    """Covariances ``(n, 6, 6)`` of poses ``(n, 4, 4)`` in a convention, as (omega, v) on the right."""
    if convention.order == "position_first":
        turned = [3, 4, 5, 0, 1, 2]
        cov = cov[:, turned][:, :, turned]
    move = _to_right(pose, convention.frame)
    return cov if move is None else np.asarray(move @ cov @ move.transpose(0, 2, 1))


def from_right(pose: Array, cov: Array, convention: CovarianceConvention) -> Array:
    """The inverse of :func:`to_right`."""
    move = _to_right(pose, convention.frame)
    if move is not None:
        back = np.linalg.inv(move)
        cov = back @ cov @ back.transpose(0, 2, 1)
    if convention.order == "position_first":
        turned = [3, 4, 5, 0, 1, 2]
        cov = cov[:, turned][:, :, turned]
    return np.asarray(cov)


def _to_right(pose: Array, frame: Frame) -> Array | None:
    if frame == "right":
        return None
    if frame == "left":
        return se3.adjoint(se3.inverse(pose))
    back = pose[:, :3, :3].transpose(0, 2, 1)
    move = np.zeros((len(pose), 6, 6))
    move[:, :3, :3] = np.eye(3) if frame == "split" else back
    move[:, 3:, 3:] = back
    return move
