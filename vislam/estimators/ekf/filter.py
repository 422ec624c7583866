"""EKF SLAM, one frame at a time: marginalise, predict, gate, update, initialise."""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.distributions import chi2_quantile
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core import trajectory
from vislam.core.estimator import Problem, shared_information
from vislam.core.frame import Frame
from vislam.core.step import Final, Step
from vislam.estimators.ekf import backward, motion, parametrisation
from vislam.estimators.ekf.backward import Landmarks, Recorder, Smoothed
from vislam.estimators.ekf.lagged import LastPoses
from vislam.estimators.ekf.layout import COORDINATES, LANDMARK
from vislam.estimators.ekf.linear import Correction, Jacobian, Update, diagonal_blocks, squared_distances
from vislam.estimators.ekf.measurement import Camera, View
from vislam.estimators.ekf.observability import Unobservable
from vislam.estimators.ekf.observed import ObservedUpdate
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.ekf.propagation import reported
from vislam.estimators.ekf.reweighting import student_weights
from vislam.estimators.ekf.state import JointState
from vislam.geometry import se3
from vislam.models import TrackNoise
from vislam.models.kernel import kernel_name
from vislam.models.odometry import POSE

_CONVERGED = 1e-3
"""Iterations end when no component of the correction changes by more than this share of its deviation."""

_LOG_2_PI = float(np.log(2.0 * np.pi))


