"""The state of the filter: navigation state and a window of past poses, with their joint covariance."""

import numpy as np

from vislam.base.errors import DivergedError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.linear import Jacobian, Keep, Move, Update
from vislam.estimators.ekf.observability import unit_motions
from vislam.estimators.ekf.propagation import Propagation
from vislam.estimators.msckf.options import ErrorForm
from vislam.geometry import se3
from vislam.models.odometry import POSE

_SIZE = POSE.stop - POSE.start
_NO_LANDMARK = np.empty((0, 3, 4))
_NO_SLOT = np.empty(0, np.int64)


class Window:
    """Navigation state and past poses (clones).

    The error is ordered (navigation, clone 0, clone 1, ...), oldest clone first; a pose's is (omega, v) on
    its right. The current pose is that of the navigation state and has no clone, so the covariance is
    regular.

    Attributes
    ----------
    nav : (d_nav,)
        Navigation state but for the pose, whose numbers are not used.
    frames : (m + 1,)
        Frames of the poses, the current one last.
    poses : (m + 1, 4, 4)
        ``world_T_imu`` at these frames.
    first : (m + 1, 4, 4)
        The same as first estimated: predicted, before any observation of their frame.
    cov : (d, d)
        ``d = d_nav + 6 m``.
    directions : (d, 6)
        The errors that unit motions (omega, v) of the world, in the first pose's frame, are in the
        coordinates of the state. No observation tells of them.
    """

    def __init__(
        self,
        layout: NavLayout,
        form: ErrorForm,
        *,
        nav: Array,
        cov: Array,
        world_T_imu: Array | None = None,
    ) -> None:
        pose = np.eye(4) if world_T_imu is None else world_T_imu
        self.layout = layout
        self.form = form
        self.nav = nav.copy()
        self.frames: IntArray = np.zeros(1, np.int64)
        self.poses: Array = pose[None].copy()
        self.first: Array = pose[None].copy()
        self.cov = cov
        self.directions = unit_motions(layout, pose, nav)
        # The navigation state as predicted last, before any observation.
        self._first_nav = self.nav

    @property
    def columns(self) -> IntArray:
        """Where the error of each pose starts, ``(m + 1,)``."""
        clones = self.layout.size + _SIZE * np.arange(len(self.poses) - 1)
        return np.append(clones, POSE.start)

    @property
    def linearised_at(self) -> Array:
        """Poses ``(m + 1, 4, 4)`` at which Jacobians are evaluated."""
        return self.first if self.form == "fej" else self.poses

    def pose_cov(self, place: int) -> Array:
        """Covariance ``(6, 6)`` of the pose at a place of :attr:`poses`."""
        own = slice(self.columns[place], self.columns[place] + _SIZE)
        return self.cov[own, own].copy()

    def clone(self) -> None:
        """Append a clone of the current pose to the past ones (Mourikis and Roumeliotis, eqs. 14 to 16)."""
        rows = np.append(np.arange(len(self.cov)), np.arange(POSE.start, POSE.stop))
        self.cov = self.cov.take(rows, axis=0).take(rows, axis=1)
        self.directions = self.directions[rows]
        self.poses = np.concatenate([self.poses, self.poses[-1:]])
        self.first = np.concatenate([self.first, self.first[-1:]])
        self.frames = np.append(self.frames, self.frames[-1])

    def predict(self, step: Propagation, frame: int) -> None:
        """Take the current pose, a clone of which is behind it, to another frame by the model of motion."""
        before, pose = self.poses[-1].copy(), self.poses[-1] @ step.prev_T_next
        transition = step.transition
        if self.form == "fej":
            # From the first estimate of one pose to that of the next: a motion of the world stays one.
            transition = transition @ self._from_first(before)
        self.nav = self._first_nav = self.nav + step.change
        self.poses[-1] = self.first[-1] = pose
        self.frames[-1] = frame
        Move(transition).forward(self.cov, step.noise)
        self.directions[: self.layout.size] = transition @ self.directions[: self.layout.size]

    def correct(self, jacobian: Array, innovation: Array, variance: Array) -> Update:
        """Fuse a linear measurement of the error.

        Parameters
        ----------
        jacobian : (m, d)
        innovation : (m,)
        variance : (m,)

        Raises
        ------
        DivergedError
            If a variance is negative afterwards.
        """
        h = Jacobian(jacobian, _NO_LANDMARK, _NO_SLOT, nav=jacobian.shape[1])
        projected = jacobian @ self.cov
        spread = projected @ jacobian.T
        spread.reshape(-1)[:: len(spread) + 1] += variance
        update = Update.of(h, projected, spread, innovation)
        update.forward(self.cov)
        if not np.diagonal(self.cov).min() >= 0.0:
            smallest = float(np.linalg.eigvalsh(self.cov)[0]) if np.isfinite(self.cov).all() else np.nan
            raise DivergedError(f"covariance lost, smallest eigenvalue {smallest:.3g}")
        self._retract(update.correction)
        return update

    def keep(self, mask: BoolArray) -> None:
        """Marginalise the clones outside the mask ``(m,)``: their rows and columns go."""
        rows = np.concatenate([np.ones(self.layout.size, bool), np.repeat(mask, _SIZE)])
        self.cov = Keep(rows).forward(self.cov)
        self.directions = self.directions[rows]
        stays = np.append(mask, True)
        self.poses, self.first, self.frames = self.poses[stays], self.first[stays], self.frames[stays]

    def _from_first(self, now: Array) -> Array:
        """Errors ``(d_nav, d_nav)`` at the current estimates from those at the first, alike in the world."""
        first, moved = self.first[-1], self.layout.moved
        out = np.eye(self.layout.size)
        out[POSE, POSE] = se3.adjoint(se3.inverse(now) @ first)
        out[POSE.stop :, POSE] = (moved(self.nav) - moved(self._first_nav)) @ se3.adjoint(first)
        return out

    def _retract(self, error: Array) -> None:
        """Correct the mean; in the invariant form, the coordinates of the error keep their meaning."""
        before, nav_before = self.poses, self.nav
        each = self.columns[:, None] + np.arange(_SIZE)
        self.nav = self.nav + error[: self.layout.size]
        self.poses = se3.retract(before, error[each])
        if self.form != "invariant":
            return
        if self.layout.moves:
            behind = self.layout.moved(self.nav) - self.layout.moved(nav_before)
            behind, rows = behind @ se3.adjoint(before[-1]), slice(POSE.stop, self.layout.size)
            self.cov[rows] += behind @ self.cov[POSE]
            self.cov[:, rows] += self.cov[:, POSE] @ behind.T
            self.directions[rows] += behind @ self.directions[POSE]
        kept = se3.adjoint(se3.inverse(self.poses) @ before)
        self.cov[each] = kept @ self.cov[each]
        self.cov[:, each] = np.einsum("dmj,mij->dmi", self.cov[:, each], kept)
        self.directions[each] = kept @ self.directions[each]
