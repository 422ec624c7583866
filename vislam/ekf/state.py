"""The joint state of the filter: mean, covariance, and the steps it has taken."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vislam.ekf.chart import Chart
from vislam.ekf.layout import LANDMARK, NAV, SHARED
from vislam.ekf.linear import Append, Keep, Move, Reset, Step, Update
from vislam.errors import DivergedError
from vislam.geometry import se3
from vislam.motion import POSE
from vislam.types import Array, BoolArray, IntArray

ErrorForm = Literal["standard", "first_estimates", "invariant"]


@dataclass(frozen=True)
class Farewell(Step):
    """Landmarks about to leave the state: what later data say about them is asked for on the way back.

    Their errors are those of their own: from now on nothing changes these but what is learnt.

    Attributes
    ----------
    track : (n,)
    q : (n, 3)
        Their coordinates, less what they share with all others that have left.
    anchors : (n, 4, 4)
        Their anchors before all corrections, so that ``world_motion`` takes them to where they are.
    rows : (n, 3, d)
        Covariance of their own errors with the whole state.
    cov : (n, 3, 3)
        Covariances of their own errors.
    moved : (n, 3, 6)
        Derivative of the coordinates by what they share (``SHARED``); zero but for ``invariant``.
    """

    track: IntArray
    q: Array
    anchors: Array
    rows: Array
    cov: Array
    moved: Array


@dataclass(frozen=True)
class PoseRows(Step):
    """The pose at a frame, which later data are asked about on the way back.

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
    * ``first_estimates``: the pose error keeps its meaning in the world, and Jacobians are taken at
      ``first``. Huang, Mourikis, Roumeliotis, *A first-estimates Jacobian EKF for improving SLAM
      consistency* (ISER 2008).
    * ``invariant``: error and correction are those of a rigid motion of pose, anchors and landmarks together,
      after which each landmark still has an error of its own; so what cannot be observed (where the world
      is) stays one and the same subspace. Barrau and Bonnabel, *An EKF-SLAM algorithm with consistency
      properties* (2015), in coordinates of any chart.

    Attributes
    ----------
    world_T_imu : (4, 4)
    nav : (NAV,)
        Navigation parameters; those of the pose are not used.
    track : (n,)
        Ids of the landmarks.
    anchors : (n, 4, 4)
    landmarks, first : (n, 4)
        Landmarks as estimated now, and as first estimated.
    cov : (NAV + 4n, NAV + 4n)
    world_motion : (4, 4)
        What all corrections together have moved the anchors by; the identity but for ``invariant``.
    shared : (6,)
        Correction of landmarks that have left, beyond those of their own errors (``SHARED``).
    steps : list of Step or None
        Where steps are noted for the way back.
    """

    def __init__(self, chart: Chart, form: ErrorForm, *, nav: Array, sigma: Array) -> None:
        self.chart = chart
        self.form = form
        self.world_T_imu = np.eye(4)
        self.nav = nav.copy()
        self.track: IntArray = np.empty(0, np.int64)
        self.anchors: Array = np.empty((0, 4, 4))
        self.landmarks: Array = np.empty((0, LANDMARK))
        self.first: Array = np.empty((0, LANDMARK))
        self.cov: Array = np.diag(sigma**2)
        self.world_motion: Array = np.eye(4)
        self.shared: Array = np.zeros(6)
        self.steps: list[Step] | None = None

    def copy(self) -> "JointState":
        """Return a state that shares no memory which either would write to, and that notes no steps."""
        other = JointState(self.chart, self.form, nav=self.nav, sigma=np.zeros(NAV))
        other.world_T_imu, other.track, other.anchors = self.world_T_imu, self.track, self.anchors
        other.landmarks, other.first, other.cov = self.landmarks, self.first, self.cov.copy()
        other.world_motion, other.shared = self.world_motion, self.shared
        return other

    @property
    def nbytes(self) -> int:
        """Memory of the state [bytes]."""
        arrays = (self.cov, self.anchors, self.landmarks, self.first, self.track)
        return sum(array.nbytes for array in arrays)

    @property
    def linearised_at(self) -> Array:
        """Landmarks ``(n, 4)`` at which Jacobians are taken."""
        if self.form != "first_estimates":
            return self.landmarks
        return np.column_stack([self.first[:, :3], self.landmarks[:, 3]])

    def variances(self) -> Array:
        """Variances of the landmarks' coordinates, ``(n, 4)``."""
        return np.diagonal(self.cov)[NAV:].reshape(-1, LANDMARK)

    def predict(self, prev_T_next: Array, transition: Array, noise: Array) -> None:
        """Move the pose by a step; ``F`` and ``Q`` are ``(NAV, NAV)``."""
        self.world_T_imu = self.world_T_imu @ prev_T_next
        move = Move(transition)
        move.forward(self.cov, noise)
        self._note(move)

    def wander(self, noise: Array) -> None:
        """Let the landmarks' coordinates walk by steps of covariance ``(n, 3, 3)``: their tracks drift."""
        n = len(self.track)
        each = np.arange(n)
        blocks = self.cov[NAV:, NAV:].reshape(n, LANDMARK, n, LANDMARK)
        blocks[each, :3, each, :3] += noise

    def correct(self, update: Update) -> None:
        """Take an update.

        Raises
        ------
        DivergedError
            If a variance is negative afterwards.
        """
        update.forward(self.cov)
        if not np.diagonal(self.cov).min() >= 0.0:
            smallest = float(np.linalg.eigvalsh(self.cov)[0]) if np.isfinite(self.cov).all() else np.nan
            raise DivergedError(f"covariance lost, smallest eigenvalue {smallest:.3g}")
        self._note(update)
        reset = self._retract(update.correction)
        if reset is not None:
            reset.forward(self.cov)
            self._note(reset)

    def seen_after(self, correction: Array) -> tuple[Array, Array]:
        """Pose ``(4, 4)`` and change of the landmarks ``(n, 4)`` that look as a correction would have it.

        That of the ``invariant`` form moves pose and anchors together, which nothing can be seen of.
        """
        own = correction[NAV:].reshape(-1, LANDMARK)
        if self.form != "invariant":
            return se3.retract(self.world_T_imu, correction[POSE]), own
        own = own.copy()
        own[:, :3] -= self._moved() @ correction[POSE]
        return self.world_T_imu, own

    def by_pose_before(self, correction: Array, by_pose: Array, by_coordinates: Array) -> Array:
        """Derivative ``(n, m, 6)`` of measurements by the pose error before a correction from that after."""
        if self.form == "invariant":
            return -by_coordinates @ self._moved()
        return by_pose @ se3.right_jacobian(correction[POSE])

    def append(
        self, track: IntArray, anchors: Array, landmarks: Array, *, by_nav: Array, noise: Array
    ) -> None:
        """Append landmarks that are functions of the navigation state.

        Parameters
        ----------
        track : (n,)
        anchors : (n, 4, 4)
        landmarks : (n, 4)
        by_nav : (n, 4, NAV)
        noise : (n, 4, 4)
            Covariances for a known navigation state.
        """
        step = Append(by_nav.reshape(-1, NAV))
        self.cov = step.forward(self.cov, noise)
        self._note(step)
        self.track = np.concatenate([self.track, track])
        self.anchors = np.concatenate([self.anchors, anchors])
        self.landmarks = np.concatenate([self.landmarks, landmarks])
        self.first = np.concatenate([self.first, landmarks])

    def keep(self, mask: BoolArray) -> None:
        """Marginalise the landmarks outside the mask ``(n,)``: their rows and columns go."""
        if self.steps is not None:
            self.steps.append(self.farewell(np.flatnonzero(~mask)))
        step = Keep(np.concatenate([np.ones(NAV, bool), np.repeat(mask, LANDMARK)]))
        self.cov = step.forward(self.cov)
        self._note(step)
        self.track, self.anchors = self.track[mask], self.anchors[mask]
        self.landmarks, self.first = self.landmarks[mask], self.first[mask]

    def farewell(self, slots: IntArray) -> "Farewell":
        """What is known of some landmarks now."""
        rows = self.cov[NAV:].reshape(-1, LANDMARK, len(self.cov))[slots, :3]
        q, anchors = self.landmarks[slots, :3], self.anchors[slots]
        moved = np.zeros((len(slots), 3, 6))
        if self.form == "invariant":
            anchors = se3.inverse(self.world_motion) @ anchors
            moved = self.chart.moved(q) @ se3.adjoint(se3.inverse(anchors))
            q = q - moved @ self.shared
            rows = rows - moved @ self.cov[SHARED]
        columns = NAV + LANDMARK * slots[:, None] + np.arange(3)
        cov = np.take_along_axis(rows, columns[:, None, :], axis=2)
        cov = cov - rows[:, :, SHARED] @ moved.transpose(0, 2, 1)
        return Farewell(self.track[slots], q, anchors, rows, cov, moved)

    def note_pose(self) -> None:
        """Note that later data shall tell what the pose is now."""
        self._note(PoseRows(self.world_T_imu, self.cov[POSE].copy()))

    def _retract(self, error: Array) -> Reset | None:
        """Correct the mean; return what becomes of the coordinates of the error."""
        before = self.world_T_imu
        own = error[NAV:].reshape(-1, LANDMARK)
        self.nav = self.nav + error[:NAV]
        if self.form != "invariant":
            self.world_T_imu = se3.retract(before, error[POSE])
            self.landmarks = self.landmarks + own
            if self.form == "standard":
                return None
            return Reset(se3.adjoint(se3.inverse(self.world_T_imu) @ before), None)
        moved_before = self._moved()
        own = own.copy()
        own[:, :3] -= moved_before @ error[POSE]
        # T exp(e) = exp(Ad(T) e) T: a motion in the world, which the anchors take part in.
        self.world_T_imu = se3.retract(before, error[POSE])
        motion = self.world_T_imu @ se3.inverse(before)
        motion_before = self.world_motion
        self.anchors = motion @ self.anchors
        self.world_motion = motion @ motion_before
        self.landmarks = self.landmarks + own
        reset = se3.adjoint(se3.inverse(self.world_T_imu) @ before)
        others = np.zeros((len(self.cov) - 6, 6))
        blocks = others[NAV - 6 :].reshape(-1, LANDMARK, 6)
        blocks[:, :3] = self._moved() @ reset - moved_before
        in_first_world = se3.adjoint(se3.inverse(motion_before) @ before)
        self.shared = self.shared + error[SHARED] - in_first_world @ error[POSE]
        others[SHARED.start - 6 : SHARED.stop - 6] = (
            se3.adjoint(se3.inverse(self.world_motion) @ self.world_T_imu) @ reset - in_first_world
        )
        return Reset(reset, others)

    def _moved(self) -> Array:
        """Derivative ``(n, 3, 6)`` of the coordinates by a motion of the world, as an error of the pose."""
        imu_to_anchor = se3.adjoint(se3.inverse(self.anchors) @ self.world_T_imu)
        return self.chart.moved(self.landmarks[:, :3]) @ imu_to_anchor

    def _note(self, step: Step) -> None:
        if self.steps is not None:
            self.steps.append(step)
