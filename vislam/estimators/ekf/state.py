"""The joint state of the filter: mean, covariance, and the steps it has taken."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vislam.base.errors import DivergedError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.estimators.ekf.layout import COORDINATES, LANDMARK, NavLayout
from vislam.estimators.ekf.linear import Append, Correction, Keep, Move, Reset, Step
from vislam.estimators.ekf.parametrisation import Parametrisation
from vislam.estimators.ekf.propagation import Propagation
from vislam.geometry import se3
from vislam.models.odometry import POSE

ErrorForm = Literal["standard", "fej", "invariant"]


@dataclass(frozen=True)
class Marginalised(Step):
    """Landmarks before they are marginalised, to be smoothed in the backward pass.

    Attributes
    ----------
    track : (n,)
    q : (n, 3)
        Their coordinates.
    anchors : (n, 4, 4)
    rows : (n, 3, d)
        Covariance of their coordinates with the state; in a record, with what stays of it.
    cov : (n, 3, 3)
    """

    track: IntArray
    q: Array
    anchors: Array
    rows: Array
    cov: Array


@dataclass(frozen=True)
class PoseRows(Step):
    """The pose at a frame, to be smoothed in the backward pass.

    Attributes
    ----------
    world_T_imu : (4, 4)
    rows : (6, d)
        Its covariance with the whole state.
    """

    world_T_imu: Array
    rows: Array


class JointState:
    """Pose, navigation parameters and landmarks with their joint covariance.

    The error is ordered (navigation, landmark 0, landmark 1, ...): pose (omega, v) on the right, everything
    else additive. What a correction makes of these coordinates is the difference between the error forms:

    * ``standard``: nothing, as in every textbook EKF.
    * ``fej``: the error of pose and velocity keeps its meaning in the world, and Jacobians are
      taken at ``first``. Huang, Mourikis, Roumeliotis, *A first-estimates Jacobian EKF for improving SLAM
      consistency* (ISER 2008).
    * ``invariant``: errors keep their meaning as a rigid motion of pose and landmarks together, and what each
      landmark is off beside it; so what cannot be observed (where the world is) stays one and the same
      subspace. Barrau and Bonnabel, *An EKF-SLAM algorithm with consistency properties* (2015), in the
      coordinates of any parametrisation. Of a landmark that has left this changes nothing. A velocity in the
      state moves along: the group is then that of pose, velocity and points, SE_{2+n}(3) (Barrau and
      Bonnabel, *The invariant extended Kalman filter as a stable observer*, IEEE TAC 62 (2017)), the biases
      beside it.

    Attributes
    ----------
    layout : NavLayout
        Blocks of the navigation state.
    world_T_imu : (4, 4)
    nav : (d_nav,)
        Navigation state but for the pose, whose numbers are not used.
    track : (n,)
        Ids of the landmarks.
    anchors : (n, 4, 4)
    landmarks, first : (n, 4)
        Landmarks as estimated now, and as first estimated.
    seen_at : (n,)
        Frame in which each was in view last.
    cov : (d_nav + s n, d_nav + s n)
        Of the error, s being the layout's size of a landmark.
    steps : list of Step or None
        Where steps are noted for the backward pass.
    """

    def __init__(
        self,
        parametrisation: Parametrisation,
        form: ErrorForm,
        layout: NavLayout,
        *,
        nav: Array,
        cov: Array,
        world_T_imu: Array | None = None,
    ) -> None:
        self.parametrisation = parametrisation
        self.layout = layout
        self.form = form
        self.world_T_imu: Array = np.eye(4) if world_T_imu is None else world_T_imu
        self.nav = nav.copy()
        self.track: IntArray = np.empty(0, np.int64)
        self.anchors: Array = np.empty((0, 4, 4))
        self.landmarks: Array = np.empty((0, LANDMARK))
        self.first: Array = np.empty((0, LANDMARK))
        self.seen_at: IntArray = np.empty(0, np.int64)
        self.cov = cov
        self.steps: list[Step] | None = None

    def copy(self) -> "JointState":
        """Return a state that shares no memory which either would write to, and that notes no steps."""
        other = JointState(self.parametrisation, self.form, self.layout, nav=self.nav, cov=self.cov.copy())
        other.world_T_imu, other.track, other.anchors = self.world_T_imu, self.track, self.anchors
        other.landmarks, other.first = self.landmarks, self.first
        other.seen_at = self.seen_at
        return other

    @property
    def nbytes(self) -> int:
        """Memory of the state [bytes]."""
        arrays = (self.cov, self.anchors, self.landmarks, self.first, self.track)
        return sum(array.nbytes for array in arrays)

    @property
    def linearised_at(self) -> Array:
        """Landmarks ``(n, 4)`` at which the ``fej`` form takes Jacobians."""
        return np.column_stack([self.first[:, :3], self.landmarks[:, 3]])

    def bias_variances(self, slots: IntArray) -> Array:
        """Variances ``(n,)`` of stereo-matching biases of landmarks; 0 where they are not in the error."""
        if self.layout.landmark < LANDMARK:
            return np.zeros(len(slots))
        return self.cov.diagonal()[self.layout.size :].reshape(-1, LANDMARK)[slots, -1]

    def of_landmarks(self, error: Array) -> Array:
        """Part of an error ``(d,)`` that is that of the landmarks, ``(n, 4)``."""
        out = np.zeros((len(self.track), LANDMARK))
        out[:, : self.layout.landmark] = error[self.layout.size :].reshape(-1, self.layout.landmark)
        return out

    def predict(self, step: Propagation) -> None:
        """Take a step of the model of motion."""
        self.world_T_imu = self.world_T_imu @ step.prev_T_next
        self.nav = self.nav + step.change
        move = Move(step.transition)
        move.forward(self.cov, step.noise)
        self.note(move)

    def see(self, slots: IntArray, frame: int) -> None:
        """Note that some landmarks are in view of a frame."""
        self.seen_at = self.seen_at.copy()
        self.seen_at[slots] = frame

    def add_drift(self, slots: IntArray, noise: Array) -> None:
        """Let coordinates of some landmarks walk by steps of covariance ``(n, 3, 3)``: their tracks drift."""
        nav, size = self.layout.size, self.layout.landmark
        rows = nav + size * slots[:, None] + np.arange(COORDINATES)
        self.cov[rows[:, :, None], rows[:, None, :]] += noise

    def correct(self, update: Correction) -> None:
        """Take an update.

        Raises
        ------
        DivergedError
            If a variance is negative afterwards.
        """
        update.forward(self.cov)
        if not self.cov.diagonal().min() >= 0.0:
            smallest = float(np.linalg.eigvalsh(self.cov)[0]) if np.isfinite(self.cov).all() else np.nan
            raise DivergedError(f"covariance lost, smallest eigenvalue {smallest:.3g}")
        self.note(update)
        reset = self._retract(update.correction)
        if reset is not None:
            reset.forward(self.cov)
            self.note(reset)

    def append(
        self,
        track: IntArray,
        anchors: Array,
        landmarks: Array,
        *,
        by_nav: Array,
        noise: Array,
        seen_at: int,
    ) -> None:
        """Append landmarks that are functions of the navigation state.

        Parameters
        ----------
        track : (n,)
        anchors : (n, 4, 4)
        landmarks : (n, 4)
        by_nav : (n, s, c)
            By the first c components of the navigation state; they are no functions of the others.
        noise : (n, s, s)
            Covariances for a known navigation state.
        seen_at : int
            The frame.
        """
        step = Append(by_nav.reshape(-1, by_nav.shape[2]))
        self.cov = step.forward(self.cov, noise)
        self.note(step)
        self.track = np.concatenate([self.track, track])
        self.anchors = np.concatenate([self.anchors, anchors])
        self.landmarks = np.concatenate([self.landmarks, landmarks])
        self.first = np.concatenate([self.first, landmarks])
        self.seen_at = np.concatenate([self.seen_at, np.full(len(track), seen_at)])

    def keep(self, mask: BoolArray) -> None:
        """Marginalise the landmarks outside the mask ``(n,)``: drop their rows and columns."""
        stays = np.flatnonzero(mask)
        rows = np.ones(len(self.cov), bool)
        rows[self.layout.size :].reshape(-1, self.layout.landmark)[...] = mask[:, None]
        step, left = Keep(rows), None
        if self.steps is not None:
            # Later data speak of what has stayed alone, so its columns are all that the backward pass needs.
            left = self.marginalised(np.flatnonzero(~mask), of=step.kept)
        self.cov = step.forward(self.cov)
        self.note(step)
        if left is not None:
            self.note(left)
        self.track, self.anchors = self.track[stays], self.anchors[stays]
        self.landmarks, self.first = self.landmarks[stays], self.first[stays]
        self.seen_at = self.seen_at[stays]

    def marginalised(self, slots: IntArray, *, of: IntArray | None = None) -> "Marginalised":
        """Estimates of some landmarks before they are marginalised.

        Their covariance is that with the components ``of (d,)`` of the state; None: with all.
        """
        nav, size = self.layout.size, self.layout.landmark
        own = nav + size * slots[:, None] + np.arange(COORDINATES)
        rows = self.cov.take(own.reshape(-1), axis=0)
        if of is not None:
            rows = rows.take(of, axis=1)
        return Marginalised(
            track=self.track[slots],
            q=self.landmarks[slots, :3],
            anchors=self.anchors[slots],
            rows=rows.reshape(len(slots), COORDINATES, rows.shape[1]),
            cov=self.cov[own[:, :, None], own[:, None, :]],
        )

    def note_pose(self) -> None:
        """Record the pose, to be smoothed in the backward pass."""
        self.note(PoseRows(self.world_T_imu, self.cov[POSE].copy()))

    def _retract(self, error: Array) -> Reset | None:
        """Correct the mean; return what becomes of the coordinates of the error."""
        before, nav_before = self.world_T_imu, self.nav
        landmarks, nav = self.landmarks, self.layout.size
        self.nav = self.nav + error[:nav]
        self.world_T_imu = se3.retract(before, error[POSE])
        self.landmarks = landmarks + self.of_landmarks(error)
        if self.form == "standard":
            return None
        kept = se3.adjoint(se3.exp(-error[POSE]))
        behind = np.empty((0, 6))
        if self.layout.moves:
            behind = self.layout.moved(self.nav) - self.layout.moved(nav_before)
            behind = behind @ se3.adjoint(before)
        if self.form == "fej":
            rest = np.zeros((len(self.cov) - nav, 6))
            return Reset(kept, np.concatenate([behind, rest]) if self.layout.moves else None)
        # What a motion of the world does to the coordinates, after the correction less before it.
        q = np.array([landmarks[:, :COORDINATES], self.landmarks[:, :COORDINATES]])
        was, now = self.parametrisation.moved(q, se3.inverse(before) @ self.anchors)
        change = now - was
        if self.layout.landmark == LANDMARK:
            change = np.concatenate([change, np.zeros((len(change), 1, 6))], axis=1)
        change = change.reshape(-1, 6)
        return Reset(kept, np.concatenate([behind, change]) if self.layout.moves else change)

    def note(self, step: Step) -> None:
        """Note a step for the backward pass, if steps are noted."""
        if self.steps is not None:
            self.steps.append(step)
