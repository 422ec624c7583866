"""The one interface of all estimators, and how they are found by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Protocol

from vislam.base.errors import ConfigError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.sequence import Frame
from vislam.models import StereoRig, TrackNoise
from vislam.models.odometry import MotionNoise

GROUP = "vislam.estimators"
"""Entry-point group under which estimators are found by name."""


HEIGHT_SIGMA = 0.02
"""White error of the height against the integrated climb rate [m]."""
UNKNOWN_CLIMB = 5.0
"""Standard deviation of the climb rate where a step has none [m/s]."""


@dataclass(frozen=True)
class ClimbNoise:
    """How the climb rate is taken as a measurement.

    Attributes
    ----------
    walk : float
        Random walk of the error of its integral [m/sqrt(s)].
    tilt_sigma : float
        Prior standard deviation of the turn of the first pose's z axis against the vertical [rad].
    """

    walk: float
    tilt_sigma: float


@dataclass(frozen=True)
class Problem:
    """What every estimator is built from: models, noise and prior, no data.

    Attributes
    ----------
    rig : StereoRig
    noise : MotionNoise
    first_pose_sigma : (6,)
        Prior of the first pose, which is the identity [rad, m].
    bias_mean, bias_sigma : (6,)
        Prior of the twist bias [rad/s, m/s].
    track_noise : TrackNoise
        What the pixels of a track are off by.
    gate_probability : float
        Share of good observations that a chi-square gate lets pass; 1: there is to be no gate.
    clock_sigma : float
        Prior standard deviation of the inertial stamps' further offset from the camera's [s]; 0: known.
    disparity_offset_sigma : float
        Prior standard deviation of a constant error of all disparities [px]; 0: known.
    climb : ClimbNoise or None
        None: the climb rate is not used.
    """

    rig: StereoRig
    noise: MotionNoise
    first_pose_sigma: Array
    bias_mean: Array
    bias_sigma: Array
    track_noise: TrackNoise
    gate_probability: float
    clock_sigma: float = 0.0
    disparity_offset_sigma: float = 0.0
    climb: ClimbNoise | None = None


@dataclass(frozen=True)
class StepRecord:
    """What an estimator knows at a frame.

    Attributes
    ----------
    world_T_imu : (4, 4)
    pose_cov : (6, 6) or None
        Covariance of the pose, on its right.
    bias, bias_sigma : (6,) or None
        Twist bias and its standard deviation [rad/s, m/s].
    nis, dof : float, int
        Normalised innovation squared of the accepted observations and its degrees of freedom.
    log_likelihood : float
        Logarithm of the density of their innovations; NaN where the estimator does not have it.
    used : (n,)
        Which of the frame's observations were fused, as far as is known at the frame.
    gated : (n,)
        Which of them the estimator itself refused.
    world_gained : (6,) or None
        Information that the step gained on motions (omega, v) of the world, by the estimator's own Jacobians:
        more than none is information from nowhere [1/rad^2, 1/m^2]. None where it is not measured.
    """

    world_T_imu: Array
    pose_cov: Array | None
    bias: Array | None
    bias_sigma: Array | None
    nis: float
    dof: int
    log_likelihood: float
    used: BoolArray
    gated: BoolArray
    world_gained: Array | None = None


@dataclass(frozen=True)
class Estimate:
    """What an estimator knows in the end.

    Attributes
    ----------
    world_T_imu : (T, 4, 4)
    pose_cov : (T, 6, 6) or None
        Covariances of these poses, on the right; None if unknown, or if the poses are the causal ones.
    track : (m,)
        Ids of the landmarks.
    points_world : (m, 3)
        Landmarks [m].
    points_cov : (m, 3, 3) or None
        Their marginal covariances [m^2].
    counts : dict
        What was dropped, waited for, rescued.
    up : (3,) or None
        Direction of up in the world; None if not estimated.
    fused : tuple of (m,), (m,) or None
        Frame index and track id of every observation that the estimate rests on, in any order; None where
        the ``used`` of the frames is the last word. For who fuses observations of earlier frames, or takes
        some out again.
    events : tuple of str
        One line for each thing out of the ordinary that it had to do, such as a rescue.
    fit : tuple of float, int or None
        Sum of the squares of all residuals of the estimate, each by its noise, and how many more there are
        than unknowns; None where that is no chi-square number.
    """

    world_T_imu: Array
    pose_cov: Array | None
    track: IntArray
    points_world: Array
    points_cov: Array | None
    counts: dict[str, int]
    up: Array | None = None
    fused: tuple[IntArray, IntArray] | None = None
    events: tuple[str, ...] = ()
    fit: tuple[float, int] | None = None


class Estimator(Protocol):
    """What is built from a :class:`Problem` and options, fed frames in order, then asked for its end.

    One that is not meant to use the camera says so by an attribute ``blind = True``; any other that has fused
    no observation in the end is reported as degenerate.
    """

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame; ``refused (n,)`` marks observations that a shared gate has taken out."""
        ...

    def finalize(self) -> Estimate:
        """Return the estimate after the last frame."""
        ...


Build = Callable[[Problem, Mapping[str, Any]], Estimator]


def find(name: str, *, section: str = "") -> Build:
    """Find an estimator's builder by its name; a ConfigError names the config section if it is another."""
    known = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in known:
        where = f"estimators.{name}" if section in ("", name) else f"estimators.{section}.estimator: {name}"
        raise ConfigError(f"{where}: no such estimator; installed are {', '.join(sorted(known))}")
    entry = known[name]

    def build(problem: Problem, options: Mapping[str, Any]) -> Estimator:
        # Loaded here: what the module of one estimator raises is the failure of that run alone.
        return entry.load()(problem, options)

    return build
