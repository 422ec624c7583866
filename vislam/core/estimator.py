"""The one interface of all estimators, and how they are found by name."""

import os
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field
from inspect import signature
from typing import Any, Protocol

import numpy as np

from vislam.base.errors import ConfigError
from vislam.base.plugins import annotation_of, find_plugin, installed, load_plugin, plugin_options
from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.core.lagged import Lags
from vislam.core.standstill import Standstill
from vislam.core.step import Final, Step
from vislam.models import Kernel, SharedPrior, StereoRig, TrackNoise, shared_errors
from vislam.models.imu import ImuNoise, ImuPrior
from vislam.models.odometry import MotionNoise

GROUP = "vislam.estimators"
"""Entry-point group under which estimators are found by name."""


HEIGHT_SIGMA = 0.02
"""White error of the height against the integrated vertical velocity [m]."""
UNKNOWN_VERTICAL_VELOCITY = 5.0
"""Standard deviation of the vertical velocity where a step has none [m/s]."""
FIRST_TWIST_S = 1000.0
"""Of the first twist as much is known beforehand as this time after the first inertial sample [s]."""


@dataclass(frozen=True)
class VerticalVelocityNoise:
    """How the vertical velocity is taken as a measurement.

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
class Inertia:
    """Raw inertia as the model of motion.

    Attributes
    ----------
    noise : ImuNoise
    prior : ImuPrior
        Of the state at the first frame, in a world whose z axis points up; it takes the place of that of the
        first pose.
    standstill : Standstill or None
        Frames at which the velocity is zero, which all estimators take for a measurement; None: it is not
        used.
    """

    noise: ImuNoise
    prior: ImuPrior
    standstill: Standstill | None = None

    @property
    def information(self) -> dict[str, str]:
        """What an estimator says of its motion."""
        found = {"motion": "raw inertia", "biases of gyro and accelerometer": "estimated"}
        if self.standstill is not None:
            found["zero velocity"] = f"at {np.count_nonzero(self.standstill.frames)} frames"
        return found


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
    camera_rotation_sigma, disparity_offset_sigma, principal_point_sigma, focal_scale_sigma, clock_sigma, \
    velocity_direction_sigma : float
        Prior standard deviations of the errors that all tracks share (:mod:`vislam.models.shared_errors`)
        [rad, px, px, 1, s, rad]; 0: known.
    shared_walk : mapping of str to float
        Densities of their random walks, by name [unit/sqrt(s)]; those that are not there are constant.
    vertical_velocity : VerticalVelocityNoise or None
        None: the vertical velocity is not used.
    kernel : Kernel or None
        Robust kernel of the stereo observations, on residuals whitened by their noise; None: they are
        Gaussian.
    lags : Lags or None
        How much later poses are asked for again (``Final.lagged``); None: they are not.
    kept : int
        Landmarks out of view that are remembered, those seen last: a track id that comes back is one of them.
        0: none comes back.
    imu : Inertia or None
        Accelerometer and gyro are the model of motion; None: the twist is.
    """

    rig: StereoRig
    noise: MotionNoise
    first_pose_sigma: Array
    bias_mean: Array
    bias_sigma: Array
    track_noise: TrackNoise
    gate_probability: float
    camera_rotation_sigma: float = 0.0
    disparity_offset_sigma: float = 0.0
    principal_point_sigma: float = 0.0
    focal_scale_sigma: float = 0.0
    clock_sigma: float = 0.0
    velocity_direction_sigma: float = 0.0
    shared_walk: Mapping[str, float] = field(default_factory=dict)
    vertical_velocity: VerticalVelocityNoise | None = None
    kernel: Kernel | None = None
    lags: Lags | None = None
    kept: int = 0
    imu: Inertia | None = None

    @property
    def first_pose(self) -> Array:
        """Mean ``(4, 4)`` of the first pose: the identity, or by raw inertia upright."""
        return np.eye(4) if self.imu is None else np.array(self.imu.prior.world_T_imu)

    @property
    def first_pose_cov(self) -> Array:
        """Prior covariance ``(6, 6)`` of the first pose, on its right [rad^2, m^2]."""
        sigma = np.asarray(self.first_pose_sigma)
        return np.diag(sigma**2) if self.imu is None else np.array(self.imu.prior.cov[:6, :6])

    def shared(self) -> dict[str, SharedPrior]:
        """Errors that all tracks share and that are not known, with their priors, by name."""
        priors = {
            name: SharedPrior(getattr(self, f"{name}_sigma"), self.shared_walk.get(name, 0.0))
            for name in shared_errors.SIZES
        }
        return {name: prior for name, prior in priors.items() if prior.sigma > 0.0}


def shared_information(problem: Problem, *, estimated: Container[str]) -> dict[str, str]:
    """How an estimator says that it takes the errors that all tracks share, those that are not known.

    Parameters
    ----------
    problem : Problem
    estimated : container of str
        Names of those that it estimates.
    """
    found = {}
    for name, prior in problem.shared().items():
        model = "estimated" if prior.walk == 0.0 else "estimated, walking"
        found[name.replace("_", " ")] = model if name in estimated else "assumed known"
    return found


class Estimator(Protocol):
    """What is built from a :class:`Problem` and options, fed frames in order, then asked for its end.

    One that is not meant to use the camera says so by an attribute ``blind = True``; any other that has fused
    no observation in the end is reported as degenerate. One whose roll and pitch are estimates against
    gravity, in a world whose z axis points up, says so by ``upright = True``.
    """

    def process(self, frame: Frame) -> Step:
        """Take one frame; of its observations those that ``frame.stereo.usable`` marks, and no other."""
        ...

    def finalize(self) -> Final:
        """Return the final estimate after the last frame."""
        ...


Build = Callable[[Problem, Mapping[str, Any]], Estimator]


def find(name: str, *, section: str = "") -> Build:
    """Find an estimator's builder by its name, or by its module, ``my_module:build``.

    The builder takes the problem, and the options of the config's section if it has any: as a mapping, or
    parsed into the dataclass that its second parameter is annotated with. A ConfigError names the config
    section if it is another than the name.
    """
    entry, here = find_plugin(name, GROUP), os.getcwd()
    if entry is None:
        where = f"estimators.{name}" if section in ("", name) else f"estimators.{section}.estimator: {name}"
        raise ConfigError(f"{where}: no such estimator; installed are {', '.join(sorted(installed(GROUP)))}")

    def build(problem: Problem, options: Mapping[str, Any]) -> Estimator:
        # Loaded here: what the module of one estimator raises is the failure of that run alone.
        return _built(load_plugin(entry, here), problem, options, at=f"estimators.{section or name}")

    return build


def _built(
    builder: Callable[..., Estimator], problem: Problem, options: Mapping[str, Any], *, at: str
) -> Estimator:
    """Call a builder with as much as it takes."""
    takes = list(signature(builder).parameters.values())
    if len(takes) < 2:
        if options:
            raise ConfigError(f"{at}: it takes no options, got {', '.join(map(str, options))}")
        return builder(problem)
    kind = annotation_of(builder, takes[1].name)
    return builder(problem, plugin_options(kind, options, at=at))
