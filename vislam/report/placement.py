"""Where runs are drawn in space: aligned to their reference, near the origin."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.geometry import se3

_FEWEST = 3
"""Frames in common with the reference without which a run is not aligned."""


@dataclass(frozen=True)
class Placed:
    """A run where it is drawn.

    Attributes
    ----------
    pose, causal : (T, 4, 4)
        Final and causal poses of the reference's point; of the body, without a reference.
    position_cov : (T, 3, 3)
        Covariances of the positions of ``pose`` in the world that is drawn [m^2]; NaN where not given.
    points : (m, 3)
        Landmarks [m].
    """

    pose: Array
    causal: Array
    position_cov: Array
    points: Array


def place(run: Run, reference: Reference | None) -> Placed:
    """Align a levelled run to the reference, at whose point its covariance is evaluated as well."""
    body_T_point = np.eye(4) if reference is None else reference.imu_T_point
    drawn_T_world = np.eye(4)
    if reference is not None:
        laid = reference_T_world(run, reference, planar=reference.planar)
        if laid is not None:
            laid[:3, 3] -= origin(reference)
            drawn_T_world = laid
    pose = drawn_T_world @ run.final.world_T_imu @ body_T_point
    # Position errors are v, in the axes of the point: with exp on the right, R v moves the origin.
    turn = pose[:, :3, :3] @ se3.adjoint(se3.inverse(body_T_point))[3:]
    return Placed(
        pose=pose,
        causal=drawn_T_world @ run.filtered.world_T_imu @ body_T_point,
        position_cov=turn @ run.final.covariances @ turn.transpose(0, 2, 1),
        points=se3.transform(drawn_T_world, run.landmarks.points_world),
    )


def reference_T_world(run: Run, reference: Reference, *, planar: bool) -> Array | None:
    """Transform ``(4, 4)`` that aligns a levelled run to the reference; None where too little overlaps.

    Parameters
    ----------
    run : Run
    reference : Reference
    planar : bool
        Turn about the vertical and move in the plane only.
    """
    matched = associate(run.frame, run.stamp, run.final.world_T_imu, reference)
    if len(matched.frame) < _FEWEST:
        return None
    found = find_alignment("planar" if planar else "se3", matched)
    return se3.from_rotation_translation(found.rotation, found.translation)


def origin(reference: Reference) -> Array:
    """Where the drawn world begins ``(3,)``: Rerun draws in float32, which map coordinates would exhaust."""
    return np.append(reference.position[0], [0.0] * (3 - reference.position.shape[1]))


def principal_axes(cov: Array) -> tuple[Array, Array]:
    """Standard deviations ``(n, 3)``, increasing, and axes ``(n, 3, 3)``, a rotation each, of covariances."""
    variance, axes = np.linalg.eigh(cov)
    axes[:, :, 0] *= np.linalg.det(axes)[:, None]
    return np.sqrt(np.maximum(variance, 0.0)), axes
