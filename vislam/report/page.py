"""The self-contained report page."""

import base64
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import jinja2
from markupsafe import Markup, escape

from vislam.data import Repair
from vislam.data.reference import Reference
from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import Rung
from vislam.evaluation.evaluate import headline
from vislam.files import replace_whole
from vislam.report.table import Table, comparison_table
from vislam.run import Run

_CAPTIONS = {
    "top_view": "Paths and landmarks from above, each path aligned with the reference.",
    "error": "Position error after rigid alignment over the distance driven.",
    "height_attitude": "Height and attitude.",
    "nis": "Normalised innovation squared: above 1 the model claims too little noise, below 1 too much.",
    "step_time": "Time of each step.",
}


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
    figures: Mapping[str, Path],
    provenance: str,
    config: str,
) -> None:
    """Write the page, whole or not at all; figures are PNG files, taken into it."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(files("vislam.report").joinpath("page.html").read_text("utf-8"))
    text = template.render(
        title=title,
        notes=notes,
        failures=[(name, run.error) for name, run in runs.items() if not run.complete],
        verdict=verdict(runs, evaluation, reference),
        reference=reference,
        table=comparison_table(runs, evaluation),
        rungs=_rungs(rungs),
        pairs=_pairs(evaluation),
        figures=[
            (name, caption, base64.b64encode(figures[name].read_bytes()).decode("ascii"))
            for name, caption in _CAPTIONS.items()
            if name in figures
        ],
        counts=_counts(counts, repairs, runs),
        repairs=_repairs(repairs),
        frozen=frozen,
        events={name: run.events for name, run in runs.items() if run.events},
        provenance=provenance,
        config=config,
        draw=_draw,
    )
    with replace_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def verdict(runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None) -> str:
    """One sentence: who came closest, or that nobody can tell."""
    if reference is None:
        return "Without a reference nothing here says who is right; see how far the estimates are apart."
    scored = {name: evaluation.value(name, headline(reference)) for name, run in runs.items() if run.complete}
    ranked = sorted((value, name) for name, value in scored.items() if value is not None)
    if not ranked:
        return "No estimator finished, so there is no verdict."
    listed = ", ".join(f"{name} {value:.2f} m" for value, name in ranked)
    return f"Closest to {reference.name} is {ranked[0][1]} (ATE after rigid alignment: {listed})."


def _rungs(rungs: Sequence[Rung]) -> Table:
    header = ["rung", "adds", "ATE [m]", "change [m]", "as known at each time [m]", "the same less ATE [m]"]
    rows = [
        [
            rung.run,
            rung.adds,
            _metres(rung.error, ".2f"),
            _metres(rung.change, "+.2f"),
            _metres(rung.causal, ".2f"),
            _metres(rung.causal_less_final, "+.2f"),
        ]
        for rung in rungs
    ]
    return Table(header, rows)


def _metres(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _pairs(evaluation: Evaluation) -> Table:
    rows = [
        [
            metric.estimator.replace("|", " and "),
            metric.key.replace("_", " "),
            f"{metric.value:.2f}",
            metric.unit,
        ]
        for metric in evaluation.metrics
        if "|" in metric.estimator
    ]
    return Table(["estimators", "measure", "value", "unit"], rows)


def _counts(counts: Mapping[str, int], repairs: Sequence[Repair], runs: Mapping[str, Run]) -> Table:
    elsewhere = {key for step in repairs for key in step.counts}
    rows = [["data", key.replace("_", " "), str(counts[key])] for key in counts if key not in elsewhere]
    for name, run in runs.items():
        own = {"observations gated": int(run.gated.sum()), **run.counts}
        rows += [[name, key.replace("_", " "), str(value)] for key, value in own.items()]
    return Table(["where", "what", "count"], rows)


def _repairs(repairs: Sequence[Repair]) -> Table:
    """What became of each step; one that is switched off is listed too."""
    rows = []
    for step in repairs:
        options = ", ".join(f"{key.replace('_', ' ')} {_plain(value)}" for key, value in step.options.items())
        done = ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in step.counts.items())
        rows.append([step.name.replace("_", " "), (options or "on") if step.applied else "off", done])
    return Table(["repair", "setting", "counted"], rows)


def _plain(value: object) -> str:
    return " ".join(str(item) for item in value) if isinstance(value, tuple | list) else str(value)


def _draw(table: Table) -> Markup:
    header = "".join(f"<th>{escape(cell)}</th>" for cell in table.header)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    return Markup(f"<table><thead><tr>{header}</tr></thead><tbody>{body}</tbody></table>")
