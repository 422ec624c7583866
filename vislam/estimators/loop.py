"""The loop that feeds frames to an estimator, owns the clock, and survives whatever the estimator does."""

import signal
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from vislam.base.errors import ContractError, Interrupted, LostError, first_line, interruption
from vislam.base.memory import PeakMemory
from vislam.base.types import Array, BoolArray
from vislam.core.estimator import Estimator
from vislam.core.lagged import Lagged
from vislam.core.run import Cost, Innovations, Log, Run, StateHistory
from vislam.core.sequence import Sequence
from vislam.core.step import Final, State, Step
from vislam.core.trajectory import Poses
from vislam.estimators.contract import check_interface, checked_final, checked_step

_LONGEST_REASON = 400
_LONGEST_TRACEBACK = 20_000
"""Characters kept of why a run broke off."""


class RunInterrupted(Interrupted):
    """Ctrl-C or SIGTERM while an estimator ran; ``run`` is what it had done."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run = run


def run(
    estimator: Estimator,
    sequence: Sequence,
    sigma: Array,
    *,
    name: str,
    usable: BoolArray | None = None,
    on_frame: Callable[[int], None] = lambda k: None,
    blas_threads: int = 1,
) -> Run:
    """Feed a sequence to an estimator and keep all it reports.

    Parameters
    ----------
    estimator : Estimator
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    name : str
    usable : (n,), optional
        Which observations may be fused; all if left out.
    on_frame : callable
        Called with the index of each finished frame.
    blas_threads : int
        Threads of the linear algebra. The matrices are small, and NumPy and SciPy each have a pool of
        their own: with more than one, the two mostly wait for each other.

    Returns
    -------
    Run
        Marked incomplete, with the reason and all frames up to it, whatever the estimator raised or returned,
        ``sys.exit`` included.

    Raises
    ------
    RunInterrupted
        On Ctrl-C or SIGTERM, with the run so far.
    """
    journal = _Journal(sequence, np.ones(sequence.observations, bool) if usable is None else usable)
    with threadpool_limits(blas_threads), PeakMemory() as memory:
        started = time.perf_counter()
        failure: BaseException | None = None
        try:
            with _left_as_found():
                journal.feed(estimator, sigma, on_frame)
        except BaseException as raised:
            failure = interruption(raised) or raised
        total = time.perf_counter() - started
    found = journal.run(name, failure=failure, total_time=total, peak_rss=memory.peak)
    found = replace(
        found,
        blind=bool(getattr(estimator, "blind", False)),
        upright=bool(getattr(estimator, "upright", False)),
        information=dict(getattr(estimator, "information", {})),
    )
    if failure is not None and _from_outside(failure):
        raise RunInterrupted(found) from None
    return found


def not_run(name: str, sequence: Sequence, failure: BaseException) -> Run:
    """Run of an estimator that could not be built, was not reached, or whose process was lost."""
    said = _said(failure)
    reason = said if isinstance(failure, Interrupted | LostError) else f"cannot be built: {said}"
    return Run.without_frames(
        name,
        Log(error=reason, traceback=_traceback(failure)),
        frames_expected=len(sequence),
        observations=sequence.observations,
    )


def _from_outside(failure: BaseException) -> bool:
    """Whether it is the user's Ctrl-C, or a SIGTERM, and no estimator's own KeyboardInterrupt."""
    if isinstance(failure, Interrupted):
        return True
    python_raises = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return isinstance(failure, KeyboardInterrupt) and python_raises


@contextmanager
def _left_as_found() -> Iterator[None]:
    """Undo what the code inside changes for the whole process: folder, NumPy's errors, warnings."""
    with chdir("."), np.errstate(), warnings.catch_warnings():
        yield


