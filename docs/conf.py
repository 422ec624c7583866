"""The documentation site: ``sphinx-build -W --keep-going docs docs/_build/html``."""

import logging
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

project = "vislam"
author = "The vislam authors"
project_copyright = author
try:
    version = release = metadata.version("vislam")
except metadata.PackageNotFoundError:
    version = release = "from the checkout"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "off"
nb_render_markdown_format = "myst"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
# Formulas are MathML, which browsers draw themselves: the site needs no network and no script for them.
html_math_renderer = "mathml"
html_theme = "furo"
html_title = "vislam"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_theme_options = {"source_directory": "docs/"}


def setup(app: Any) -> None:
    """Generate the pages of the reference before the sources are read."""
    # Each section lists its pages in order and picks up new ones by a pattern, for which there may be none.
    logging.getLogger("sphinx.sphinx.directives.other").addFilter(_unless_empty_pattern)
    app.add_html_math_renderer("mathml", (_inline_formula, None), (_formula, None))
    app.connect("config-inited", _generate)


def _unless_empty_pattern(record: logging.LogRecord) -> bool:
    return "didn't match any documents" not in str(record.msg)


def _inline_formula(translator: Any, node: Any) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _formula(translator: Any, node: Any) -> None:
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def _generate(app: Any, config: Any) -> None:
    del app, config
    from generate_reference import write_all  # noqa: PLC0415

    write_all(HERE / "reference")
