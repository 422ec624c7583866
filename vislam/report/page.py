"""The self-contained report page."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup, escape
from plotly.offline import get_plotlyjs

from vislam.data import Repair
from vislam.data.reference import Reference
from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import Rung
from vislam.files import replace_whole
from vislam.report.figures import Drawing
from vislam.report.page_tables import (
    counts_table,
    maps_table,
    pairs_table,
    repairs_table,
    rungs_table,
    worst_table,
)
from vislam.report.shown import COLOURS
from vislam.report.svg import themed_svg
from vislam.report.table import Table, comparison_table
from vislam.report.verdict import verdict
from vislam.run import Run


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
) -> None:
    """Write the page, whole or not at all; it needs no other file and no network.

    Parameters
    ----------
    scene : mapping
        What :func:`vislam.report.scene.scene_data` gives; empty for a page without a scene.
    checks : sequence of (holds, text)
        Shown first; None where it cannot be told whether a check holds.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(_part("page.html"))
    text = template.render(
        title=title,
        notes=notes,
        failures=[(name, run.error) for name, run in runs.items() if not run.complete],
        checks=checks,
        verdict=verdict(runs, evaluation, reference),
        reference=reference,
        table=_turned(comparison_table(runs, evaluation)),
        rungs=rungs_table(rungs),
        pairs=pairs_table(evaluation),
        maps=maps_table(evaluation),
        worst=worst_table(evaluation),
        figures=[(name, drawing, _inline(name, drawing)) for name, drawing in figures.items()],
        scene=htmlsafe_json_dumps(scene) if scene else "",
        scene_note=_scene_note(scene) if scene else "",
        counts=counts_table(counts, repairs, runs),
        repairs=repairs_table(repairs),
        frozen=frozen,
        events={name: run.events for name, run in runs.items() if run.events},
        provenance=provenance,
        config=config,
        draw=_draw,
        css=_part("page.css"),
        page_js=_part("page.js"),
        scene_js=_part("scene.js"),
        plotly=Markup(get_plotlyjs()) if scene else "",
    )
    with replace_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _part(name: str) -> Markup:
    """Text of a file of this package, which is not escaped."""
    return Markup(files("vislam.report").joinpath(name).read_text("utf-8"))


def _inline(name: str, drawing: Drawing) -> Markup:
    svg = themed_svg(drawing.figure, name, colours=COLOURS)
    label = escape(f"{drawing.title}: {drawing.caption}")
    return Markup(svg.replace("<svg", f'<svg role="img" aria-label="{label}"', 1))


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


def _draw(table: Table, caption: str, kind: str) -> Markup:
    """A table in a box of its own that scrolls; the first cell of a row is the row's header."""
    header = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in table.rows
    )
    label = escape(caption)
    return Markup(
        f'<div class="wide" tabindex="0" role="group" aria-label="{label}, can be scrolled">'
        f'<table class="{kind}" aria-label="{label}"><thead><tr>{header}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
