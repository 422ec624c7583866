"""How the poses of a run change with something that is varied one by one, and the covariance of that."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.trajectory import Poses
from vislam.geometry import se3


@dataclass(frozen=True)
class Changes:
    """Changes of all poses of a run with each of some causes, by one standard deviation of each.

    With independent causes ``theta`` of unit variance, ``truth = estimate exp(e + sum_c s_c theta_c)``: each
    column ``s_c`` is a change ``log(estimate^-1 other)``, in the tangent of the estimate, on its right, the
    worlds joined at the first pose.

    Attributes
    ----------
    cause : tuple of str
    filtered : (c, T, 6)
        Of the causal poses (omega, v) [rad, m].
    smoothed : (c, T, 6) or None
        Of the poses from all data; None for a run that has none.
    seconds : float
        Time that the runs took which they are from, all together [s].
    """

    cause: tuple[str, ...]
    filtered: Array
    smoothed: Array | None
    seconds: float

    def of(self, *, smoothed: bool) -> Array:
        """Changes ``(c, T, 6)`` of the causal poses, or of those from all data where there are such."""
        return self.smoothed if smoothed and self.smoothed is not None else self.filtered

    def covariance(self, *, smoothed: bool) -> Array:
        """Sum of ``s s^T`` over the causes, ``(T, 6, 6)`` [rad^2, m^2]."""
        found = self.of(smoothed=smoothed)
        return np.asarray(np.einsum("cti,ctj->tij", found, found))


def changes(poses: Poses, other: Poses) -> Array:
    """Change ``(T, 6)`` of poses to others of the same frames, the worlds joined at the first pose."""
    one, two = poses.world_T_imu, other.world_T_imu
    return np.asarray(se3.local(one, one[0] @ se3.inverse(two[0]) @ two))
