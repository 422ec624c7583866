"""A finished run of an estimator: all that evaluation ever sees of it, saved and loaded as one file."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from vislam.base.files import save_archive
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.archive import read_archive
from vislam.core.schema import (
    DIRECTION,
    IDS,
    INCREASING,
    NOT_NEGATIVE,
    RIGID,
    UNIQUE,
    Count,
    Level,
    Plain,
    Table,
    mask,
    real,
    whole,
)
from vislam.geometry import se3, so3

_TABLE: Table = {
    "name": Plain(str),
    "error": Plain(str),
    "frames_expected": Plain(Count),
    "frame": whole("T", INCREASING, NOT_NEGATIVE),
    "stamp": real("T", INCREASING),
    "world_T_imu": real("T 4 4", RIGID),
    "world_T_imu_causal": real("T 4 4", RIGID),
    "pose_cov": real("T 6 6", gaps=True),
    "pose_cov_causal": real("T 6 6", gaps=True),
    "bias": real("T 6", gaps=True),
    "bias_sigma": real("T 6", gaps=True),
    "nis": real("T"),
    "dof": whole("T"),
    "log_likelihood": real("T", gaps=True),
    "world_gained": real("T 6", gaps=True),
    "step_time": real("T", NOT_NEGATIVE),
    "total_time": Plain(Level),
    "peak_rss": Plain(Count),
    "used": mask("n"),
    "gated": mask("n"),
    "track": whole("m", UNIQUE, IDS),
    "points_world": real("m 3"),
    "points_cov": real("m 3 3", gaps=True, optional=True),
    "counts": Plain(dict[str, int]),
    "up": real("3", DIRECTION),
    "events": Plain(tuple[str, ...]),
    "fit": Plain(tuple[Level, int] | None),
    "traceback": Plain(str, later=True),
    "blind": Plain(bool, later=True),
    "identity": Plain(str, later=True),
}
"""The fields of a saved run: type, shape and range of each, a letter for each size."""


@dataclass(frozen=True)
class Run:
    """What an estimator said, frame by frame and in the end.

    Attributes
    ----------
    name : str
    error : str
        Why it stopped early; empty for a complete run.
    frames_expected : int
    frame : (T,)
        Indices of the frames it has poses of, increasing; of an estimator's, the first T.
    stamp : (T,)
        Camera times of these frames [s].
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
    world_gained : (T, 6)
        Information gained at each frame on motions (omega, v) of the world, which no measurement can tell, by
        the estimator's own Jacobians [1/rad^2, 1/m^2]; NaN where not given.
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
    fit : tuple of float, int or None
        Sum of the squared residuals of the final estimate, each by its noise, and its degrees of freedom.
    traceback : str
        Where in the code it stopped early; empty for a complete run.
    blind : bool
        Whether the estimator is not meant to use the camera.
    identity : str
        Hash of all that decides the run; empty if it is not known.
    """

    name: str
    error: str
    frames_expected: int
    frame: IntArray
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
    world_gained: Array
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
    fit: tuple[float, int] | None = None
    traceback: str = ""
    blind: bool = False
    identity: str = ""

    @classmethod
    def without_frames(cls, name: str, error: str, *, frames_expected: int, observations: int) -> "Run":
        """Run that never began, for the reason given."""
        unfused = np.zeros(observations, bool)
        return cls(
            name=name,
            error=error,
            frames_expected=frames_expected,
            frame=np.empty(0, np.int64),
            stamp=np.empty(0),
            world_T_imu=np.empty((0, 4, 4)),
            world_T_imu_causal=np.empty((0, 4, 4)),
            pose_cov=np.empty((0, 6, 6)),
            pose_cov_causal=np.empty((0, 6, 6)),
            bias=np.empty((0, 6)),
            bias_sigma=np.empty((0, 6)),
            nis=np.empty(0),
            dof=np.empty(0, np.int64),
            log_likelihood=np.empty(0),
            world_gained=np.empty((0, 6)),
            step_time=np.empty(0),
            total_time=0.0,
            peak_rss=0,
            used=unfused,
            gated=unfused,
            track=np.empty(0, np.int64),
            points_world=np.empty((0, 3)),
            points_cov=None,
            counts={},
        )

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
        save_archive(path, plain, arrays)

    @classmethod
    def load(cls, path: Path) -> "Run":
        """Read a saved run; a DataError says what is wrong with it."""
        return cls(**read_archive(path, _TABLE, what="a run as this version of vislam saves it"))
