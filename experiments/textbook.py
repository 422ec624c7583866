"""Parts ``textbook``, the filter over all landmarks beside the working one, and ``tracks``: cost of one."""

import time
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from experiments.timing import Drive, Part, milliseconds, timed
from vislam.base.types import Array
from vislam.estimators.ekf import EkfOptions
from vislam.estimators.ekf.dense import DenseFilter

TENTHS = (1, 2, 4, 10)
"""Tenths of the tracks that are kept."""
_FEWEST = 8
"""Frames that the textbook filter gets at least, so that a curve can be laid through their times."""


def textbook(drive: Drive, *, seconds: float) -> Part:
    """Run both on the frames that the textbook filter manages in ``seconds``, and extrapolate to all."""
    with threadpool_limits(1):
        landmarks, times = _textbook_steps(drive, seconds=seconds)
        few, whole = (timed(each, EkfOptions(gate=False)) for each in (drive.first(len(times)), drive))
    # The first frames have a small covariance or none, and their time is that of starting up.
    cubic = through(landmarks[2:], times[2:])
    sequence = drive.sequence
    _, first = np.unique(sequence.track, return_index=True)
    born = np.bincount(sequence.frame_of[first], minlength=len(sequence))
    before = np.concatenate([[0.0], np.cumsum(born)[:-1]])
    measured, expected = float(times.sum()), float(np.polynomial.polynomial.polyval(before, cubic).sum())
    cells = [
        (f"first {len(times)} frames, measured", landmarks[-1], measured, few.forward),
        (f"all {len(sequence)} frames, extrapolated", before[-1], expected, whole.forward),
    ]
    return Part(
        title=f"textbook: {drive.name}, every landmark kept for ever, nothing gated",
        header=["frames", "landmarks", "textbook [s]", "ekf, forward [s]", "ratio"],
        rows=[
            [told, f"{count:.0f}", f"{one:.4g}", f"{other:.3g}", f"{one / other:.3g}"]
            for told, count, one, other in cells
        ],
        notes=("extrapolated by a cubic without negative terms through the times of the measured frames",),
        values={
            "frames_measured": len(times),
            "ratio_measured": measured / few.forward,
            "ratio_extrapolated": expected / whole.forward,
            "coefficients": cubic.tolist(),
        },
    )


def _textbook_steps(drive: Drive, *, seconds: float) -> tuple[Array, Array]:
    """Landmarks in the state before each frame, and the CPU time of the step [s]."""
    solver = DenseFilter(drive.problem, keep_poses=False)
    landmarks: list[int] = []
    times: list[float] = []
    started = time.perf_counter()
    for frame in drive.sequence.frames(drive.sigma):
        if time.perf_counter() - started > seconds and len(times) > _FEWEST:
            break
        landmarks.append(len(solver.track))
        before = time.thread_time()
        solver.process(frame)
        times.append(time.thread_time() - before)
    return np.array(landmarks, float), np.array(times)


def through(at: Array, times: Array) -> Array:
    """Cubic ``(4,)``, constant first and none negative, through times ``(n,)`` at sizes ``(n,)``."""
    powers = np.vander(at / at.max(), 4, increasing=True)
    scaled, _ = nnls(powers / times[:, None], np.ones(len(at)))
    return np.asarray(scaled / float(at.max()) ** np.arange(4))


def tracks(drive: Drive, *, frames: int, tenths: Sequence[int] = TENTHS) -> Part:
    """Thin the tracks of the first frames of a drive, and time the standard filter on what is left."""
    beginning = drive.first(frames)
    track = beginning.sequence.track
    found = []
    with threadpool_limits(1):
        for kept in tenths:
            run = timed(beginning.thinned(track % 10 < kept), EkfOptions(marginalised_landmarks="filtered"))
            held = [sizes.known + sizes.new for sizes in run.sizes[1:]]
            found.append((float(np.mean(held)), float(np.median(run.step_time[1:]))))
    in_view, step = np.array(found).T
    exponent = float(np.polyfit(np.log(in_view), np.log(step), 1)[0])
    return Part(
        title=f"tracks: {drive.name}, thinned, first {len(beginning.sequence)} frames",
        header=["tracks kept", "in view, mean", "step, median [ms]", "ratio to the fewest"],
        rows=[
            [f"{10 * kept} %", f"{held:.0f}", milliseconds(taken), f"{taken / step[0]:.1f}"]
            for kept, held, taken in zip(tenths, in_view, step, strict=True)
        ],
        notes=(f"step time goes with the tracks to the power {exponent:.2f}",),
        values={
            "in_view": in_view.tolist(),
            "ratio_to_fewest": (step / step[0]).tolist(),
            "exponent": exponent,
        },
    )
