"""The self-contained page of a study."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from markupsafe import Markup

from vislam.base.errors import first_line
from vislam.base.files import write_text
from vislam.evaluation.metric import ESTIMATE_TITLES
from vislam.report.figures import Drawing
from vislam.report.page_parts import draw_table, inline_svg, render
from vislam.report.table import Table
from vislam.study.ablation import Ablation
from vislam.study.answers import CLAIMED, trial_bound
from vislam.study.page import ablation as study_ablation
from vislam.study.page.figures import all_figures
from vislam.study.page.labels import errors
from vislam.study.page.limits import bound_table, lags_table
from vislam.study.page.tables import (
    consistency_table,
    errors_table,
    failed_table,
    failures_table,
    pairs_table,
    ranking_table,
)
from vislam.study.page.verdict import verdict
from vislam.study.settings import Ranking
from vislam.study.trials import Trials

_UNDRAWABLE = (ArithmeticError, ValueError)
"""What Matplotlib raises where numbers are beyond what an axis holds, or a text is no label."""


def write_study_page(
    path: Path,
    *,
    title: str,
    trials: Trials,
    notes: Sequence[str],
    config: str,
    provenance: str,
    ablation: Ablation | None = None,
    ranking: Ranking | None = None,
) -> None:
    """Write the page, whole or not at all; it needs no other file and no network.

    Parameters
    ----------
    path : Path
    title : str
    trials : Trials
    notes : sequence of str
        Shown before the verdict.
    config, provenance : str
        Effective configuration of the study, and what it was run with.
    ablation : Ablation, optional
        Whose cases the points are.
    ranking : Ranking, optional
        Which metric is held against errors.
    """
    told, tables, draw_all = verdict(trials), [], partial(all_figures, trials)
    if ablation is not None and errors(trials):
        told = study_ablation.verdict(trials, ablation)
        tables = [
            study_ablation.mending_table(trials, ablation),
            study_ablation.defects_table(trials, ablation),
        ]
        draw_all = partial(study_ablation.ablation_figures, trials, ablation)
    figures, lacking = _drawn(draw_all)
    text = render(
        "study.html",
        title=title,
        notes=[*notes, *lacking],
        verdict=told,
        ablation=tables,
        errors=_blocks(trials, errors_table),
        consistency=_blocks(trials, consistency_table),
        bounds=_blocks(trials, bound_table),
        lags=lags_table(trials),
        ranking=Table([], []) if ranking is None else ranking_table(trials, ranking),
        pairs=_blocks(trials, pairs_table) if ablation is None else [],
        failures=failures_table(trials),
        failed=failed_table(trials),
        bound=f"{trial_bound():.2f}",
        claimed=f"{100.0 * CLAIMED:.2f}",
        figures=figures,
        config=config,
        provenance=provenance,
        draw=draw_table,
    )
    write_text(path, text)


def _blocks(trials: Trials, make: Callable[[Trials], Table]) -> list[tuple[str, Table]]:
    """A table of each estimate that has rows, with its title: like is compared with like."""
    tables = [(ESTIMATE_TITLES[estimate], make(trials.of(estimate))) for estimate in trials.estimates]
    return [(title, table) for title, table in tables if table.rows]


def _drawn(
    draw_all: Callable[[], Mapping[str, Drawing]],
) -> tuple[list[tuple[str, Drawing, Markup]], list[str]]:
    """Figures as elements of the page, and a line for what no axis can hold, such as an error of 1e200 m."""
    figures, lacking = [], []
    with warnings.catch_warnings():
        # That nothing on a logarithmic axis is positive shows in the figure.
        warnings.simplefilter("ignore")
        try:
            drawings = draw_all()
        except _UNDRAWABLE as error:
            drawings = {}
            lacking.append(f"no figure could be drawn ({first_line(error)})")
        for name, drawing in drawings.items():
            try:
                figures.append((name, drawing, inline_svg(name, drawing)))
            except _UNDRAWABLE as error:
                lacking.append(f"the figure {drawing.title} could not be drawn ({first_line(error)})")
    return figures, lacking
