"""What an estimator answers: a step at each frame, and all that it knows in the end."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.trajectory import Landmarks, Poses

TWIST_BIAS = "twist_bias"
"""Name of the state ``(6,)`` that is the bias of the inertial twist (omega, v) [rad/s, m/s]."""


@dataclass(frozen=True)
class State:
    """A part of the state beside pose and landmarks, at one time.

    Attributes
    ----------
    value : (m,)
    sigma : (m,) or None
        Its estimated standard deviation; None, or NaN throughout, where it is not known at this time.
    """

    value: Array
    sigma: Array | None = None


@dataclass(frozen=True)
class Step:
    """What an estimator knows at a frame; all but the pose may be left out.

    Attributes
    ----------
    pose : (4, 4)
        ``world_T_imu``.
    pose_cov : (6, 6) or None
        Covariance (omega, v) of the pose, on its right [rad^2, m^2].
    states : mapping of str to State
        What else is estimated, by short names; the size of each stays what it is. ``twist_bias`` is scored
        against the true one where that is known.
    nis, dof : float, int
        Normalised innovation squared of the accepted observations and its degrees of freedom.
    log_likelihood : float
        Logarithm of the density of their innovations; NaN where the estimator does not have it.
    used : (n,) or None
        Which of the frame's observations were fused, as far as is known at the frame; None: none was.
    gated : (n,) or None
        Which of them the estimator itself rejected; None: none.
    spurious_information : (6,) or None
        Information that the step gained on motions (omega, v) of the world, by the estimator's own Jacobians:
        more than none is spurious [1/rad^2, 1/m^2]. None where it is not measured.
    """

    pose: Array
    pose_cov: Array | None = None
    states: Mapping[str, State] = field(default_factory=dict)
    nis: float = 0.0
    dof: int = 0
    log_likelihood: float = float("nan")
    used: BoolArray | None = None
    gated: BoolArray | None = None
    spurious_information: Array | None = None


@dataclass(frozen=True)
class Final:
    """What an estimator knows in the end; all may be left out.

    Attributes
    ----------
    trajectory : Poses or None
        None: the poses are those of the steps.
    map : Landmarks or None
    fused : tuple of (m,), (m,) or None
        Frame index and track id of every observation that the estimate rests on, in any order; None where
        the ``used`` of the steps is the last word. For who fuses observations of earlier frames, or takes
        some out again.
    gated : tuple of (m,), (m,) or None
        The same of the observations that the estimator itself rejected, at whatever frame it did so; None
        where the ``gated`` of the steps is the last word.
    counts : dict
        What was dropped, waited for, recovered from.
    events : tuple of str
        One line for each thing out of the ordinary that it had to do, such as a recovery of the solver.
    up : (3,) or None
        Direction of up in the world; None if not estimated.
    fit : tuple of float, int or None
        Sum of the squares of all residuals of the estimate, each by its noise, and how many more there are
        than unknowns; None where that is no chi-square number.
    lagged : mapping of int to Poses
        All poses as known so many frames later, or at the end if that comes before, at the lags that the
        problem asks for. Empty from who cannot tell.
    """

    trajectory: Poses | None = None
    map: Landmarks | None = None
    fused: tuple[IntArray, IntArray] | None = None
    gated: tuple[IntArray, IntArray] | None = None
    counts: dict[str, int] = field(default_factory=dict)
    events: tuple[str, ...] = ()
    up: Array | None = None
    fit: tuple[float, int] | None = None
    lagged: Mapping[int, Poses] = field(default_factory=dict)
