"""A finished run of an estimator: all that evaluation ever sees of it, saved and loaded as one file."""

import json
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from vislam.files import replace_whole
from vislam.geometry import se3, so3
from vislam.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Run:
    """What an estimator said, frame by frame and in the end.

    Attributes
    ----------
    name : str
    error : str
        Why it stopped early; empty for a complete run.
    frames_expected : int
    stamp : (T,)
        Camera times of the frames it finished [s].
    world_T_imu, world_T_imu_causal : (T, 4, 4)
        Poses as known in the end, and as known at their own time.
    pose_cov, pose_cov_causal : (T, 6, 6)
        Covariances of these poses, on their right; NaN where not given.
    bias, bias_sigma : (T, 6)
        Twist bias at each time and its standard deviation [rad/s, m/s]; NaN where not given.
    nis, dof : (T,)
        Normalised innovation squared and its degrees of freedom.
    log_likelihood : (T,)
        Logarithm of the density of the innovations; NaN where not given.
    step_time : (T,)
        Time of each step [s].
    total_time : float
        Time of all steps and of the final estimate [s].
    peak_rss : int
        Largest resident memory while it ran [bytes].
    used, gated : (n,)
        Which observations of the sequence the final estimate has fused, and which the estimator refused.
    track, points_world, points_cov : (m,), (m, 3), (m, 3, 3) or None
        Landmarks [m].
    counts : dict
        What was dropped, waited for, rescued.
    up : (3,)
        Direction of up in the world; z where the estimator does not know better.
    events : tuple of str
        One line for each thing out of the ordinary that the estimator had to do.
    """

    name: str
    error: str
    frames_expected: int
    stamp: Array
    world_T_imu: Array
    world_T_imu_causal: Array
    pose_cov: Array
    pose_cov_causal: Array
    bias: Array
    bias_sigma: Array
    nis: Array
    dof: IntArray
    log_likelihood: Array
    step_time: Array
    total_time: float
    peak_rss: int
    used: BoolArray
    gated: BoolArray
    track: IntArray
    points_world: Array
    points_cov: Array | None
    counts: dict[str, int]
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    events: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether the estimator finished."""
        return not self.error

    @property
    def nis_per_dof(self) -> float:
        """Normalised innovation squared a degree of freedom; 0 where nothing was fused."""
        return float(self.nis.sum() / max(self.dof.sum(), 1))

    def levelled(self) -> "Run":
        """Return the run in a world whose z axis points up, with the same origin."""
        turn = se3.from_rotation_translation(so3.onto(self.up, np.array([0.0, 0.0, 1.0])), np.zeros(3))
        rotation = turn[:3, :3]
        cov = self.points_cov
        return replace(
            self,
            world_T_imu=turn @ self.world_T_imu,
            world_T_imu_causal=turn @ self.world_T_imu_causal,
            points_world=self.points_world @ rotation.T,
            points_cov=None if cov is None else rotation @ cov @ rotation.T,
            up=np.array([0.0, 0.0, 1.0]),
        )

    def save(self, path: Path) -> None:
        """Write the run, whole or not at all."""
        arrays, plain = {}, {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                arrays[item.name] = value
            else:
                plain[item.name] = value
        with replace_whole(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, plain=np.array(json.dumps(plain)), **arrays)

    @classmethod
    def load(cls, path: Path) -> "Run":
        """Read a saved run."""
        with np.load(path) as archive:
            values: dict[str, Any] = json.loads(str(archive["plain"]))
            values.update({key: archive[key] for key in archive.files if key != "plain"})
        # JSON has no tuples, and a run saved before there were events has none.
        return cls(**{**values, "events": tuple(values.get("events", ()))})
