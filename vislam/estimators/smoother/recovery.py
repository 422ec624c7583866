"""Solver recovery: strategies for a step that GTSAM cannot solve, tried in order."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import gtsam

from vislam.base.errors import DivergedError
from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.solver import Solver
from vislam.estimators.smoother.tracks import Track
from vislam.estimators.smoother.tree import IndeterminateError
from vislam.geometry import se3
from vislam.models import StereoRig

_MOST_SUSPECTS = 20
"""A recovery that has rejected this many landmarks looks for no more of those that errors name."""
_LULL = 10
"""Steps without QR after which a failure has nothing to do with the one before."""


@dataclass
class _Failure:
    """A step that could not be solved.

    Attributes
    ----------
    error : IndeterminateError
        The newest; each further try that fails brings another.
    held : mapping of int to gtsam.NonlinearFactor
    point : gtsam.Values
        Factors by slot and linearisation point of the engine that failed.
    """

    error: IndeterminateError
    held: Mapping[int, gtsam.NonlinearFactor]
    point: gtsam.Values


@dataclass(frozen=True)
class _Way:
    """A recovery strategy: repeat the step without the suspects, from these poses, by frame."""

    suspects: list[Track]
    poses: Mapping[int, Array]


class Recovery:
    """Repeats steps that could not be solved, from the factors and the linearisation point that are left.

    Where Cholesky has failed, first with QR; then without the landmarks that lie where they cannot or that
    the error names, or that of the next try; then without any in view, and from the causal poses.

    QR serves the step for which Cholesky failed; with the next the solver is back to Cholesky. Each of the
    two costs a solution of the whole graph, as much as many steps. So where the return fails, too, or
    Cholesky fails again within a few steps, QR stays, for twice as many steps each time: a graph for which
    Cholesky always fails has it tried log2(n) + 1 times in n steps, and takes no longer than with QR but for
    these.

    Attributes
    ----------
    rescues : int
        Steps that needed more than QR.
    refusals : int
        Steps, and returns from QR, at which Cholesky failed.
    by_qr : int
        Steps solved with QR.
    events : list of str
        What was done.
    """

    def __init__(self, rig: StereoRig, options: SmootherOptions, solver: Solver) -> None:
        self._rig, self._options, self._solver = rig, options, solver
        self.recoveries = self.refusals = self.by_qr = 0
        self.events: list[str] = []
        # Steps with QR beyond the one that was refused, when it was last; and how many of them are to come.
        self._patience = self._wait = 0
        self._last_refusal: int | None = None

    def repeat(self, frame: Frame, error: IndeterminateError) -> None:
        """Repeat the step to a frame.

        Raises
        ------
        DivergedError
            If all strategies fail, or it would be one recovery too many.
        """
        solver = self._solver
        failure = _Failure(error, solver.engine.factors(), solver.engine.linearization_point())
        if self._by_qr(frame, failure):
            return
        self.recoveries += 1
        if self.recoveries > self._options.max_recoveries:
            raise DivergedError(f"{failure.error}; it would be recovery {self.recoveries}")
        gone: list[Track] = []
        for way in self._ways(failure, gone):
            found = ", ".join(self._describe(track, failure.point) for track in [*gone, *way.suspects][:3])
            solver.reject(way.suspects)
            gone += way.suspects
            if self._goes(frame, failure, way.poses):
                self.events.append(
                    f"frame {frame.k}: {failure.error}; {len(gone)} landmarks rejected, as {found or 'none'}"
                )
                return
        raise DivergedError(f"{failure.error}, also without any landmark in view")

    def go_on(self, frame: Frame) -> None:
        """Note how the step to a frame was solved, and go back to Cholesky if it is time."""
        solver = self._solver
        if solver.factorization == "cholesky":
            return
        self.by_qr += 1
        if self._options.factorization == "qr":
            return
        if self._wait > 0:
            self._wait -= 1
            return
        left = solver.engine
        solver.factorization = "cholesky"
        try:
            solver.rebuild(frame, left.factors(), left.linearization_point(), {})
        except IndeterminateError:
            solver.engine = left
            self._refused(frame)

    def _by_qr(self, frame: Frame, failure: _Failure) -> bool:
        """Switch to QR, where that has not been done and is allowed."""
        solver = self._solver
        if self._options.factorization != "auto" or solver.factorization != "cholesky":
            return False
        self._refused(frame)
        steps = "this step" if self._wait == 0 else f"{self._wait + 1} steps"
        event = f"frame {frame.k}: {failure.error} to Cholesky; QR for {steps}"
        if not self._goes(frame, failure, {}):
            return False
        self.events.append(event)
        return True

    def _refused(self, frame: Frame) -> None:
        """Take QR for the steps to come, for twice as many as after the last refusal if that is recent."""
        last, self._last_refusal = self._last_refusal, frame.k
        recent = last is not None and frame.k - last <= self._patience + _LULL
        self._patience = max(1, 2 * self._patience) if recent else 0
        self._solver.factorization = "qr"
        self._wait = self._patience
        self.refusals += 1

    def _ways(self, failure: _Failure, gone: list[Track]) -> Iterator[_Way]:
        """Ways to go on, each asked for when the one before has failed; ``gone`` is what was rejected."""
        solver = self._solver
        in_view = [track for track in solver.tracks.in_view.values() if failure.point.exists(track.key)]
        suspects = solver.strange(failure.point)
        known = {track.key for track in suspects}
        suspects += [track for track in self._named(failure.error) if track.key not in known]
        while suspects:
            yield _Way(suspects, {})
            suspects = self._named(failure.error) if len(gone) < _MOST_SUSPECTS else []
        left = [track for track in in_view if track.id in solver.tracks.in_view]
        yield _Way(left, dict(enumerate(solver.poses)))

    def _goes(self, frame: Frame, failure: _Failure, poses: Mapping[int, Array]) -> bool:
        """Try it; what is wrong with it is then the failure's error."""
        try:
            self._solver.rebuild(frame, failure.held, failure.point, poses)
        except IndeterminateError as error:
            failure.error = error
            return False
        return True

    def _named(self, error: IndeterminateError) -> list[Track]:
        """Landmark that an error names, if it does; it may be out of view by now."""
        return [track for track in self._solver.tracks.landmarks if track.key == error.key]

    def _describe(self, track: Track, point: gtsam.Values) -> str:
        """Describe why a landmark may have broken a step."""
        rig, view = self._rig, track.views[-1]
        disparity = view.z[0] - view.z[1]
        measured = rig.fx * rig.baseline / disparity
        cam_T_world = rig.cam_T_imu @ se3.inverse(self._solver.poses[-1])
        depth = se3.transform(cam_T_world, point.atPoint3(track.key)[None])[0, 2]
        return (
            f"track {track.id} ({len(track.views)} observations, disparity {disparity:.1f} px, "
            f"depth {depth:.1f} m for {measured:.1f} m)"
        )
