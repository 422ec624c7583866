"""Pictures of a run that comes from images: tracks in them with what became of each, and disparities."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vislam.base.legible import literal
from vislam.core.record import Record
from vislam.core.run import Run
from vislam.core.strip import HELD_OUT, Strip
from vislam.report.canvas import legend, panels
from vislam.report.shown import Shown

FATES = {
    "f": "fused",
    "g": "rejected by the gate",
    "n": "given, not fused",
    "h": "held out",
    "c": "left out (short track, or by the repairs)",
}
"""What became of an observation, by the letter that the page has for it."""
_BINS = 60
_WIDEST = 99.0
"""Percentile of the disparities at which their histogram ends."""


def pictures_data(record: Record, runs: Mapping[str, Run]) -> dict[str, Any]:
    """What the page draws its pictures from; empty where the tracks are not of images.

    Pictures have their time [s] and frame, the places of the observations in them [px], and, for each run of
    the comparison, a letter of ``FATES`` for each observation.
    """
    strip, given = record.strip, len(record.given.track)
    if strip is None or not len(strip.frame):
        return {}
    own = {name: run for name, run in runs.items() if not run.elsewhere and len(run.used) == given}
    fates = {name: _fates(strip, run) for name, run in own.items()}
    pictures = []
    for index, frame in enumerate(strip.frame.tolist()):
        rows = strip.picture == index
        pictures.append(
            {
                "frame": frame,
                "time": round(float(record.stamp[frame] - record.stamp[0]), 2),
                "jpeg": strip.jpeg[index],
                "at": np.rint(strip.left[rows]).astype(int).ravel().tolist(),
                "fate": {name: "".join(letters[rows]) for name, letters in fates.items()},
            }
        )
    return {
        "width": strip.width,
        "height": strip.height,
        "fates": FATES,
        "runs": list(own),
        "pictures": pictures,
    }


def _fates(strip: Strip, run: Run) -> Any:
    """A letter for each observation of a strip, ``(q,)``."""
    letters = np.where(strip.row == HELD_OUT, "h", "c")
    given = strip.row >= 0
    row = strip.row[given]
    reached = np.where(run.used[row], "f", np.where(run.gated[row], "g", "n"))
    letters[given] = reached
    return letters


def disparities(shown: Shown) -> Figure | None:
    """How many observations have which disparity, given and fused; None where tracks are not of images."""
    given = shown.record.given
    if shown.record.strip is None or not len(given.track):
        return None
    disparity = given.z[:, 0] - given.z[:, 1]
    edges = np.linspace(0.0, max(float(np.percentile(disparity, _WIDEST)), 1.0), _BINS + 1).tolist()
    figure, (axes,) = panels(1, 3.2)
    axes.hist(disparity, edges, color="0.8", label="given, repaired")
    for name in shown.seeing():
        axes.hist(
            disparity[shown.runs[name].used],
            edges,
            histtype="step",
            color=shown.colour(name),
            label=literal(name),
        )
    axes.set(xlabel="disparity [px]", ylabel="observations", xlim=(0.0, edges[-1]))
    legend(figure, axes)
    return figure
