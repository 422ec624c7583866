"""A figure as SVG for a page: no colours of its own, but those of the page's theme."""

import io
import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from vislam.base.files import replace_whole, write_text
from vislam.report.canvas import TIME

SIMPLIFIED = 0.3
"""How far a simplified path may be from the true one [pt]."""
_IMAGE_DPI = 150
"""Resolution of what is rasterised inside [px/inch]."""
_SERIES = 2000
"""Letters of a path from which on a tenth of a point is not seen."""
_DPI = 110
"""Resolution of a file [px/inch]."""
_LEGIBLE = 11.0
"""Smallest letters on any screen [px]; where they would be smaller, the figure scrolls instead."""
_PAGE_COLOURS = {"#000000": "currentColor", "#ffffff": "var(--paper)", "#cccccc": "var(--band)"}
_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


def plain_svg(figure: Figure) -> str:
    """SVG element of a figure, in its own colours; the same figure gives the same letters."""
    settle(figure)
    buffer = io.StringIO()
    with mpl.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "vislam", "path.simplify_threshold": SIMPLIFIED}
    ):
        figure.savefig(buffer, format="svg", dpi=_IMAGE_DPI, transparent=True, metadata=_METADATA)
    text = buffer.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    return re.sub(r' d="[^"]*"', lambda path: _brief(path[0]), text)


def save_svg(drawn: str, path: Path) -> None:
    """Write an element as a file, on white paper, whole or not at all."""
    head, rest = drawn.split(">", 1)
    write_text(path, f'{head}>\n <rect width="100%" height="100%" fill="#ffffff"/>{rest}')


def themed_svg(drawn: str, figure: Figure, prefix: str, *, colours: Sequence[str]) -> str:
    """SVG element to be put into a page.

    Black becomes the colour of the page's text, white that of its paper, light grey that of its bands, and
    each of ``colours`` the page's variable ``--c0``, ``--c1``, ...
    Panels over time are described in ``data-panels``, from which the page draws them over the distance.

    Parameters
    ----------
    drawn : str
        What :func:`plain_svg` gives of the figure.
    figure : Figure
    prefix : str
        Put before every id, since ids of several figures share the page.
    colours : sequence of str
        ``#rrggbb`` of the series.
    """
    head, rest = drawn.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    assert view is not None
    # The style sheet is the document's; a page has its own, which names the family once.
    rest = re.sub(r"<style.*?</style>", "", rest, flags=re.DOTALL)
    rest = re.sub(r"font-family: [^;\"]*;? ?", "", rest)
    rest = re.sub(r'\bid="', f'id="{prefix}-', rest)
    rest = rest.replace("url(#", f"url(#{prefix}-").replace("xlink:href", "href")
    rest = rest.replace('href="#', f'href="#{prefix}-')
    series = {colour.lower(): f"var(--c{index})" for index, colour in enumerate(colours)}
    for colour, variable in {**_PAGE_COLOURS, **series}.items():
        rest = rest.replace(colour, variable)
    return f"<svg {view[0]}{_panels(figure, prefix)} {_least_width(figure, rest)}>{rest}"


def _brief(path: str) -> str:
    """A path in fewer letters: two digits behind the point, one where it is long enough to be a series."""
    digits = r"(\.\d)\d+" if len(path) > _SERIES else r"(\.\d\d)\d+"
    return re.sub(r"\s*([A-Za-z])\s+(?=[-\d])", r"\1", re.sub(digits, r"\1", path))


def save_png(figure: Figure, path: Path) -> None:
    """Write a figure as a file, whole or not at all."""
    settle(figure)
    with replace_whole(path) as temporary:
        # Quick rather than small: half the time of a file was its compression.
        figure.savefig(temporary, format="png", dpi=_DPI, pil_kwargs={"compress_level": 3})


def settle(figure: Figure) -> None:
    """Lay a figure out once for all its files: with an engine, each of them is laid out and drawn twice."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def _least_width(figure: Figure, drawn: str) -> str:
    """Style under which the smallest letters can be read."""
    sizes = [float(size) for size in re.findall(r"(?:font: |font-size: )[^;'\"]*?([\d.]+)px", drawn)]
    width = 72.0 * figure.get_figwidth()
    least = _LEGIBLE * width / min(sizes) if sizes else 0.0
    return f'style="min-width: {min(least, 2.0 * width):.0f}px"'


def _panels(figure: Figure, prefix: str) -> str:
    """Where the panels over time lie [1/72 inch], and the times at their ends [s]."""
    width = 72.0 * figure.get_figwidth()
    found = []
    over_time = any(axes.get_xlabel() == TIME for axes in figure.axes)
    for index, axes in enumerate(figure.axes if over_time else (), start=1):
        place = axes.get_position()
        low, high = axes.get_xlim()
        found.append([f"{prefix}-axes_{index}", place.x0 * width, place.x1 * width, low, high])
    return f' data-panels="{escape(json.dumps(found))}"' if found else ""
