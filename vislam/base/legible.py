"""Text that comes from elsewhere, made fit to be shown: in a message, in the terminal, in a figure."""

import re
import reprlib

LONGEST_LINE = 1000
"""Characters of a message; it may hold a key, a value or a path of any length."""
_BRIEF = 120
"""Characters of a label in a figure, or of a text within a message."""
_MARK = " [...] "
_BREAK = re.compile(r"\s*[\t\n\v\f\r\x85\u2028\u2029]\s*")
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 80
_REPR.maxlist = _REPR.maxtuple = _REPR.maxdict = 8


def visible(text: str) -> str:
    """Text in which whatever is not printed as itself is an escape: no terminal and no line obeys it."""
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii") for letter in text
    )


def visible_lines(text: str) -> str:
    """The same of a text of several lines, which stay lines."""
    return "\n".join(visible(line) for line in text.split("\n"))


def one_line(text: str, *, limit: int = LONGEST_LINE) -> str:
    """Text as one line of bounded length, with its beginning and its end."""
    # Cut first: what is rejected for its size is not to be worked through.
    joined = visible(_BREAK.sub(" ", _cut(text, 10 * limit).strip("\t\n\v\f\r")))
    return _cut(joined, limit)


def brief(text: str) -> str:
    """Text as a line that has room in another."""
    return one_line(text, limit=_BRIEF)


def quoted(value: object) -> str:
    """A value as it is written in Python, cut to a bounded length."""
    try:
        return one_line(_REPR.repr(value), limit=200)
    except ValueError:
        # A whole number may have more digits than Python agrees to write.
        return f"a value of the kind {type(value).__name__}"


def literal(text: str) -> str:
    """Text as a label of a figure, drawn letter by letter.

    Matplotlib takes what stands between dollar signs for mathematics, and what begins with an underscore for
    a label that a legend does not show.
    """
    shown = one_line(text, limit=_BRIEF).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def _cut(text: str, limit: int) -> str:
    if len(text) <= limit:
        return text
    tail = limit // 3
    return text[: limit - tail - len(_MARK)] + _MARK + text[-tail:]
