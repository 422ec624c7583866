"""Reference trajectories: what a run is scored against, by name and with its limits."""

from dataclasses import dataclass, field

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.stamped import Stamped


@dataclass(frozen=True)
class Reference:
    """Poses or positions to compare with.

    Attributes
    ----------
    name, limits : str
        For the report. "Truth" is the name of a simulation's alone.
    frame : (m,)
        Frames it covers.
    position : (m, 2) or (m, 3)
        Positions of the point below [m]; two columns if it is planar.
    pose : (m, 4, 4) or None
        Full poses of that point's frame.
    imu_T_point : (4, 4)
        Where the reference point sits in the body.
    track, points_world : (j,), (j, 3)
        True landmarks of a simulation [m]; empty elsewhere.
    sigma : float
        Standard deviation of its own positions, as far as is known [m].
    bias : (6,), (T, 6) or None
        True bias of a simulation's inertial samples (omega, v) [rad/s, m/s]; at each frame if it walks.
    sigma_rotation : float
        Standard deviation of its own attitudes, as far as is known [rad].
    source : Stamped or None
        All its rows on the stamps they came with, for trajectories that are on none of the frames; None where
        it is known at the frames only.
    """

    name: str
    limits: str
    frame: IntArray
    position: Array
    pose: Array | None
    imu_T_point: Array
    track: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    points_world: Array = field(default_factory=lambda: np.empty((0, 3)))
    sigma: float = 0.0
    bias: Array | None = None
    sigma_rotation: float = 0.0
    source: Stamped | None = None

    @property
    def planar(self) -> bool:
        """Whether it has no height."""
        return self.position.shape[1] == 2


def truth_reference(
    world_T_imu: Array, track: IntArray, points_world: Array, *, bias: Array | None = None
) -> Reference:
    """Reference of a simulation: its exact truth.

    Parameters
    ----------
    world_T_imu : (T, 4, 4)
    track, points_world : (j,), (j, 3)
        True landmarks [m].
    bias : (6,) or (T, 6), optional
        True bias of the inertial samples (omega, v) [rad/s, m/s]; at each frame if it walks.
    """
    return Reference(
        name="truth",
        limits="exact, simulated",
        frame=np.arange(len(world_T_imu)),
        position=world_T_imu[:, :3, 3],
        pose=world_T_imu,
        imu_T_point=np.eye(4),
        track=track,
        points_world=points_world,
        bias=bias,
    )
