"""Text that comes from elsewhere, fit to be shown."""

import io
from xml.etree import ElementTree as Xml

import matplotlib as mpl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure

from vislam.base.legible import literal, one_line, quoted, visible, visible_lines

ANY = st.text(st.characters())
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | ANY,
    lambda inner: st.lists(inner) | st.dictionaries(ANY, inner),
)


@given(ANY)
def test_whatever_is_shown_is_printable(text):
    assert visible(text).isprintable()
    assert one_line(text).isprintable()
    assert literal(text).isprintable()
    assert all(line.isprintable() for line in visible_lines(text).split("\n"))
    assert visible_lines(text).count("\n") == text.count("\n")
    visible(text).encode("utf-8")


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_what_is_printable_stays(text):
    assert visible(text) == text


def test_what_a_terminal_would_obey_is_an_escape():
    assert visible("a\x1b[31m\x07\x9b\u202e\ud800") == r"a\x1b[31m\x07\x9b\u202e\ud800"
    assert one_line("one\n  two\ttabbed") == "one two tabbed"


@given(st.integers(min_value=20, max_value=200), ANY)
def test_a_line_has_a_bounded_length_with_beginning_and_end(limit, text):
    line = one_line(f"begin{text * 50}end", limit=limit)
    assert len(line) <= limit
    assert line.startswith("beg")
    assert line.endswith("end")


@given(PLAIN)
def test_any_value_can_be_quoted(value):
    assert len(quoted(value)) <= 200
    assert quoted(value).isprintable()


def test_values_that_python_cannot_write_or_not_at_once_can_be_quoted():
    cycle = []
    cycle.append(cycle)
    bomb = ["x"] * 9
    for _ in range(30):
        bomb = [bomb] * 9
    for value in (cycle, bomb, 10**5000, "x" * 10**7, {"a": 10**5000}):
        assert len(quoted(value)) <= 200


@given(ANY)
def test_nothing_is_mathematics(text):
    assert not is_math_text(literal(text))


@pytest.mark.parametrize(
    "text", ["a $b$ c", r"RTK \$10k ($\sigma$ 2 cm, $\pm_{x$)", "$", "$$", r"\$", "_hidden", "<b>&amp;"]
)
def test_a_label_is_drawn_as_it_is(text):
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0, 1], label=literal(text))
    axes.legend()
    drawn = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none"}):
        figure.savefig(drawn, format="svg")
    texts = ["".join(node.itertext()).strip() for node in Xml.fromstring(drawn.getvalue()).iter()]
    assert text in texts
