"""``index.html``: a page that links the pages of all entries and draws their headline figures over time."""

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from vislam.base.files import write_text
from vislam.base.legible import literal
from vislam.ledger.entries import HEADLINES, Entry
from vislam.ledger.table import HEADER, rows
from vislam.report.canvas import legend, logarithmic, panels
from vislam.report.colours import colours
from vislam.report.figures import Drawing
from vislam.report.page_parts import inline_svg, render

INDEX = "index.html"
_LABELS = {"error": "ATE [m]", "held-out": "held-out [px]", "NEES": "NEES per dof", "time": "total time [s]"}
_MOST_FIGURES = 12
"""Configs whose figures are drawn, those with the newest entries first."""


def write_index(folder: Path, entries: Sequence[Entry]) -> Path:
    """Write the page, whole or not at all; links lead from it to the pages of the entries."""
    drawn = _drawings(entries)
    text = render(
        "ledger.html",
        title="vislam results",
        extent=f"{len(entries)} entries. A row leads to its page, where it has one; a header sorts.",
        header=HEADER,
        entries=[
            (None if entry.page is None else _link(entry.page, folder), row)
            for entry, row in zip(entries, rows(entries, below=folder), strict=True)
        ],
        figures=[(name, drawing, inline_svg(name, drawing)) for name, drawing in drawn.items()],
    )
    write_text(folder / INDEX, text)
    return folder / INDEX


def _link(page: Path, folder: Path) -> str:
    return quote(os.path.relpath(page, folder).encode(errors="surrogateescape"))


def _drawings(entries: Sequence[Entry]) -> dict[str, Drawing]:
    """A figure for each config on each data that has figures, by the newest."""
    groups: dict[tuple[str, str, str], list[Entry]] = {}
    for entry in entries:
        if entry.metrics:
            groups.setdefault((entry.kind, entry.name, entry.data), []).append(entry)
    found = {}
    for index, ((kind, name, data), some) in enumerate(groups.items()):
        figure = _over_time(some) if index < _MOST_FIGURES else None
        if figure is not None:
            caption = f"{len(some)} {kind}{'' if len(some) == 1 else 's'}: headline figures by date."
            found[f"ledger_{index}"] = Drawing(f"{name} on {data}", caption, figure)
    return found


def _over_time(entries: Sequence[Entry]) -> Figure | None:
    """A panel for each headline figure that there is, a line for each estimator."""
    ordered = sorted(entries, key=lambda entry: entry.when)
    names = list(dict.fromkeys(name for entry in ordered for name in entry.estimators))
    values = {
        what: {name: [entry.headline(name, what) for entry in ordered] for name in names}
        for what in HEADLINES
    }
    shown = [
        what for what, of in values.items() if any(one is not None for row in of.values() for one in row)
    ]
    if not shown:
        return None
    figure, cells = panels(len(shown), 0.9 + 1.4 * len(shown))
    when = np.array([entry.when.replace(tzinfo=None) for entry in ordered], "datetime64[s]")
    for axes, what in zip(cells, shown, strict=True):
        for name, colour in colours(names).items():
            row = np.array([np.nan if one is None else one for one in values[what][name]], float)
            if np.isfinite(row).any():
                with mpl.rc_context({"date.converter": "concise"}):
                    axes.plot(when, row, "o-", ms=4, lw=1.0, color=colour, label=literal(name))
        axes.set_ylabel(_LABELS[what])
        logarithmic(axes)
    cells[-1].margins(x=0.1)
    if when[0] == when[-1]:
        # A single date would be drawn within years.
        half = np.timedelta64(12, "h")
        cells[-1].set_xlim(when[0] - half, when[0] + half)
    legend(figure, *cells)
    return figure
