"""A finished run of an estimator: all that evaluation reads of it, saved and loaded as one file."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.archive import read_archive, write_archive
from vislam.core.changes import Changes
from vislam.core.lagged import Lagged
from vislam.core.schema import (
    DIRECTION,
    IDS,
    INCREASING,
    NOT_NEGATIVE,
    RIGID,
    UNIQUE,
    Count,
    Each,
    Level,
    Plain,
    Section,
    Table,
    mask,
    real,
    whole,
)
from vislam.core.trajectory import Landmarks, Poses
from vislam.geometry import se3, so3

Estimate = Literal["filtered", "smoothed"]
"""An estimate of the trajectory: each pose from the data up to its frame, or from all data."""
ESTIMATES: tuple[Estimate, ...] = get_args(Estimate)
"""Both, in the order in which they come about."""
Beside = Literal["considered", "sandwich"]
"""A covariance beside the estimator's own: with the errors that all observations share considered, or from
the scores of blocks of time."""
BESIDE: tuple[Beside, ...] = get_args(Beside)
"""Both, in the order in which they are told."""
_FORMER = {"innovations.world_gained": "innovations.spurious_information"}
"""Names that earlier versions wrote, and what they are called now."""
_TABLE: Table = {
    "name": Plain(str),
    "frames_expected": Plain(Count),
    "frame": whole("T", INCREASING, NOT_NEGATIVE),
    "stamp": real("T", INCREASING),
    "filtered": Section(),
    "filtered.world_T_imu": real("T 4 4", RIGID),
    "filtered.cov": real("T 6 6", gaps=True, optional=True),
    "smoothed": Section(optional=True),
    "smoothed.world_T_imu": real("T 4 4", RIGID),
    "smoothed.cov": real("T 6 6", gaps=True, optional=True),
    "states": Each({"value": real("T *", gaps=True), "sigma": real("T *", gaps=True)}),
    "innovations": Section(),
    "innovations.nis": real("T"),
    "innovations.dof": whole("T"),
    "innovations.log_likelihood": real("T", gaps=True),
    "innovations.spurious_information": real("T 6", gaps=True),
    "cost": Section(),
    "cost.step_time": real("T", NOT_NEGATIVE),
    "cost.total_time": Plain(Level),
    "cost.peak_rss": Plain(Count),
    "cost.beside": Plain(Count, later=True),
    "used": mask("n"),
    "gated": mask("n"),
    "map": Section(optional=True),
    "map.track": whole("m", UNIQUE, IDS),
    "map.points_world": real("m 3"),
    "map.points_cov": real("m 3 3", gaps=True, optional=True),
    "log": Section(),
    "log.error": Plain(str),
    "log.traceback": Plain(str),
    "log.counts": Plain(dict[str, int]),
    "log.events": Plain(tuple[str, ...]),
    "up": real("3", DIRECTION),
    "fit": Plain(tuple[Level, int] | None),
    "blind": Plain(bool),
    "elsewhere": Plain(bool, later=True),
    "upright": Plain(bool, later=True),
    "identity": Plain(str),
    "information": Plain(dict[str, str]),
    "lagged": Section(optional=True, later=True),
    "lagged.lag": whole("l", INCREASING, NOT_NEGATIVE),
    "lagged.world_T_imu": real("l T 4 4", RIGID),
    "lagged.cov": real("l T 6 6", gaps=True),
    "considered": Section(optional=True, later=True),
    "considered.cause": Plain(tuple[str, ...]),
    "considered.filtered": real("c T 6"),
    "considered.smoothed": real("c T 6", optional=True),
    "considered.seconds": Plain(Level),
    "sandwich": Section(optional=True, later=True),
    "sandwich.cause": Plain(tuple[str, ...]),
    "sandwich.filtered": real("b T 6"),
    "sandwich.smoothed": real("b T 6", optional=True),
    "sandwich.seconds": Plain(Level),
}
"""The fields of a saved run: type, shape and range of each, a letter for each size."""


@dataclass(frozen=True)
class StateHistory:
    """A part of the state beside pose and landmarks, frame by frame.

    Attributes
    ----------
    value, sigma : (T, m)
        Filtered values and their estimated standard deviations; NaN where not given.
    """

    value: Array
    sigma: Array


@dataclass(frozen=True)
class Innovations:
    """How the observations met what was predicted of them, frame by frame.

    Attributes
    ----------
    nis, dof : (T,)
        Normalised innovation squared and its degrees of freedom.
    log_likelihood : (T,)
        Logarithm of the density of the innovations; NaN where not given.
    spurious_information : (T, 6)
        Information gained at each frame on motions (omega, v) of the world, which no measurement holds, by
        the estimator's own Jacobians [1/rad^2, 1/m^2]; NaN where not given.
    """

    nis: Array
    dof: IntArray
    log_likelihood: Array
    spurious_information: Array

    @classmethod
    def unknown(cls, frames: int) -> "Innovations":
        """Nothing was fused, or nothing is known of it."""
        unknown = np.full((frames, 7), np.nan)
        return cls(np.zeros(frames), np.zeros(frames, np.int64), unknown[:, 0], unknown[:, 1:])


@dataclass(frozen=True)
class Cost:
    """What a run took.

    Attributes
    ----------
    step_time : (T,)
        Time of each step [s]; empty where it is not known.
    total_time : float
        Time of all steps and of the final estimate [s].
    peak_rss : int
        Largest resident memory while it ran [bytes].
    beside : int
        Runs that the same comparison may have had going at the same time, in processes of their own.
    """

    step_time: Array = field(default_factory=lambda: np.empty(0))
    total_time: float = 0.0
    peak_rss: int = 0
    beside: int = 0


@dataclass(frozen=True)
class Log:
    """What there is to report of how a run went.

    Attributes
    ----------
    error : str
        Why it stopped early; empty for a complete run.
    traceback : str
        Where in the code it stopped early; empty for a complete run.
    counts : dict
        What was dropped, waited for, recovered from.
    events : tuple of str
        One line for each thing out of the ordinary that the estimator had to do.
    """

    error: str = ""
    traceback: str = ""
    counts: dict[str, int] = field(default_factory=dict)
    events: tuple[str, ...] = ()


_PARTS: dict[str, Callable[..., Any]] = {
    "filtered": Poses,
    "smoothed": Poses,
    "innovations": Innovations,
    "cost": Cost,
    "map": Landmarks,
    "log": Log,
    "lagged": Lagged,
    "considered": Changes,
    "sandwich": Changes,
}


@dataclass(frozen=True)
class Run:
    """What an estimator reported, frame by frame and in the end.

    Attributes
    ----------
    name : str
    frames_expected : int
    frame : (T,)
        Indices of the frames it has poses of, increasing; of an estimator's, the first T.
    stamp : (T,)
        Camera times of these frames [s].
    filtered : Poses
        The pose of each frame, from the data up to it.
    innovations : Innovations
    used, gated : (n,)
        Which observations of the sequence the final estimate has fused, and which the estimator rejected.
    smoothed : Poses or None
        The poses from all data; None if these are the filtered ones.
    states : dict of str to StateHistory
        What else was estimated.
    cost : Cost
    map : Landmarks or None
    log : Log
    up : (3,)
        Direction of up in the world; z where the estimator does not know better.
    fit : tuple of float, int or None
        Sum of the squared residuals of the final estimate, each by its noise, and its degrees of freedom.
    blind : bool
        Whether the estimator is not meant to use the camera.
    elsewhere : bool
        Whether it was read from a trajectory file, so that nobody knows what was given and fused.
    upright : bool
        Whether gravity was measured, so that roll and pitch against its world's z axis are estimates, and
        only heading and position were free to be chosen.
    identity : str
        Hash of all that decides the run; empty if it is not known.
    information : dict of str to str
        How the estimator says that it takes what it is given, by what that is: the noise of the tracks, their
        outliers. Empty if it does not say.
    lagged : Lagged or None
        The poses as known at some lags; None where that was not asked for, or cannot be told.
    considered : Changes or None
        Of the poses by the errors that all observations share, one standard deviation of each; None where
        none is considered.
    sandwich : Changes or None
        Of the poses by the weight of the observations of each block of time; None where not asked for.
    """

    name: str
    frames_expected: int
    frame: IntArray
    stamp: Array
    filtered: Poses
    innovations: Innovations
    used: BoolArray
    gated: BoolArray
    smoothed: Poses | None = None
    states: dict[str, StateHistory] = field(default_factory=dict)
    cost: Cost = field(default_factory=Cost)
    map: Landmarks | None = None
    log: Log = field(default_factory=Log)
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    fit: tuple[float, int] | None = None
    blind: bool = False
    elsewhere: bool = False
    upright: bool = False
    identity: str = ""
    information: dict[str, str] = field(default_factory=dict)
    lagged: Lagged | None = None
    considered: Changes | None = None
    sandwich: Changes | None = None

    @classmethod
    def without_frames(cls, name: str, log: Log, *, frames_expected: int, observations: int) -> "Run":
        """Run that never began, for the reason in its log."""
        unfused = np.zeros(observations, bool)
        return cls(
            name=name,
            frames_expected=frames_expected,
            frame=np.empty(0, np.int64),
            stamp=np.empty(0),
            filtered=Poses(np.empty((0, 4, 4))),
            innovations=Innovations.unknown(0),
            used=unfused,
            gated=unfused,
            log=log,
        )

    @property
    def complete(self) -> bool:
        """Whether the estimator finished."""
        return not self.log.error

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """The estimates of the trajectory that it has, the final one last."""
        return ESTIMATES[:1] if self.smoothed is None else ESTIMATES

    @property
    def final(self) -> Poses:
        """The poses of the final estimate: smoothed if there are such, else filtered."""
        return self.filtered if self.smoothed is None else self.smoothed

    def poses(self, estimate: Estimate | None = None) -> Poses:
        """Poses of an estimate, by default of the final one; ValueError if the run does not have it."""
        if estimate == "filtered":
            return self.filtered
        if estimate == "smoothed" and self.smoothed is None:
            raise ValueError(f"{self.name}: expected a run with smoothed poses")
        return self.final

    @property
    def beside(self) -> tuple[Beside, ...]:
        """Which covariances it has beside its own."""
        return tuple(kind for kind in BESIDE if getattr(self, kind) is not None)

    def with_changes(self, kind: Beside, found: Changes) -> "Run":
        """Return the run with changes of its poses."""
        if kind == "considered":
            return replace(self, considered=found)
        return replace(self, sandwich=found)

    def with_covariances(self, kind: Beside) -> "Run":
        """Return the run with other covariances of its poses in place of its own.

        ``considered``: its own and what the shared errors add, ``P + sum s s^T``, NaN where it has none of
        its own. ``sandwich``: what the scores of the blocks come to, whatever its own are. A ValueError if
        the run does not have them.
        """
        found: Changes | None = getattr(self, kind)
        if found is None:
            raise ValueError(f"{self.name}: expected a run with covariances of kind {kind}")

        def other(poses: Poses, *, smoothed: bool) -> Poses:
            own = poses.covariances if kind == "considered" else 0.0
            return Poses(poses.world_T_imu, own + found.covariance(smoothed=smoothed))

        after = None if self.smoothed is None else other(self.smoothed, smoothed=True)
        return replace(self, filtered=other(self.filtered, smoothed=False), smoothed=after)

    @property
    def landmarks(self) -> Landmarks:
        """The map; without landmarks where there is none."""
        return Landmarks.none() if self.map is None else self.map

    @property
    def nis_per_dof(self) -> float:
        """Normalised innovation squared a degree of freedom; 0 where nothing was fused."""
        return float(self.innovations.nis.sum() / max(self.innovations.dof.sum(), 1))

    def levelled(self) -> "Run":
        """Return the run in a world whose z axis points up, with the same origin."""
        turn = se3.from_rotation_translation(so3.onto(self.up, np.array([0.0, 0.0, 1.0])), np.zeros(3))
        return replace(
            self,
            filtered=self.filtered.moved(turn),
            smoothed=None if self.smoothed is None else self.smoothed.moved(turn),
            map=None if self.map is None else self.map.moved(turn),
            lagged=None if self.lagged is None else self.lagged.moved(turn),
            up=np.array([0.0, 0.0, 1.0]),
        )

    def save(self, path: Path) -> None:
        """Write the run, whole or not at all."""
        write_archive(path, self)

    @classmethod
    def load(cls, path: Path) -> "Run":
        """Read a saved run; a DataError names what is invalid."""
        tree = read_archive(path, _TABLE, what="a run as this version of vislam saves it", former=_FORMER)
        for name, kind in _PARTS.items():
            tree[name] = None if tree.get(name) is None else kind(**tree[name])
        tree["states"] = {name: StateHistory(**history) for name, history in tree["states"].items()}
        return cls(**tree)
