"""The textbook joint filter over all landmarks, every matrix formed: the reference to read and test against.

Slow on purpose. The filter is that of Barfoot, *State Estimation for Robotics* (2017), section 4.2.3, on
SE(3) (chapter 7). Equation numbers are those of the course report (section III-D); its errors are corrected
where named.
"""

from collections.abc import Sequence

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.estimators.ekf import parametrisation
from vislam.estimators.ekf.layout import LANDMARK, NavLayout
from vislam.estimators.ekf.measurement import Camera
from vislam.estimators.ekf.state import ErrorForm
from vislam.geometry import se3
from vislam.models import odometry as motion
from vislam.models.odometry import BIAS, NAV, POSE


class DenseFilter:
    """Joint EKF without marginalisation and without a gate; poses can be kept in the state as well.

    Attributes
    ----------
    world_T_imu : (4, 4)
    bias : (6,)
    track : list of int
        All landmarks so far.
    anchors, landmarks : (m, 4, 4), (m, 4)
        In the order of ``track``; a landmark is its coordinates and its stereo-matching bias.
    past : list of (4, 4)
        Poses at the frames, each corrected by what came later; empty unless asked for.
    cov : (d, d)
        Covariance of pose, bias, and then what :attr:`place` says.
    place : dict
        Where in ``cov`` a landmark ``("landmark", track)`` or a past pose ``("pose", k)`` stands.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        error: ErrorForm = "standard",
        landmarks: parametrisation.ParametrisationName = "point",
        keep_poses: bool = False,
    ) -> None:
        self._problem = problem
        self._camera = Camera(
            problem.rig, parametrisation.make(landmarks, problem.rig), NavLayout({"twist_bias": 6})
        )
        self._form = error
        self._keep_poses = keep_poses
        self.world_T_imu = np.eye(4)
        self._nav = np.zeros(NAV)
        self.bias = problem.bias_mean.copy()
        self.track: list[int] = []
        self.anchors = np.empty((0, 4, 4))
        self.landmarks = np.empty((0, LANDMARK))
        self._first = np.empty((0, LANDMARK))
        self._in_view: set[int] = set()
        self._past: list[tuple[Array, Array]] = []
        self.cov = np.diag(np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2)
        self.place: dict[tuple[str, int], slice] = {}

    @property
    def past(self) -> list[Array]:
        """Past poses; their errors, like all errors that nothing moves, are corrected by a sum."""
        return [se3.retract(pose, correction) for pose, correction in self._past]

    def process(self, frame: Frame) -> None:
        """Predict, update with all known landmarks at once, append the new ones."""
        if frame.k > 0:
            self._predict(frame)
        self._in_view = {int(track) for track in frame.stereo.track}
        known = [row for row, track in enumerate(frame.stereo.track) if int(track) in self.track]
        if known:
            self._drift(frame, known)
            self._update(frame, known)
        for row in range(len(frame.stereo.track)):
            if int(frame.stereo.track[row]) not in self.track:
                self._append(frame, row)
        if self._keep_poses:
            self._past.append((self.world_T_imu, np.zeros(6)))
            self._grow(("pose", frame.k), np.eye(6, len(self.cov)), np.zeros((6, 6)))

    def _predict(self, frame: Frame) -> None:
        """Prediction (Barfoot, section 4.2.3; the course report's eq. 25 with the bias added)."""
        step = motion.integrate(frame.odometry.twist, bias=self.bias, dt=frame.dt, noise=self._problem.noise)
        block, noise = motion.transition(step)
        transition = np.eye(len(self.cov))
        transition[:NAV, :NAV] = block
        self.world_T_imu = self.world_T_imu @ step.prev_T_next
        self.cov = transition @ self.cov @ transition.T
        self.cov[:NAV, :NAV] += noise

    def _drift(self, frame: Frame, rows: Sequence[int]) -> None:
        """Add the tracker drift of the tracks in view, column and row."""
        for slot in self._slots(frame, rows):
            view = self._camera.view(
                self.world_T_imu, self._nav, self.anchors[[slot]], self.landmarks[[slot]]
            )
            step = view.drift_cov(self._problem.track_noise.drift)
            start = self.place["landmark", self.track[slot]].start
            self.cov[start : start + 3, start : start + 3] += step[0]

    def _update(self, frame: Frame, rows: Sequence[int]) -> None:
        """Correction (Barfoot, section 4.2.3; eqs. 28 and 29 with the sign and inverse that eq. 26 lacks)."""
        slots = self._slots(frame, rows)
        anchors, landmarks = self.anchors[slots], self.landmarks[slots]
        predicted = self._camera.view(self.world_T_imu, self._nav, anchors, landmarks).measurement()
        if self._form == "fej":
            landmarks = np.column_stack([self._first[slots, :3], landmarks[:, 3]])
        by_nav, by_landmark = self._camera.view(self.world_T_imu, self._nav, anchors, landmarks).jacobians()
        jacobian = np.zeros((3 * len(rows), len(self.cov)))
        for i, slot in enumerate(slots):
            three = slice(3 * i, 3 * i + 3)
            jacobian[three, POSE] = by_nav[i][:, POSE]
            jacobian[three, self.place["landmark", self.track[slot]]] = by_landmark[i]
        noise = np.diag(np.tile(self._problem.track_noise.sigma**2, len(rows)))
        spread = jacobian @ self.cov @ jacobian.T + noise
        gain = np.linalg.solve(spread, jacobian @ self.cov).T
        correction = gain @ (frame.stereo.z[list(rows)] - predicted).ravel()
        # Joseph's form of eq. (29), which loses symmetry as printed, and diverges over a long sequence.
        kept = np.eye(len(self.cov)) - gain @ jacobian
        self.cov = kept @ self.cov @ kept.T + gain @ noise @ gain.T
        self._retract(correction)

    def _append(self, frame: Frame, row: int) -> None:
        """Append a triangulated landmark (eq. 20), with the covariance of pose and measurement."""
        z, noise = frame.stereo.z[[row]], self._problem.track_noise
        anchors, landmarks, by_nav, by_measurement = self._camera.initialise(self.world_T_imu, self._nav, z)
        variance = np.concatenate([noise.sigma, noise.match_sigma(z[:, 0] - z[:, 1])]) ** 2
        grow = np.zeros((LANDMARK, len(self.cov)))
        grow[:, POSE] = by_nav[0][:, POSE]
        self._grow(
            ("landmark", int(frame.stereo.track[row])),
            grow,
            by_measurement[0] @ np.diag(variance) @ by_measurement[0].T,
        )
        self.track.append(int(frame.stereo.track[row]))
        self.anchors = np.concatenate([self.anchors, anchors])
        self.landmarks = np.concatenate([self.landmarks, landmarks])
        self._first = np.concatenate([self._first, landmarks])

    def _grow(self, key: tuple[str, int], grow: Array, noise: Array) -> None:
        """Append a block that is ``grow`` times the error, plus noise."""
        size = len(self.cov)
        cross = grow @ self.cov
        self.cov = np.block([[self.cov, cross.T], [cross, cross @ grow.T + noise]])
        self.place[key] = slice(size, size + len(grow))

    def _retract(self, error: Array) -> None:
        """Correct the mean, and transform the covariance to the error form at the new estimate."""
        before = self.world_T_imu
        self.world_T_imu = se3.retract(before, error[POSE])
        self.bias = self.bias + error[BIAS]
        self._past = [
            (pose, sum_ + error[self.place["pose", k]]) for k, (pose, sum_) in enumerate(self._past)
        ]
        own = np.array([error[self.place["landmark", track]] for track in self.track])
        if self._form == "standard":
            self.landmarks = self.landmarks + own
            return
        reset = np.eye(len(self.cov))
        reset[POSE, POSE] = se3.adjoint(se3.inverse(self.world_T_imu) @ before)
        shared = self._shared(before)
        self.landmarks = self.landmarks + own
        if self._form == "invariant":
            # Of a landmark that is never seen again the motion is taken where it was last seen, and does not
            # change; one that may be seen again moves along.
            for track, change in zip(self.track, self._shared(before) - shared, strict=True):
                if track in self._in_view or self._problem.kept:
                    start = self.place["landmark", track].start
                    reset[start : start + 3, POSE] = change
        self.cov = reset @ self.cov @ reset.T

    def _shared(self, pose: Array) -> Array:
        """Derivative ``(m, 3, 6)`` of the coordinates by a motion of the world, as an error of the pose."""
        imu_to_anchor = se3.adjoint(se3.inverse(self.anchors) @ pose)
        in_anchor = self._camera.parametrisation.moved(self.landmarks[:, :3], np.eye(4))
        return in_anchor @ imu_to_anchor

    def _slots(self, frame: Frame, rows: Sequence[int]) -> list[int]:
        return [self.track.index(int(frame.stereo.track[row])) for row in rows]
