"""The self-contained report page."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import jinja2
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from vislam.base.files import remove, write_text
from vislam.base.legible import visible_lines
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.core.sequence import Repair
from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import Rung
from vislam.evaluation.definitions import DEFINITIONS
from vislam.evaluation.metric import ESTIMATE_TITLES, METRICS
from vislam.evaluation.spread import Spread
from vislam.report.figures import Drawing, figure_names
from vislam.report.page_parts import draw_table, inline_svg, part
from vislam.report.page_tables import (
    counts_table,
    lags_table,
    maps_table,
    pairs_table,
    repairs_table,
    rungs_table,
    smoothing_table,
    worst_table,
)
from vislam.report.table import Table, comparison_tables
from vislam.report.verdict import verdict


def write_page(
    path: Path,
    *,
    title: str,
    notes: tuple[str, ...],
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    rungs: Sequence[Rung],
    reference: Reference | None,
    counts: Mapping[str, int],
    repairs: Sequence[Repair],
    frozen: str,
    figures: Mapping[str, Drawing],
    scene: Mapping[str, Any],
    provenance: str,
    config: str,
    checks: Sequence[tuple[bool | None, str]] = (),
    unequal: str = "",
    spread: Spread | None = None,
    noticed: Sequence[str] = (),
) -> None:
    """Write the page, whole or not at all; it needs no other file and no network.

    Parameters
    ----------
    scene : mapping
        What :func:`vislam.report.scene.scene_data` gives; empty for a page without a scene.
    checks : sequence of (holds, text)
        Shown first; None where it cannot be told whether a check holds.
    unequal : str
        In what the runs' information differed; empty if in nothing.
    spread : Spread or None
        What choices of the settings do to the errors, as far as that is known.
    noticed : sequence of str
        What of trajectories from elsewhere would fool their scores.
    """
    tables = comparison_tables(runs, evaluation)
    rows = {row[0] for table in tables.values() for row in table.rows}
    shown = [spec for spec in METRICS.values() if spec.label in rows and spec.key in DEFINITIONS]
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, finalize=_visible)
    template = environment.from_string(part("page.html"))
    text = template.render(
        title=title,
        notes=notes,
        failures=[(name, run.log.error) for name, run in runs.items() if not run.complete],
        checks=checks,
        verdict=[*noticed, *verdict(runs, evaluation, reference, unequal=unequal, spread=spread)],
        reference=reference,
        tables=[(ESTIMATE_TITLES[estimate], _turned(table)) for estimate, table in tables.items()],
        defined={spec.label: f"metric-{spec.key}" for spec in shown},
        definitions=[(spec.key, spec.label, DEFINITIONS[spec.key]) for spec in shown],
        rungs=rungs_table(rungs),
        pairs=pairs_table(evaluation),
        smoothing=smoothing_table(evaluation),
        maps=maps_table(evaluation),
        worst=worst_table(evaluation),
        lags=lags_table(evaluation),
        figures=[(name, drawing, inline_svg(name, drawing)) for name, drawing in figures.items()],
        scene=htmlsafe_json_dumps(scene) if scene else "",
        scene_note=_scene_note(scene) if scene else "",
        counts=counts_table(counts, repairs, runs),
        repairs=repairs_table(repairs),
        frozen=frozen,
        events={name: run.log.events for name, run in runs.items() if run.log.events},
        provenance=provenance,
        config=config,
        draw=draw_table,
        css=part("page.css"),
        page_js=part("page.js"),
        scene_js=part("scene.js"),
        plotly=Markup(get_plotlyjs()) if scene else "",
    )
    write_text(path, text)


def clear_report(folder: Path) -> None:
    """Remove the page and the figures of earlier results, which would stand beside newer metrics."""
    remove(folder / "report.html")
    for name in figure_names():
        remove(folder / "figures" / f"{name}.png")
    with suppress(OSError):
        (folder / "figures").rmdir()


def _visible(value: Any) -> Any:
    """Text of the results without control characters; what this package writes is a Markup and stays."""
    return visible_lines(value) if type(value) is str else value


def _scene_note(scene: Mapping[str, Any]) -> str:
    """What the scene leaves out or makes up."""
    drawn = ", ".join(
        f"{run['landmarks_drawn']} of {run['landmarks_all']} of {run['name']}"
        for run in scene["runs"]
        if run["landmarks_all"]
    )
    said = f"Landmarks drawn: {drawn}; those far from all the paths are left out. " if drawn else ""
    flat = scene["reference"] is not None and scene["reference"]["flat"]
    return said + ("The reference has no height and lies at that of the start." if flat else "")


def _turned(table: Table) -> Table:
    """The table with rows and columns exchanged: a row for each estimator."""
    header, *rows = zip(table.header, *table.rows, strict=True)
    return Table(["estimator", *header[1:]], rows)
