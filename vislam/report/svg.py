"""A figure as SVG for a page: no colours of its own, but those of the page's theme."""

import io
import re
from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.figure import Figure

_SIMPLIFIED = 0.3
"""How far a simplified path may be from the true one [px]."""
_IMAGE_DPI = 150
"""Resolution of what is rasterised inside [px/inch]."""
_SIMPLIFY = 0.3
"""How far a simplified path may lie off [1/72 inch]."""
_PAGE_COLOURS = {"#000000": "currentColor", "#ffffff": "var(--paper)", "#cccccc": "var(--band)"}
_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))


def themed_svg(figure: Figure, prefix: str, *, colours: Sequence[str]) -> str:
    """SVG element to be put into a page.

    Black becomes the colour of the page's text, white that of its paper, light grey that of its bands, and
    each of ``colours`` the page's variable ``--c0``, ``--c1``, ... The same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
    prefix : str
        Put before every id, since ids of several figures share the page.
    colours : sequence of str
        ``#rrggbb`` of the series.
    """
    buffer = io.StringIO()
    with mpl.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "vislam", "path.simplify_threshold": _SIMPLIFIED}
    ):
        figure.savefig(buffer, format="svg", dpi=_IMAGE_DPI, transparent=True, metadata=_METADATA)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # The metadata and the style sheet are the document's; a page has its own.
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    head, rest = text.split(">", 1)
    view = re.search(r'viewBox="[^"]*"', head)
    assert view is not None
    rest = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), rest)
    rest = re.sub(r'\bid="', f'id="{prefix}-', rest)
    rest = rest.replace("url(#", f"url(#{prefix}-").replace("xlink:href", "href")
    rest = rest.replace('href="#', f'href="#{prefix}-')
    series = {colour.lower(): f"var(--c{index})" for index, colour in enumerate(colours)}
    for colour, variable in {**_PAGE_COLOURS, **series}.items():
        rest = rest.replace(colour, variable)
    return f"<svg {view[0]}>{rest}"
