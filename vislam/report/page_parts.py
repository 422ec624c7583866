"""Parts that pages are made of: texts of this package, figures and tables as HTML."""

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup, escape

from vislam.base.legible import visible, visible_lines
from vislam.report.colours import COLOURS
from vislam.report.figures import Drawing
from vislam.report.svg import themed_svg
from vislam.report.table import Table

_HINT = 'data-hint="scroll sideways \u2194"'
"""What a box says when not all of it is seen."""


def part(name: str) -> Markup:
    """Text of a file of this package, which is not escaped."""
    return Markup(files("vislam.report").joinpath(name).read_text("utf-8"))


def render(name: str, **content: Any) -> str:
    """Page of a template of this package, with its style and script.

    Text of the results is shown without control characters; what this package writes is a Markup and stays.
    """
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=lambda value: visible_lines(value) if type(value) is str else value,
        loader=jinja2.FunctionLoader(part),
    )
    return environment.get_template(name).render(**content, css=part("page.css"), page_js=part("page.js"))


def inline_svg(name: str, drawing: Drawing) -> Markup:
    """A figure as a labelled element in a box that scrolls; ``name`` goes before its ids."""
    svg = themed_svg(drawing.svg, drawing.figure, name, colours=COLOURS)
    label = escape(f"{drawing.title}: {drawing.caption}")
    drawn = svg.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)
    title = escape(drawing.title)
    return Markup(
        f'<div class="wide" tabindex="0" role="group" aria-label="{title}, can be scrolled" {_HINT}>'
        f"{drawn}</div>"
    )


def draw_table(table: Table, caption: str, kind: str, defined: Mapping[str, str] | None = None) -> Markup:
    """A table in a box of its own that scrolls; the first cell of a row is the row's header.

    ``defined`` has the id of the definition of those column titles that have one on the page.
    """
    header = "".join(
        f'<th scope="col">{_titled(cell, (defined or {}).get(cell))}</th>' for cell in table.header
    )
    body = "".join(
        f'<tr><th scope="row">{escape(visible(row[0]))}</th>'
        + "".join(f"<td>{escape(visible(cell))}</td>" for cell in row[1:])
        + "</tr>"
        for row in table.rows
    )
    label = escape(caption)
    return Markup(
        f'<div class="wide" tabindex="0" role="group" aria-label="{label}, can be scrolled" {_HINT}>'
        f'<table class="{kind}" aria-label="{label}"><thead><tr>{header}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _titled(title: str, definition: str | None) -> Markup:
    """Title of a column, with a link to its definition."""
    text = escape(visible(title))
    if definition is None:
        return text
    link = f'<a class="what" href="#{escape(definition)}" aria-label="Definition: {text}">?</a>'
    return Markup(f"{text} {link}")
