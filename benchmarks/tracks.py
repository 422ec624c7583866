"""Part ``tracks``: time of a step as a function of the tracks in view."""

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.fits import exponent
from benchmarks.timing import Drive, Part, milliseconds, timed
from vislam.estimators.ekf import EkfOptions

TENTHS = (1, 2, 4, 10)
"""Tenths of the tracks that are kept."""


def measure(drive: Drive, *, frames: int, tenths: Sequence[int] = TENTHS) -> Part:
    """Thin the tracks of the first frames of a drive, and time the standard filter on what is left."""
    beginning = drive.first(frames)
    track = beginning.dataset.sequence.track
    found = []
    with threadpool_limits(1):
        for kept in tenths:
            run = timed(beginning.thinned(track % 10 < kept), EkfOptions(finished="as_left"))
            held = np.array([sizes.known + sizes.new for sizes in run.sizes[1:]])
            found.append((float(held.mean()), float(np.median(run.step_time[1:]))))
    in_view, step = np.array(found).T
    overall, upper = exponent(in_view, step), exponent(in_view[-2:], step[-2:])
    return Part(
        title=f"tracks: {drive.name}, thinned, first {len(beginning.dataset.sequence)} frames",
        header=["tracks kept", "in view, mean", "step, median [ms]", "ratio to the fewest"],
        rows=[
            [f"{10 * kept} %", f"{held:.0f}", milliseconds(time), f"{time / step[0]:.1f}"]
            for kept, held, time in zip(tenths, in_view, step, strict=True)
        ],
        notes=(
            f"step time goes with the tracks to the power {overall:.2f}; {upper:.2f} between the last two",
        ),
        values={
            "tenths_kept": list(tenths),
            "in_view": in_view.tolist(),
            "step_median_s": step.tolist(),
            "ratio_to_fewest": (step / step[0]).tolist(),
            "exponent": overall,
            "exponent_last_two": upper,
        },
    )
