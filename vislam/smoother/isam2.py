"""iSAM2 SLAM, one frame at a time, with GTSAM doing the solving."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from typing import Annotated, Any

import gtsam
import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam import config
from vislam.data.sequence import Frame
from vislam.errors import ConfigError, DivergedError
from vislam.estimator import Estimate, Problem, StepRecord
from vislam.fields import STRICT, NonNegative, Positive
from vislam.geometry import se3
from vislam.smoother.factors import FactorBuilder
from vislam.smoother.keys import B, X, landmark, thresholds
from vislam.smoother.triangulation import triangulate
from vislam.types import Array, BoolArray

_NEAREST = 1.0
"""A landmark nearer than this to the camera that sees it, or behind it, has gone astray [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Isam2Options:
    """Options of the incremental smoother."""

    huber: Positive | None = None
    """Threshold of a Huber kernel on stereo factors, in standard deviations; null for none, as the filter."""
    window: Annotated[int, Field(ge=1)] = 5
    """Frames after its last sight for which a variable may still be relinearised, until the end."""
    final_iterations: Annotated[int, Field(ge=0)] = 1
    """Updates after the last frame in which every variable may be relinearised."""
    pose_threshold_rad: Positive = 0.01
    """Relinearise a pose that turned by more than this [rad]."""
    pose_threshold_m: Positive = 0.1
    """Relinearise a pose that moved by more than this [m]."""
    landmark_threshold: Positive = 0.15
    """Relinearise a landmark that moved by more than this share of its depth."""
    wildfire_threshold: NonNegative = 0.01
    """Old variables whose solution changes by less than this are left alone until the end [rad, m]."""
    start_clearance: Positive = 5.0
    """A landmark starts when its disparity is this many standard deviations away from zero."""
    min_disparity_px: Positive = 1.3
    """A landmark whose disparity, as estimated, falls below this has gone astray [px]."""
    checkpoint_frames: Annotated[int, Field(ge=1)] = 20
    """Frames between two checkpoints; a step that cannot be solved falls back on the last one."""
    max_waiting_views: Annotated[int, Field(ge=2)] = 30
    """Views that a waiting track keeps; older ones are dropped and counted."""


def build(problem: Problem, options: Mapping[str, Any]) -> "Isam2Estimator":
    """Build the smoother from a problem and the options of its config section.

    Raises
    ------
    ConfigError
        Also if the problem has a measurement or a state that this smoother lacks: with it left out, it would
        no longer be given the same information as a filter.
    """
    asked = {
        "climb": problem.climb is not None,
        "clock_sigma": problem.clock_sigma > 0.0,
        "disparity_offset_sigma_px": problem.disparity_offset_sigma > 0.0,
    }
    for name, wanted in asked.items():
        if wanted:
            raise ConfigError(
                f"estimators.isam2: has no use for noise.{name} yet; take it out, or compare filters only"
            )
    return Isam2Estimator(problem, config.parse(Isam2Options, dict(options), at="estimators.isam2"))


@dataclass(frozen=True, slots=True, config={"arbitrary_types_allowed": True})
class _View:
    """One stereo observation of a track."""

    k: int
    z: Any
    sigma: Any


@plain_dataclass
class _Book:
    """What the smoother keeps beside the tree; copied whole for a checkpoint.

    Attributes
    ----------
    pose, bias : (4, 4), (6,)
        The newest ones.
    poses : list of (4, 4)
        Causal poses.
    waiting : dict
        Views of tracks that are not in the graph yet.
    keys, slots, last_seen : dict
        Key, factor indices and last frame of each landmark in the graph.
    seen_in : list
        Landmarks that got factors in each frame.
    frozen : list of int
        Keys that may not be relinearised any more.
    astray : list of int
        Landmarks whose factors the next update takes out.
    set_aside : set of int
        Tracks that are not fused any more.
    """

    pose: Array
    bias: Array
    poses: list[Array] = field(default_factory=list)
    waiting: dict[int, list[_View]] = field(default_factory=dict)
    keys: dict[int, int] = field(default_factory=dict)
    slots: dict[int, list[int]] = field(default_factory=dict)
    last_seen: dict[int, int] = field(default_factory=dict)
    seen_in: list[list[int]] = field(default_factory=list)
    frozen: list[int] = field(default_factory=list)
    astray: list[int] = field(default_factory=list)
    set_aside: set[int] = field(default_factory=set)


@plain_dataclass
class _Checkpoint:
    """State to fall back on, and the frames taken since."""

    isam: Any
    book: _Book
    since: list[Frame]


class Isam2Estimator:
    """Poses, biases and landmarks of the whole drive in one graph.

    Only variables seen in the last frames are relinearised on the way: the linearisation of what lies
    behind hardly matters for what comes, and redoing it costs the whole tree. In the end a few updates
    relinearise everything.

    A step that GTSAM cannot solve is not the end: the last checkpoint is restored, the frames since are
    repeated on the inertial data alone, the tracks they saw are set aside, and the rescue is counted.
    """

    def __init__(self, problem: Problem, options: Isam2Options) -> None:
        self._problem, self._options = problem, options
        self._factors = FactorBuilder(problem, huber=options.huber)
        self._isam = gtsam.ISAM2(_parameters(options))
        self._book = _Book(np.eye(4), problem.bias_mean)
        self._frozen = gtsam.KeyList()
        self._checkpoints: list[_Checkpoint] = []
        self.counts = {
            "landmarks_too_weak": 0,
            "landmarks_set_aside": 0,
            "views_dropped_waiting": 0,
            "observations_used_late": 0,
            "rescues": 0,
            "frames_without_camera": 0,
            "final_iterations_undone": 0,
        }

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame."""
        if frame.k % self._options.checkpoint_frames == 0:
            now = _Checkpoint(gtsam.ISAM2(self._isam), copy.deepcopy(self._book), [])
            self._checkpoints = [*self._checkpoints[-1:], now]
        for checkpoint in self._checkpoints:
            checkpoint.since.append(frame)
        try:
            return self._step(frame, refused)
        except RuntimeError:
            return self._rescue()

    def _rescue(self) -> StepRecord:
        """Repeat the frames since a checkpoint without the camera.

        The newest may have been taken when what went wrong was already in the graph: then the one before it.
        """
        while len(self._checkpoints) > 1:
            try:
                return self._repeat(self._checkpoints[-1])
            except RuntimeError:
                self._checkpoints.pop()
        return self._repeat(self._checkpoints[0])

    def _repeat(self, checkpoint: "_Checkpoint") -> StepRecord:
        self._isam, self._book = gtsam.ISAM2(checkpoint.isam), copy.deepcopy(checkpoint.book)
        self._frozen = gtsam.KeyList()
        for key in self._book.frozen:
            self._frozen.push_back(key)
        for frame in checkpoint.since:
            lost = set(frame.track.tolist())
            self._book.set_aside |= lost
            for track in lost & self._book.waiting.keys():
                del self._book.waiting[track]
        self.counts["rescues"] += 1
        self.counts["frames_without_camera"] += len(checkpoint.since)
        for frame in checkpoint.since:
            record = self._step(frame, np.ones(len(frame.track), bool))
        return record

    def _step(self, frame: Frame, refused: BoolArray) -> StepRecord:
        book = self._book
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self._move(frame):
            graph.add(factor)
        values.insert(X(frame.k), gtsam.Pose3(book.pose))
        values.insert(B(frame.k), book.bias)
        book.poses.append(book.pose)
        views = self._known_views(frame, refused) + self._start_tracks(values)
        for track, view in views:
            graph.add(self._factors.stereo(view.k, book.keys[track], z=view.z, sigma=view.sigma))
        self._update(frame.k, graph, values, [track for track, _ in views])
        book.pose = self._isam.calculateEstimatePose3(X(frame.k)).matrix()
        book.bias = self._isam.calculateEstimateVector(B(frame.k))
        book.poses[-1] = book.pose
        now = {track for track, view in views if view.k == frame.k}
        self.counts["observations_used_late"] += len(views) - len(now)
        self._find_astray(sorted(now))
        return StepRecord(
            world_T_imu=book.pose,
            pose_cov=None,
            bias=book.bias,
            bias_sigma=None,
            nis=0.0,
            dof=0,
            log_likelihood=float("nan"),
            used=np.isin(frame.track, list(now)),
            gated=np.zeros(len(frame.track), bool),
        )

    def finalize(self) -> Estimate:
        """Relinearise everything a few times and return all poses and landmarks."""
        try:
            values = self._isam.calculateBestEstimate()
        except RuntimeError:
            self._rescue()
            values = self._isam.calculateBestEstimate()
        # The last update takes the most memory: let go of what only a later step would need.
        self._checkpoints = []
        everything = gtsam.ISAM2UpdateParams()
        everything.forceFullSolve = True
        for _ in range(self._options.final_iterations):
            try:
                self._solve(gtsam.NonlinearFactorGraph(), gtsam.Values(), everything, "the end")
                values = self._isam.calculateBestEstimate()
            except RuntimeError:
                self.counts["final_iterations_undone"] += 1
                break
        self.counts["landmarks_too_weak"] += len(self._book.waiting)
        poses = np.array([values.atPose3(X(k)).matrix() for k in range(len(self._book.poses))])
        tracks = sorted(self._book.keys)
        points = np.array([values.atPoint3(self._book.keys[track]) for track in tracks]).reshape(-1, 3)
        return Estimate(poses, None, np.array(tracks, dtype=np.int64), points, None, dict(self.counts))

    def _move(self, frame: Frame) -> list[gtsam.NonlinearFactor]:
        """Predict the pose; the factors that tie it to the one before."""
        if frame.k == 0:
            return self._factors.priors()
        self._book.pose = self._book.pose @ se3.exp(frame.dt * (frame.twist - self._book.bias))
        return self._factors.motion(frame.k, twist=frame.twist, bias=self._book.bias, dt=frame.dt)

    def _known_views(self, frame: Frame, refused: BoolArray) -> list[tuple[int, _View]]:
        """Views of landmarks in the graph; the views of other tracks join those that wait."""
        views = []
        tracks = frame.track.tolist()
        for row in np.flatnonzero(~refused):
            track = tracks[row]
            if track in self._book.set_aside:
                continue
            view = _View(frame.k, frame.z[row], frame.sigma[row])
            if track in self._book.keys:
                views.append((track, view))
            else:
                self._book.waiting.setdefault(track, []).append(view)
        for track in self._book.waiting.keys() - set(tracks):
            del self._book.waiting[track]
            self.counts["landmarks_too_weak"] += 1
        return views

    def _start_tracks(self, values: gtsam.Values) -> list[tuple[int, _View]]:
        """Put waiting tracks that have become clear into the graph; returns all their views."""
        limit = self._options.max_waiting_views
        for views in self._book.waiting.values():
            self.counts["views_dropped_waiting"] += max(0, len(views) - limit)
            del views[:-limit]
        tracks = [track for track, views in self._book.waiting.items() if len(views) > 1]
        if not tracks:
            return []
        start = triangulate(
            self._problem.rig, *self._stack_views(tracks), clear=self._options.start_clearance
        )
        started = []
        for index in np.flatnonzero(start.ready):
            track = tracks[index]
            self._book.keys[track] = landmark(track, float(start.depth[index]))
            values.insert(self._book.keys[track], start.points_world[index])
            started += [(track, view) for view in self._book.waiting.pop(track)]
        return started

    def _stack_views(self, tracks: list[int]) -> tuple[Array, Array, Array]:
        """Poses ``(n, V, 4, 4)``, measurements ``(n, V, 3)`` and noise ``(n, V, 3)`` of waiting tracks."""
        lists = [self._book.waiting[track] for track in tracks]
        most = max(len(views) for views in lists)
        frames = np.array(
            [[view.k for view in views] + [views[0].k] * (most - len(views)) for views in lists]
        )
        z = np.array([[view.z for view in views] + [views[0].z] * (most - len(views)) for views in lists])
        nothing = np.full(3, np.inf)
        sigma = np.array(
            [[view.sigma for view in views] + [nothing] * (most - len(views)) for views in lists]
        )
        first = int(frames.min())
        return np.array(self._book.poses[first:])[frames - first], z, sigma

    def _update(
        self, k: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, tracks: list[int]
    ) -> None:
        """Update the tree, take astray landmarks out of it and let old variables rest."""
        self._book.seen_in.append(sorted(set(tracks)))
        self._book.last_seen.update(dict.fromkeys(tracks, k))
        old = k - self._options.window
        if old >= 0:
            resting = [X(old), B(old)]
            for track in self._book.seen_in[old]:
                if self._book.last_seen[track] == old and track in self._book.keys:
                    resting.append(self._book.keys[track])
            self._book.frozen += resting
            for key in resting:
                self._frozen.push_back(key)
        parameters = gtsam.ISAM2UpdateParams()
        parameters.noRelinKeys = self._frozen
        parameters.removeFactorIndices = [
            slot for track in self._book.astray for slot in self._book.slots.pop(track, [])
        ]
        self._book.astray = []
        result = self._solve(graph, values, parameters, f"frame {k}")
        slots = result.getNewFactorsIndices()
        for track, slot in zip(reversed(tracks), reversed(list(slots)), strict=False):
            self._book.slots.setdefault(track, []).append(slot)

    def _solve(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, parameters: Any, where: str
    ) -> gtsam.ISAM2Result:
        try:
            return self._isam.update(graph, values, parameters)
        except RuntimeError as error:
            named = [line.strip() for line in str(error).splitlines() if "Symbol" in line]
            text = named[0] if named else str(error).strip().splitlines()[0]
            raise DivergedError(f"iSAM2 could not solve at {where}: {text}") from None

    def _find_astray(self, tracks: list[int]) -> None:
        """Set aside landmarks that came to lie behind the camera, in it, or on their way to infinity.

        A stereo factor whose point is behind the camera has no Jacobian, and the system loses rank; a
        point gets there through infinity as easily as through the camera.
        """
        if not tracks:
            return
        points = np.array([self._isam.calculateEstimatePoint3(self._book.keys[track]) for track in tracks])
        cam_T_world = self._problem.rig.cam_T_imu @ se3.inverse(self._book.pose)
        depth = se3.transform(cam_T_world, points)[:, 2]
        farthest = self._problem.rig.fx * self._problem.rig.baseline / self._options.min_disparity_px
        for index in np.flatnonzero(~((depth > _NEAREST) & (depth < farthest))):
            track = tracks[index]
            self._book.astray.append(track)
            self._book.set_aside.add(track)
            del self._book.keys[track]
            self.counts["landmarks_set_aside"] += 1


def _parameters(options: Isam2Options) -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    parameters.relinearizeSkip = 1
    # Cholesky loses rank on these graphs where all landmarks in view are far away.
    parameters.setFactorization("QR")
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(options.wildfire_threshold))
    pose = np.repeat([options.pose_threshold_rad, options.pose_threshold_m], 3)
    # The bias enters all but linearly: a change of 1 rad/s would matter, none of that size occurs.
    parameters.setRelinearizeThreshold(
        thresholds(pose=pose, bias=np.ones(6), depth_share=options.landmark_threshold)
    )
    return parameters


__all__ = ["Isam2Estimator", "Isam2Options", "build"]