class EkfEstimator:
    """Joint EKF over navigation state and the landmarks in view (Barfoot 2017, section 4.2.3).

    A landmark is marginalised when its track ends. It is not observed again, so marginalising it does not
    change the remaining state; its smoothed estimate is recovered by the backward pass. Where landmarks are
    seen again, those out of view that are remembered stay in the state. Course report, section III-D.

    Attributes
    ----------
    state : JointState

    Parameters
    ----------
    problem : Problem
    options : EkfOptions
    noted : bool
        Keep the linear steps of the last frame in ``state.steps``.
    """

    def __init__(self, problem: Problem, options: EkfOptions, *, noted: bool = False) -> None:
        self._problem = problem
        self._noted = noted
        self._options = options
        self._independent = options.track_errors == "independent"
        self._track_noise = TrackNoise(0.0, 0.0, 0.0) if self._independent else problem.track_noise
        self._threshold = float(chi2_quantile(problem.gate_probability, 3)) if options.gate else np.inf
        self._motion = motion.make(problem)
        self.upright = problem.imu is not None
        self._nearest = problem.rig.nearest
        # Without a matching bias, a landmark is its coordinates: three quarters of the rows and columns.
        landmark = COORDINATES if self._independent else LANDMARK
        start = motion.navigation(problem, self._motion, landmark=landmark)
        self._layout = start.layout
        self._no_landmark, self._no_slot = np.empty((0, 3, landmark)), np.empty(0, np.int64)
        self._camera = Camera(problem.rig, parametrisation.make(options.landmarks, problem.rig), start.layout)
        self.state = JointState(
            self._camera.parametrisation,
            options.error,
            start.layout,
            nav=start.nav,
            cov=start.cov,
            world_T_imu=start.world_T_imu,
        )
        self._recorder: Recorder | None = None
        self._filtered_map = options.marginalised_landmarks == "filtered"
        if not self._filtered_map:
            self._recorder = Recorder(self._advance, memory=int(1e6 * options.memory_mb))
        self._meter = None
        if options.observability:
            self._meter = Unobservable(start.layout, start.world_T_imu, start.nav)
        self._last = None if problem.lags is None else LastPoses(problem.lags)
        self.information = {
            "noise of the tracks": "independent"
            if self._independent
            else "drift and stereo-matching bias as states",
            "kernel": kernel_name(problem.kernel),
            **shared_information(problem, estimated=list(start.layout)),
            **self._motion.information,
        }
        self._left: list[Landmarks] = []
        self._matches: list[tuple[IntArray, Array, Array]] = []
        self._match = (self.state.track, self.state.track, self.state.track)
        self._not_converged: set[int] = set()

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        if frame.keyframe:
            self._record_marginalised(self._staying(self.state, self._matched(self.state, frame)))
        if self._recorder is not None:
            record = self._recorder.take(self.state, frame)
            steps = self._recorder.latest
        else:
            steps = []
            noted = self._noted or self._meter is not None or self._last is not None
            self.state.steps = steps if noted else None
            record = self._advance(self.state, frame)
        if self._last is not None:
            self._last.follow(steps, self.state)
        return (
            record if self._meter is None else replace(record, spurious_information=self._meter.follow(steps))
        )

    def finalize(self) -> Final:
        """Return the poses, causal or smoothed, and the landmarks, by default smoothed."""
        self._record_marginalised(np.zeros(len(self.state.track), bool))
        poses, counts = None, {}
        if self._problem.kernel is not None:
            counts["reweightings_not_converged"] = len(self._not_converged)
        lagged = {} if self._last is None else self._last.poses()
        if self._filtered_map:
            landmarks = Landmarks.join(self._left[::-1])
        else:
            assert self._recorder is not None
            found = self.smooth()
            landmarks = found.landmarks
            counts["frames_computed_again"] = self._recorder.again
            every = trajectory.Poses(found.world_T_imu, found.pose_cov)
            poses = every if self._options.smoothed else None
            if lagged:
                lagged[len(every) - 1] = every
        return Final(
            trajectory=poses,
            map=trajectory.Landmarks(landmarks.track, landmarks.points_world, landmarks.points_cov),
            counts=counts,
            up=self._motion.up(self._layout, self.state.nav),
            lagged=lagged,
        )

    def smooth(self) -> Smoothed:
        """Backward pass over all steps; not with ``marginalised_landmarks: filtered``."""
        assert self._recorder is not None
        return backward.smooth(self.state, self._recorder)

    def matching_biases(self) -> tuple[IntArray, Array, Array]:
        """Tracks that have ended, their stereo-matching biases and the variances of these, ``(m,)`` each."""
        track, bias, variance = zip(*self._matches, strict=True)
        return np.concatenate(track), np.concatenate(bias), np.concatenate(variance)

    def _advance(self, state: JointState, frame: Frame) -> Step:
        """Take a state over a frame; a function of its arguments alone, so that it can be done again."""
        if not frame.keyframe:
            return self._passed(state, frame)
        usable = frame.stereo.usable
        rows = self._matched(state, frame)
        staying = self._staying(state, rows)
        if not staying.all():
            state.keep(staying)
            rows = rows[staying]
        slots = (rows >= 0).nonzero()[0]
        rows = rows[slots]
        state.see(slots, frame.k)
        before = state.nav
        if frame.k == 0:
            state.nav = self._motion.first(self._layout, before, frame)
        else:
            state.predict(self._motion.propagate(self._layout, state.world_T_imu, before, frame))
        told = self._measure(state, frame)
        view = self._camera.view(state.world_T_imu, state.nav, state.anchors[slots], state.landmarks[slots])
        self._add_drift(state, view, slots)
        fused, gated, update = self._fuse(state, view, frame, rows, allowed=usable[rows], slots=slots)
        new = usable.copy()
        new[rows] = False
        self._initialise(state, frame, new)
        if self._options.smoothed or self._last is not None:
            state.note_pose()
        used, all_gated = new, np.zeros(len(usable), bool)
        used[rows[fused]] = True
        all_gated[rows[gated]] = True
        dof = 3 * int(np.count_nonzero(fused))
        # Weighted innovations are no chi-square numbers, nor is their density a Gaussian's.
        gaussian = self._problem.kernel is None
        nis, density = (0.0, 0.0) if update is None else (update.nis, _log_density(update, dof))
        return Step(
            pose=state.world_T_imu,
            pose_cov=state.cov[POSE, POSE].copy(),
            states=reported(self._motion, self._layout, state.nav, state.cov),
            nis=nis if gaussian else 0.0,
            dof=dof if gaussian else 0,
            log_likelihood=told + density if gaussian else float("nan"),
            used=used,
            gated=all_gated,
        )

    def _passed(self, state: JointState, frame: Frame) -> Step:
        """Take a state over a frame between keyframes: predict, and keep all landmarks."""
        state.predict(self._motion.propagate(self._layout, state.world_T_imu, state.nav, frame))
        if self._options.smoothed or self._last is not None:
            state.note_pose()
        return Step(
            pose=state.world_T_imu,
            pose_cov=state.cov[POSE, POSE].copy(),
            states=reported(self._motion, self._layout, state.nav, state.cov),
            log_likelihood=0.0 if self._problem.kernel is None else float("nan"),
        )

    def _add_drift(self, state: JointState, view: View, slots: IntArray) -> None:
        """Let the landmarks in view drift by a frame, each track for itself."""
        if self._track_noise.drift > 0.0:
            state.add_drift(slots, view.drift_cov(self._track_noise.drift))

    def _matched(self, state: JointState, frame: Frame) -> IntArray:
        """Where in the frame the landmarks ``(n,)`` are, -1 for none; the last answer is kept."""
        given = state.track, frame.stereo.track
        track, in_frame, rows = self._match
        if track is not given[0] or in_frame is not given[1]:
            rows = _places(*given)
            self._match = (*given, rows)
        return rows

    def _staying(self, state: JointState, rows: IntArray) -> BoolArray:
        """Landmarks that are kept: those in view (``rows`` not -1), and the most recently observed others."""
        staying = rows >= 0
        if self._problem.kept and not staying.all():
            out = np.flatnonzero(~staying)
            latest = np.lexsort((state.track[out], -state.seen_at[out]))
            staying[out[latest[: self._problem.kept]]] = True
        return staying

    def _fuse(
        self,
        state: JointState,
        view: View,
        frame: Frame,
        rows: IntArray,
        *,
        allowed: BoolArray,
        slots: IntArray,
    ) -> tuple[BoolArray, BoolArray, Correction | None]:
        """Gate and fuse the observations in ``rows`` of the frame, of the landmarks ``slots``.

        Returns the masks ``(n,)`` of those that were fused and gated, and the update if anything was fused.
        """
        n = len(rows)
        nothing = np.zeros(n, bool)
        if not allowed.any():
            return nothing, nothing, None
        z, variance = frame.stereo.z[rows], self._variance(frame, rows)
        innovation = self._linearise(state, view, z, slots)
        distance = innovation.distances(variance)
        passes = (distance <= self._threshold) & (view.depth > self._nearest)
        good, gated = allowed & passes, allowed & ~passes
        if not good.any():
            return nothing, gated, None
        # From here on only of those that pass.
        part = innovation
        if not good.all():
            variance, distance, part = variance[good], distance[good], innovation.of(good)
        update = part.update(self._weighted(part, variance, frame.k, distance=distance))
        # Gauss-Newton (Bell and Cathey, IEEE TAC 38, 1993): linearise where the correction leads, and again.
        for _ in range(self._options.iterations - 1):
            correction = update.correction
            there = se3.retract(state.world_T_imu, correction[POSE])
            landmarks = state.landmarks + state.of_landmarks(correction)
            nav = state.nav + correction[: self._layout.size]
            view = self._camera.view(there, nav, state.anchors[slots], landmarks[slots])
            if not (view.depth[good] > self._nearest).all():
                break
            innovation = self._linearise(state, view, z, slots, correction=correction)
            part = innovation.of(good)
            update = part.update(self._weighted(part, variance, frame.k, distance=distance))
            change = update.correction - correction
            if (change**2 <= _CONVERGED**2 * np.diagonal(state.cov)).all():
                break
        state.correct(update)
        return good, gated, update

    def _linearise(
        self, state: JointState, view: View, z: Array, slots: IntArray, *, correction: Array | None = None
    ) -> "_Innovation":
        """Linearise the observations of a view, which is that of the state or of where a correction leads."""
        seen_from = view
        if state.form == "fej":
            first = state.linearised_at[slots]
            seen_from = self._camera.view(state.world_T_imu, state.nav, state.anchors[slots], first)
        by_nav, by_landmark = seen_from.jacobians()
        some = slots if len(slots) < len(state.track) else None
        jacobian = Jacobian(by_nav.reshape(-1, self._camera.observed), by_landmark, some, self._layout.size)
        value = (z - view.measurement()).reshape(-1)
        if correction is not None:
            by_nav[:, :, POSE] = by_nav[:, :, POSE] @ se3.right_jacobian(correction[POSE])
            value += jacobian.times(correction[:, None])[:, 0]
        projected = jacobian.times(state.cov)
        return _Innovation(value, jacobian, projected, jacobian.times(projected.T))

    def _weighted(self, innovation: "_Innovation", variance: Array, k: int, *, distance: Array) -> Array:
        """Variances ``(n, 3)`` under the kernel, if there is one, that starts from ``distance (n,)``."""
        kernel = self._problem.kernel
        if kernel is None:
            return variance
        weights, converged = student_weights(
            kernel, innovation.spread, variance, innovation.value, first=kernel.weight(distance)
        )
        if not converged:
            self._not_converged.add(k)
        return variance / weights[:, None]

    def _measure(self, state: JointState, frame: Frame) -> float:
        """Fuse what the model of motion measures; returns the logarithm of its density."""
        found = self._motion.measurements(self._layout, state.world_T_imu, state.nav, frame)
        if not found:
            return 0.0
        # All are linearised at one state, so they are fused at once: one after the other, the second would
        # have to be compared with what the first has made of it.
        by_nav = np.concatenate([one.by_nav for one in found])
        innovation = np.concatenate([one.innovation for one in found])
        jacobian = Jacobian(by_nav, self._no_landmark, self._no_slot, self._layout.size)
        projected = jacobian.times(state.cov)
        spread = jacobian.times(projected.T)
        spread.reshape(-1)[:: len(spread) + 1] += np.concatenate([one.variance for one in found])
        update = Update.of(jacobian, projected, spread, innovation)
        state.correct(update)
        return _log_density(update, len(innovation))

    def _initialise(self, state: JointState, frame: Frame, new: BoolArray) -> None:
        if not new.any():
            return
        rows = np.flatnonzero(new)
        anchors, landmarks, by_nav, by_measurement = self._camera.initialise(
            state.world_T_imu, state.nav, frame.stereo.z[rows]
        )
        variance = self._variance(frame, rows)
        if self._layout.landmark == LANDMARK:
            match = self._track_noise.match_sigma(frame.stereo.z[rows, 0] - frame.stereo.z[rows, 1])
            variance = np.column_stack([variance, match**2])
        state.append(
            frame.stereo.track[rows],
            anchors,
            landmarks,
            by_nav=by_nav,
            noise=(by_measurement * variance[:, None, :]) @ by_measurement.transpose(0, 2, 1),
            seen_at=frame.k,
        )

    def _variance(self, frame: Frame, rows: IntArray) -> Array:
        """Variances ``(n, 3)`` [px^2] of the white noise of measurements of a frame."""
        if self._independent:
            return frame.stereo.sigma[rows] ** 2
        return np.broadcast_to(self._track_noise.sigma**2, (len(rows), 3))

    def _record_marginalised(self, seen: BoolArray) -> None:
        """Record the estimates of landmarks before they are marginalised."""
        state, left = self.state, np.flatnonzero(~seen)
        if not len(left) and self._matches:
            return
        self._matches.append((state.track[left], state.landmarks[left, 3], state.bias_variances(left)))
        if self._filtered_map:
            self._left.append(backward.filtered_landmarks(state, left))