class _Journal:
    """What an estimator has answered so far; it can be packed into a run at any time."""

    def __init__(self, sequence: Sequence, usable: BoolArray) -> None:
        self._sequence = sequence
        self._usable = usable.copy()
        self._used = np.zeros(sequence.observations, bool)
        self._gated = np.zeros(sequence.observations, bool)
        self._steps: list[Step] = []
        self._step_time: list[float] = []
        self._sizes: dict[str, int] = {}
        self._final = Final()

    def feed(self, estimator: Estimator, sigma: Array, on_frame: Callable[[int], None]) -> None:
        """Feed all frames and finalise."""
        sequence = self._sequence
        check_interface(estimator)
        for frame in sequence.frames(sigma, self._usable):
            before = time.perf_counter()
            answer = estimator.process(frame)
            seconds = time.perf_counter() - before
            step = checked_step(answer, frame, self._sizes)
            self._sizes |= {name: len(state.value) for name, state in step.states.items()}
            self._step_time.append(seconds)
            self._steps.append(step)
            rows = slice(sequence.offset[frame.k], sequence.offset[frame.k + 1])
            self._used[rows], self._gated[rows] = step.used, step.gated
            on_frame(frame.k)
        final = checked_final(estimator.finalize(), len(self._steps))
        if final.fused is not None:
            self._used = sequence.mask_of(*final.fused)
        if final.gated is not None:
            self._gated = sequence.mask_of(*final.gated)
        self._final = final

    def run(self, name: str, *, failure: BaseException | None, total_time: float, peak_rss: int) -> Run:
        """Pack what is there."""
        steps, final = self._steps, self._final
        done = len(steps)
        poses = np.array([step.pose for step in steps]).reshape(-1, 4, 4)
        filtered = Poses(poses, _stack([step.pose_cov for step in steps], (6, 6)))
        found = Run(
            name=name,
            frames_expected=len(self._sequence),
            frame=np.arange(done),
            stamp=np.array(self._sequence.stamp[:done]),
            filtered=filtered,
            smoothed=_smoothed(final.trajectory, filtered),
            states={key: self._history(key, size) for key, size in self._sizes.items()},
            innovations=self._innovations(),
            cost=Cost(np.array(self._step_time, dtype=np.float64), total_time, peak_rss),
            used=self._used,
            gated=self._gated,
            map=final.map,
            log=Log(
                error="" if failure is None else self._reason(failure),
                traceback="" if failure is None else _traceback(failure),
                counts=final.counts,
                events=final.events + self._ignored_rejections(),
            ),
            fit=final.fit,
            lagged=_lagged(final, done),
        )
        return found if final.up is None else replace(found, up=final.up)

    def _innovations(self) -> Innovations:
        steps = self._steps
        return Innovations(
            nis=np.array([step.nis for step in steps], dtype=np.float64),
            dof=np.array([step.dof for step in steps], dtype=np.int64),
            log_likelihood=np.array([step.log_likelihood for step in steps], dtype=np.float64),
            spurious_information=_stack([step.spurious_information for step in steps], (6,)),
        )

    def _history(self, name: str, size: int) -> StateHistory:
        """Values and standard deviations of a state at all frames."""
        unknown = State(np.full(size, np.nan))
        states = [step.states.get(name, unknown) for step in self._steps]
        return StateHistory(
            np.array([state.value for state in states]), _stack([state.sigma for state in states], (size,))
        )

    def _reason(self, failure: BaseException) -> str:
        """Where it broke off and why, in one line."""
        done = len(self._steps)
        where = f"frame {done}" if done < len(self._sequence) else "finalize"
        return f"{where}: {_said(failure)}"

    def _ignored_rejections(self) -> tuple[str, ...]:
        """Say that rejected observations were fused, for then the information was not the same."""
        count = int(np.count_nonzero(self._used & ~self._usable))
        return (f"fused {count} observations that were rejected for all",) if count else ()


def _smoothed(trajectory: Poses | None, filtered: Poses) -> Poses | None:
    """Final poses; None if they are the filtered ones."""
    if trajectory is None or np.array_equal(trajectory.world_T_imu, filtered.world_T_imu):
        return None
    return trajectory


def _lagged(final: Final, frames: int) -> Lagged | None:
    """Poses by their lag, then the smoothed ones; None where none were requested."""
    poses = {lag: poses for lag, poses in final.lagged.items() if lag < frames}
    if poses and final.trajectory is not None:
        poses[frames - 1] = final.trajectory
    return Lagged.of(poses)


def _said(failure: BaseException) -> str:
    """First line of an exception's message, with its type where it is not one of ours."""
    said = first_line(failure)
    if not isinstance(failure, ContractError | Interrupted | LostError) and said != type(failure).__name__:
        said = f"{type(failure).__name__}: {said}"
    return said[:_LONGEST_REASON]


def _traceback(failure: BaseException) -> str:
    return "".join(traceback.format_exception(failure))[-_LONGEST_TRACEBACK:]


def _stack(parts: list[Array | None], shape: tuple[int, ...]) -> Array:
    """Stack what is there; NaN where an estimator gave nothing."""
    nothing = np.full(shape, np.nan)
    return np.array([nothing if part is None else part for part in parts]).reshape(-1, *shape)
