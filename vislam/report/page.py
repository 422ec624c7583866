"""The self-contained report page."""

import base64
import gzip
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from plotly.offline import get_plotlyjs

from vislam.base.files import remove, write_text
from vislam.base.types import Array
from vislam.core.record import Record
from vislam.core.run import Run
from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import AblationStep
from vislam.evaluation.definitions import DEFINITIONS
from vislam.evaluation.metric import ESTIMATE_TITLES, METRICS
from vislam.evaluation.spread import Spread
from vislam.report.figures import Drawing, figure_names
from vislam.report.images import pictures_data
from vislam.report.page_parts import draw_table, inline_svg, part, render
from vislam.report.page_tables import (
    ablation_table,
    certainty_table,
    counts_table,
    errors_table,
    grouped,
    lags_table,
    maps_table,
    pairs_table,
    repairs_table,
    shared_errors_table,
    smoothing_table,
    worst_table,
)
from vislam.report.scene import scene_note
from vislam.report.svg import SIMPLIFIED
from vislam.report.table import comparison_tables
from vislam.report.verdict import verdict

WIDE = ("top_view", "ablation_chain")
"""Figures that take the whole width of a page."""
MOST_CHECKS = 10
"""Checks up to which those that hold are shown one by one."""
_DRAWN_WHOLE = 2000
"""Frames of which nothing is left out that anybody would look for."""
MOST_EVENTS = 200
"""Events of a run that a page lists; ``metrics.json`` has all."""
_ABSCISSA = 1000
"""Points of the distance over time that a page has at most."""


@dataclass(frozen=True)
class Content:
    """What a page shows of a comparison.

    Attributes
    ----------
    title : str
    runs : mapping of str to Run
    record : Record
        Of the drive.
    evaluation : Evaluation
    steps : sequence of AblationStep
    figures : mapping of str to Drawing
    scene : mapping
        What :func:`vislam.report.scene.scene_data` gives; empty for a page without a scene.
    travelled : (Array, Array)
        Times [s] and the distances travelled until then [m], by which a page draws time as distance.
    config : str
        The effective configuration.
    checks : sequence of (holds, text)
        Shown first; None where it cannot be told whether a check holds.
    frozen : str
        What there is to say of the common list of observations.
    unequal : str
        In what the runs' information differed; empty if in nothing.
    spread : Spread or None
        What choices of the settings do to the errors, as far as that is known.
    noticed : sequence of str
        What of trajectories from elsewhere would fool their scores, and of what runs the times are no fair
        comparison.
    """

    title: str
    runs: Mapping[str, Run]
    record: Record
    evaluation: Evaluation
    steps: Sequence[AblationStep]
    figures: Mapping[str, Drawing]
    scene: Mapping[str, Any]
    travelled: tuple[Array, Array]
    config: str
    checks: Sequence[tuple[bool | None, str]] = ()
    common_set: str = ""
    unequal: str = ""
    spread: Spread | None = None
    noticed: Sequence[str] = ()


def write_page(path: Path, content: Content) -> None:
    """Write the page, whole or not at all; it needs no other file and no network."""
    runs, record, evaluation, scene = content.runs, content.record, content.evaluation, content.scene
    tables = comparison_tables(runs, evaluation)
    rows = {row[0] for table in tables.values() for row in table.rows}
    shown = [spec for spec in METRICS.values() if spec.label in rows and spec.key in DEFINITIONS]
    told = verdict(runs, evaluation, record.reference, unequal=content.unequal, spread=content.spread)
    pictures = pictures_data(record, runs)
    text = render(
        "page.html",
        title=content.title,
        notes=record.notes,
        failures=[(name, run.log.error) for name, run in runs.items() if not run.complete],
        checks=[one for one in content.checks if one[0] is not True or len(content.checks) <= MOST_CHECKS],
        held=[text for holds, text in content.checks if holds and len(content.checks) > MOST_CHECKS],
        answer=told.answer,
        summary=told.summary,
        verdict=[*content.noticed, *told.reasons],
        reference=record.reference,
        tables=[(ESTIMATE_TITLES[estimate], grouped(table)) for estimate, table in tables.items()],
        defined={spec.label: f"metric-{spec.key}" for spec in shown},
        definitions=[(spec.key, spec.label, DEFINITIONS[spec.key]) for spec in shown],
        errors=errors_table(evaluation),
        steps=ablation_table(content.steps),
        pairs=pairs_table(evaluation),
        certainty=certainty_table(evaluation),
        smoothing=smoothing_table(evaluation),
        maps=maps_table(evaluation),
        worst=worst_table(evaluation),
        lags=lags_table(evaluation),
        shared=shared_errors_table(runs),
        figures_note=_figures_note(len(record.stamp)),
        figures=[(name, drawing, inline_svg(name, drawing)) for name, drawing in content.figures.items()],
        wide=WIDE,
        travelled=htmlsafe_json_dumps(_abscissa(*content.travelled)),
        scene=htmlsafe_json_dumps(scene) if scene else "",
        pictures=htmlsafe_json_dumps(pictures) if pictures else "",
        images_js=part("images.js"),
        scene_note=scene_note(scene) if scene else "",
        counts=counts_table(record.counts, record.repairs, runs),
        repairs=repairs_table(record.repairs),
        common_set=content.common_set,
        events={
            name: (len(run.log.events), run.log.events[:MOST_EVENTS])
            for name, run in runs.items()
            if run.log.events
        },
        provenance="\n".join(f"{key}: {value}" for key, value in record.provenance.items()),
        config=content.config,
        draw=draw_table,
        figures_js=part("figures.js"),
        scene_js=part("scene.js"),
        plotly=_packed_plotly() if scene else "",
    )
    write_text(path, text)


@cache
def _packed_plotly() -> str:
    """The library that draws the scene, compressed: it was two thirds of a page."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode("ascii")


def _abscissa(time: Array, distance: Array) -> list[list[float]]:
    """Times and distances, thinned out and rounded to what a figure shows."""
    if not len(time):
        return []
    rows = np.unique(np.linspace(0, len(time) - 1, min(len(time), _ABSCISSA)).astype(int))
    return [[round(float(value), 3) for value in values[rows]] for values in (time, distance)]


def _figures_note(frames: int) -> str:
    """What of long sequences is drawn; empty where that is all."""
    if frames <= _DRAWN_WHOLE:
        return ""
    return (
        f"Of {frames:,} frames what can be told apart is drawn: lines to within {SIMPLIFIED:g} points of the "
        "figure, areas and bands by their extremes, so that no peak is lost, of marks on each other one, and "
        "of errors on each other the largest. All numbers are of all frames."
    )


def clear_report(folder: Path) -> None:
    """Remove the page and the figures of earlier results, which would stand beside newer metrics."""
    remove(folder / "report.html")
    for name in figure_names():
        for suffix in ("svg", "png"):
            remove(folder / "figures" / f"{name}.{suffix}")
    with suppress(OSError):
        (folder / "figures").rmdir()
