"""Part ``dense``: the textbook filter over all landmarks, for a given time, beside the working one."""

import time

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.fits import Polynomial
from benchmarks.timing import Drive, Part, Timed, timed
from vislam.base.types import Array
from vislam.estimators.ekf import EkfOptions
from vislam.estimators.ekf.dense import DenseFilter

_FEWEST = 8
"""Frames that a fit is made from at least."""


def measure(drive: Drive, *, seconds: float) -> Part:
    """Run both on the frames that the dense filter manages in ``seconds``, and extrapolate to all."""
    with threadpool_limits(1):
        landmarks, step_time = dense_steps(drive, seconds=seconds)
        beginning = drive.first(len(step_time))
        ungated = EkfOptions(gate=False)
        working = timed(beginning, ungated)
        whole = timed(drive, ungated)
    # The first frames have a small covariance or none, and their time is that of starting up.
    used = slice(min(2, len(step_time) - _FEWEST), None)
    fit = Polynomial.through(landmarks[used], step_time[used])
    all_landmarks = _landmarks_before(drive)
    expected = float(fit(all_landmarks).sum())
    rows = [
        _row(f"first {len(step_time)} frames, measured", landmarks, float(step_time.sum()), working),
        _row(f"all {len(all_landmarks)} frames, extrapolated", all_landmarks, expected, whole),
    ]
    powers = " + ".join(f"{value:.3g} n^{k}" for k, value in enumerate(fit.coefficients) if value > 0.0)
    return Part(
        title=f"dense: {drive.name}, every landmark kept for ever, nothing gated",
        header=["frames", "landmarks", "dense [s]", "working, forward [s]", "ratio", "ratio, there and back"],
        rows=rows,
        notes=(
            f"dense step time [s] at n landmarks, a cubic without negative terms: {powers}; "
            f"relative residual {100 * fit.residual:.1f} % (rms)",
        ),
        values={
            "frames_measured": len(step_time),
            "landmarks_measured": int(landmarks[-1]),
            "dense_s": float(step_time.sum()),
            "working_forward_s": working.forward,
            "working_backward_s": working.backward,
            "ratio_measured": float(step_time.sum()) / working.forward,
            "fit_coefficients": fit.coefficients.tolist(),
            "fit_residual": fit.residual,
            "frames": len(all_landmarks),
            "landmarks": int(all_landmarks[-1]),
            "dense_extrapolated_s": expected,
            "working_whole_forward_s": whole.forward,
            "working_whole_backward_s": whole.backward,
            "ratio_extrapolated": expected / whole.forward,
        },
    )


def dense_steps(drive: Drive, *, seconds: float) -> tuple[Array, Array]:
    """Landmarks in the state before each frame, and the CPU time of the step [s]; at least a few frames."""
    solver = DenseFilter(drive.problem, keep_poses=False)
    landmarks: list[int] = []
    times: list[float] = []
    started = time.perf_counter()
    for frame in drive.dataset.sequence.frames(drive.sigma):
        if time.perf_counter() - started > seconds and len(times) > _FEWEST:
            break
        landmarks.append(len(solver.track))
        before = time.thread_time()
        solver.process(frame)
        times.append(time.thread_time() - before)
    return np.array(landmarks, float), np.array(times)


def _landmarks_before(drive: Drive) -> Array:
    """Tracks that began before each frame, ``(T,)``."""
    sequence = drive.dataset.sequence
    _, first = np.unique(sequence.track, return_index=True)
    born = np.bincount(sequence.frame_of[first], minlength=len(sequence))
    return np.concatenate([[0.0], np.cumsum(born)[:-1]])


def _row(title: str, landmarks: Array, dense: float, working: Timed) -> list[str]:
    both = working.forward + working.backward
    return [
        title,
        f"{landmarks[-1]:.0f}",
        f"{dense:.4g}",
        f"{working.forward:.3g}",
        f"{dense / working.forward:.3g}",
        f"{dense / both:.3g}",
    ]
