"""The one interface of all estimators, how they are found, and the loop that owns the clock."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from vislam.data.sequence import Frame, Sequence
from vislam.errors import ConfigError
from vislam.memory import PeakMemory
from vislam.motion import MotionNoise
from vislam.run import Run
from vislam.sensors import StereoRig, TrackNoise
from vislam.types import Array, BoolArray, IntArray

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
    """What is built from a :class:`Problem` and options, fed frames in order, then asked for its end."""

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
    build: Build = known[name].load()
    return build


def run(
    estimator: Estimator,
    sequence: Sequence,
    sigma: Array,
    *,
    name: str,
    refused: BoolArray | None = None,
    on_frame: Callable[[int], None] = lambda k: None,
    blas_threads: int = 1,
) -> Run:
    """Feed a sequence to an estimator and keep all it says.

    Parameters
    ----------
    estimator : Estimator
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    name : str
    refused : (n,), optional
        Observations that a shared gate has taken out.
    on_frame : callable
        Called with the index of each finished frame.
    blas_threads : int
        Threads of the linear algebra. The matrices are small, and NumPy and SciPy each have a pool of
        their own: with more than one, the two mostly wait for each other.

    Returns
    -------
    Run
        Marked incomplete, with the error's text and all frames up to it, if the estimator failed.
    """
    refused = np.zeros(sequence.observations, bool) if refused is None else refused
    used, gated = np.zeros(sequence.observations, bool), np.zeros(sequence.observations, bool)
    records: list[StepRecord] = []
    step_time: list[float] = []
    error, estimate = "", None
    with threadpool_limits(blas_threads), PeakMemory() as memory:
        started = time.perf_counter()
        try:
            for frame in sequence.frames(sigma):
                rows = slice(sequence.offset[frame.k], sequence.offset[frame.k + 1])
                before = time.perf_counter()
                record = estimator.process(frame, refused[rows])
                step_time.append(time.perf_counter() - before)
                records.append(record)
                used[rows], gated[rows] = record.used, record.gated
                on_frame(frame.k)
            estimate = estimator.finalize()
            if estimate.fused is not None:
                used = sequence.mask_of(*estimate.fused)
        except (ArithmeticError, RuntimeError, ValueError, np.linalg.LinAlgError) as failure:
            text = next((line for line in str(failure).splitlines() if line.strip()), "")
            error = f"frame {len(records)}: {type(failure).__name__}: {text}"
        total = time.perf_counter() - started
    causal = np.array([record.world_T_imu for record in records]).reshape(-1, 4, 4)
    causal_cov = _stack([record.pose_cov for record in records], (6, 6))
    poses, pose_cov = causal, causal_cov
    if estimate is not None and not np.array_equal(estimate.world_T_imu, causal):
        poses = estimate.world_T_imu
        pose_cov = np.full_like(causal_cov, np.nan) if estimate.pose_cov is None else estimate.pose_cov
    done = len(records)
    return Run(
        name=name,
        error=error,
        frames_expected=len(sequence),
        frame=np.arange(done),
        stamp=np.array(sequence.stamp[:done]),
        world_T_imu=poses,
        world_T_imu_causal=causal,
        pose_cov=pose_cov,
        pose_cov_causal=causal_cov,
        bias=_stack([record.bias for record in records], (6,)),
        bias_sigma=_stack([record.bias_sigma for record in records], (6,)),
        nis=np.array([record.nis for record in records]),
        dof=np.array([record.dof for record in records], dtype=np.int64),
        log_likelihood=np.array([record.log_likelihood for record in records]),
        world_gained=_stack([record.world_gained for record in records], (6,)),
        step_time=np.array(step_time),
        total_time=total,
        peak_rss=memory.peak,
        used=used,
        gated=gated,
        track=np.empty(0, np.int64) if estimate is None else estimate.track,
        points_world=np.empty((0, 3)) if estimate is None else estimate.points_world,
        points_cov=None if estimate is None else estimate.points_cov,
        counts={} if estimate is None else estimate.counts,
        events=() if estimate is None else estimate.events,
        fit=None if estimate is None else estimate.fit,
        **({} if estimate is None or estimate.up is None else {"up": estimate.up}),
    )


def _stack(parts: list[Array | None], shape: tuple[int, ...]) -> Array:
    """Stack what is there; NaN where an estimator gave nothing."""
    nothing = np.full(shape, np.nan)
    return np.array([nothing if part is None else part for part in parts]).reshape(-1, *shape)
