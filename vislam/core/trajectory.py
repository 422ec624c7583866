"""Poses and landmarks with their covariances, as estimators give them and as runs keep them."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.geometry import se3


@dataclass(frozen=True)
class Poses:
    """Poses of the body, one a frame.

    Attributes
    ----------
    world_T_imu : (T, 4, 4)
    cov : (T, 6, 6) or None
        Covariances (omega, v) on the right of the poses [rad^2, m^2]; None if there is none, NaN throughout
        for a frame that has none.
    """

    world_T_imu: Array
    cov: Array | None = None

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.world_T_imu)

    @property
    def covariances(self) -> Array:
        """Covariances ``(T, 6, 6)``, NaN where there is none."""
        return np.full((len(self), 6, 6), np.nan) if self.cov is None else self.cov

    def moved(self, world_T_old: Array) -> "Poses":
        """Poses in another world; covariances on the right of a pose stay what they are."""
        return Poses(world_T_old @ self.world_T_imu, self.cov)


@dataclass(frozen=True)
class Landmarks:
    """A map of points.

    Attributes
    ----------
    track : (m,)
        Track ids, each once.
    points_world : (m, 3)
        [m].
    points_cov : (m, 3, 3) or None
        Marginal covariances [m^2]; None if there is none, NaN throughout for a landmark that has none.
    """

    track: IntArray
    points_world: Array
    points_cov: Array | None = None

    @classmethod
    def none(cls) -> "Landmarks":
        """Map without landmarks."""
        return cls(np.empty(0, np.int64), np.empty((0, 3)))

    def __len__(self) -> int:
        """Return the number of landmarks."""
        return len(self.track)

    def moved(self, world_T_old: Array) -> "Landmarks":
        """Landmarks in another world."""
        rotation, cov = world_T_old[:3, :3], self.points_cov
        return Landmarks(
            self.track,
            se3.transform(world_T_old, self.points_world),
            None if cov is None else rotation @ cov @ rotation.T,
        )