@dataclass(frozen=True)
class _Innovation:
    """Linearised observations of landmarks of the state.

    Attributes
    ----------
    value : (3n,)
        Measured less predicted [px].
    jacobian : Jacobian
    projected : (3n, d)
        ``H P``.
    spread : (3n, 3n)
        ``H P H^T``.
    """

    value: Array
    jacobian: Jacobian
    projected: Array
    spread: Array

    def distances(self, variance: Array) -> Array:
        """Squared Mahalanobis distance ``(n,)`` of each observation of white noise ``variance (n, 3)``."""
        return squared_distances(diagonal_blocks(self.spread, 3), variance, self.value.reshape(-1, 3))

    def of(self, good: BoolArray) -> "_Innovation":
        """Return those of the good observations."""
        if good.all():
            return self
        rows, of = np.flatnonzero(np.repeat(good, 3)), self.jacobian
        slots = np.flatnonzero(good) if of.slots is None else of.slots[good]
        part = Jacobian(of.by_nav[rows], of.by_landmark[good], slots, of.nav)
        return _Innovation(
            self.value[rows],
            part,
            self.projected.take(rows, axis=0),
            self.spread.take(rows, axis=0).take(rows, axis=1),
        )

    def update(self, variance: Array) -> Correction:
        """Update with the observations, of white noise ``variance (n, 3)``; uses up its matrices."""
        spread, noise = self.spread, variance.reshape(-1)
        spread.reshape(-1)[:: len(spread) + 1] += noise
        if ObservedUpdate.fits(self.jacobian):
            return ObservedUpdate.of(self.jacobian, self.projected, spread, self.value, variance=noise)
        return Update.of(self.jacobian, self.projected, spread, self.value)


def _places(track: IntArray, in_frame: IntArray) -> IntArray:
    """Where in a frame tracks ``(n,)`` are; -1 for those it does not have."""
    if not len(in_frame):
        return np.full(len(track), -1)
    order = in_frame.argsort()
    place = order.take(in_frame.searchsorted(track, sorter=order), mode="clip")
    place[in_frame[place] != track] = -1
    return place


def _log_density(update: Correction, dof: int) -> float:
    return -0.5 * (update.nis + update.log_det + dof * _LOG_2_PI)
