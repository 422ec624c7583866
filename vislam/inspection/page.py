"""Output of an inspection: ``inspection.json``, its figures, and a self-contained page."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from vislam.base.files import write_text
from vislam.comparison import config as configuration
from vislam.comparison.provenance import provenance
from vislam.inspection.figures import OF_CHECKS, drawings
from vislam.inspection.finding import Finding, Inspection
from vislam.report.figures import Drawing
from vislam.report.page_parts import draw_table, inline_svg, render
from vislam.report.svg import save_png
from vislam.report.table import Table

SCHEMA_VERSION = 1
PAGE = "inspection.html"


def write_inspection(folder: Path, result: Inspection, *, synthetic: bool, config: str = "") -> Path:
    """Write findings, figures and page, each file whole or not at all; return the page.

    Parameters
    ----------
    folder : Path
    result : Inspection
    synthetic : bool
        Whether the data was simulated.
    config : str
        The proposed config as text; empty for a page without one.
    """
    made = provenance()
    document = {
        "schema_version": SCHEMA_VERSION,
        "name": result.name,
        "synthetic": synthetic,
        "findings": [_finite(asdict(finding)) for finding in result.findings],
        "proposal": _finite(result.proposal),
        "settings": _finite(result.settings),
        "unknown": result.unknown,
        "provenance": made,
    }
    write_text(folder / "inspection.json", json.dumps(document, indent=1) + "\n")
    title = f"{result.name}{' [SIMULATED]' if synthetic else ''}"
    drawn = drawings(result, title=title)
    for name, drawing in drawn.items():
        save_png(drawing.figure, folder / f"{name}.png")
    text = render(
        "inspection.html",
        title=f"vislam inspection: {title}",
        synthetic=synthetic,
        headline=headline(result.findings),
        findings=[(finding, _figure_of(finding, drawn)) for finding in result.findings],
        figures=[(name, drawing, inline_svg(name, drawing)) for name, drawing in drawn.items()],
        measured=_measured(result.findings),
        counts=_counts(result.findings),
        proposal=_listed(("key", "value"), result.proposal),
        unknown=Table(("key", "why"), [[key, reason] for key, reason in result.unknown.items()]),
        config=config,
        provenance="\n".join(f"{key}: {value}" for key, value in made.items()),
        draw=draw_table,
    )
    write_text(folder / PAGE, text)
    return folder / PAGE


def headline(findings: Sequence[Finding]) -> str:
    """One sentence: what is wrong with the recording, as it is configured."""
    of = {word: [item.check for item in findings if item.verdict == word] for word in ("fault", "unclear")}
    told = [f"{len(of['fault'])} of {len(findings)} checks found a fault"]
    told[0] += f" ({', '.join(of['fault'])})" if of["fault"] else ""
    if of["unclear"]:
        told.append(f"the data cannot tell {len(of['unclear'])} ({', '.join(of['unclear'])})")
    return f"{'; '.join(told)}."


def _figure_of(finding: Finding, drawn: dict[str, Drawing]) -> str:
    """Name of the figure that a finding is seen in; empty if there is none."""
    return next((name for name, checks in OF_CHECKS.items() if name in drawn and finding.check in checks), "")


def _measured(findings: Sequence[Finding]) -> Table:
    rows = [
        [f"{item.check}: {one.name}", *(f"{value:.4g}" for value in (one.value, one.low, one.high)), one.unit]
        for item in findings
        for one in item.measured
    ]
    return Table(("what", "value", "from", "to", "unit"), rows)


def _counts(findings: Sequence[Finding]) -> Table:
    rows = [
        [f"{item.check}: {key.replace('_', ' ')}", f"{value:g}"]
        for item in findings
        for key, value in item.counts.items()
    ]
    return Table(("what", "count"), rows)


def _listed(header: tuple[str, str], values: dict[str, object]) -> Table:
    return Table(header, [[key, configuration.inline(value)] for key, value in values.items()])


def _finite(value: object) -> object:
    """Plain data for JSON: numbers that are none become null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
