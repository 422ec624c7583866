"""YAML from strangers: plain data of bounded size, or a line."""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vislam.base.yaml_text import DEEPEST, MOST_NODES, parse_yaml

CONFIGS = sorted((Path(__file__).parents[1] / "configs").rglob("*.yaml"))
LETTERS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(min_value=-(2**63) + 1, max_value=2**63 - 1)
    | st.floats()
    | LETTERS
)
TREES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(LETTERS, inner, max_size=4)
)


def values(tree: Any) -> Iterator[Any]:
    yield tree
    below = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    for item in below:
        yield from values(item)


def same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and one == other


@given(TREES)
def test_what_a_config_can_hold_is_read_as_it_was_written(tree):
    assert same(parse_yaml(yaml.safe_dump(tree, sort_keys=False)), tree)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_configs_that_come_along_are_read_as_pyyaml_reads_them(path):
    text = path.read_text(encoding="utf-8")
    assert same(parse_yaml(text), yaml.safe_load(text))


def assert_line(error: ValueError) -> None:
    assert type(error) is ValueError
    assert len(str(error)) <= 300
    assert str(error).isprintable()


PIECES = st.sampled_from(
    [
        *(
            "a",
            "b: ",
            "- ",
            "? ",
            ": ",
            "\n",
            "\n  ",
            "\n    ",
            "[",
            "]",
            "{",
            "}",
            ", ",
            "<<: ",
            "*a ",
            "&a ",
        ),
        *(
            "'",
            '"',
            "|",
            ">",
            "#",
            "!",
            "!!int ",
            "!!set ",
            "!!python/name:os.system ",
            "%YAML 1.1\n",
            "---\n",
        ),
        *("1", "0x1", "1:30", ".inf", ".nan", "~", "yes", "2020-01-99", "\t", "\\", "=", "0b_", "9" * 200),
        *('"\\0"', '"\\ud800"', "\u2028", "é", "\x1b"),
    ]
)


@settings(deadline=None)
@given(st.lists(PIECES, max_size=40).map("".join) | st.text())
@example("a: &a [*a]")
@example("a: &a {<<: *a}")
@example("!!int ''")
@example("!!float x")
def test_any_text_is_plain_data_or_a_line(text):
    try:
        tree = parse_yaml(text)
    except ValueError as error:
        assert_line(error)
        return
    for value in values(tree):
        assert type(value) in (dict, list, str, int, float, bool, type(None))
        assert not isinstance(value, dict) or all(type(key) is str for key in value)


def nested(levels: int, opened: str, closed: str) -> str:
    return opened * levels + closed * levels


def chained(links: int) -> str:
    """Each list holds the one before it."""
    return "- &x0 [1]\n" + "".join(f"- &x{n + 1} [*x{n}]\n" for n in range(links))


def multiplied(times: int) -> str:
    """Each list holds nine times the one before it."""
    lists = (f"- &x{n + 1} [{', '.join([f'*x{n}'] * 9)}]\n" for n in range(times))
    return "- &x0 [1]\n" + "".join(lists)


def merged(times: int) -> str:
    """Each mapping merges nine times the one before it."""
    mappings = (f"- &x{n + 1} {{<<: [{', '.join([f'*x{n}'] * 9)}]}}\n" for n in range(times))
    return "- &x0 {a: 1}\n" + "".join(mappings)


REFUSED = {
    "a mapping in itself": ("a: &a {b: *a}", "an alias stands inside of what it stands for, line 1"),
    "a list in itself": ("a: &a\n- *a", "an alias stands inside"),
    "a list in itself, further down": ("&a [[[b, *a]]]", "an alias stands inside"),
    "a merge of itself": ("&a {<<: *a, b: 1}", "an alias stands inside"),
    "a key twice": ("a: {b: 1, c: 2}\nd: 1\na: 3", "the key 'a' is there twice, line 3"),
    "a key twice, quoted": ("{a: 1, 'a': 2}", "the key 'a' is there twice"),
    "a key twice, below": ("estimators:\n  ekf: {}\n  ekf: {}", "the key 'ekf' is there twice, line 3"),
    "lists in lists": (nested(100_000, "[", "]"), f"expected at most {DEEPEST} levels"),
    "mappings in mappings": (nested(40_000, "{a: ", "}"), f"expected at most {DEEPEST} levels"),
    "blocks in blocks": ("- " * 100_000, f"expected at most {DEEPEST} levels"),
    "keys in keys": ("? " * 100_000, f"expected at most {DEEPEST} levels"),
    "aliases in aliases": (chained(1000), f"expected at most {DEEPEST} levels"),
    "aliases of aliases": (multiplied(9), f"expected at most {MOST_NODES} keys and values"),
    "merges of merges": (merged(9), f"expected at most {MOST_NODES} keys and values"),
    "a long list": ("[" + "a, " * MOST_NODES + "]", f"expected at most {MOST_NODES} keys and values"),
    "a long text": ("#" * 10**6, "expected at most 262144 characters, got 1000000"),
    "many digits": ("a: " + "9" * 5000, "expected a number of at most 100 digits, got 5000"),
    "many hexadecimal digits": ("a: 0x" + "f" * 5000, "expected a number of at most 100 digits"),
    "many sixties": ("a: 1" + ":59" * 5000, "expected a number of at most 100 digits"),
    "many decimals": ("a: 0." + "1" * 5000, "expected a number of at most 100 digits"),
    "a large number": ("a: 9223372036854775808", "expected a whole number below 2^63"),
    "a number that is none": ("a: !!int x", "expected a number, got 'x'"),
    "a bit that is none": ("a: 0b_", "expected a number, got '0b_'"),
    "a truth value that is none": ("a: !!bool x", "'x' is no value of the kind"),
    "NUL": ("a: \0", "unacceptable character #x0000"),
    "NUL as an escape": ('a: "\\0"', "expected letters that a file can hold"),
    "NUL in a key": ('"a\\0": 1', "expected letters that a file can hold"),
    "half of a letter": ('a: "\\ud800"', "expected letters that a file can hold"),
    "a control character": ("a: \x1b[31m", "unacceptable character #x001b"),
    "a tab": ("\ta: 1", "that cannot start any token"),
    "an object": ("!!python/object:os.system a", "python/object:os.system"),
    "a set": ("!!set {a, b}", "is no kind of value"),
    "bytes": ("!!binary aGVsbG8=", "is no value of the kind"),
    "a number as a key": ("{1: a}", "expected text for a key, got 1"),
    "a list as a key": ("[a]: b", "expected text for a key, got ['a']"),
    "nothing as a key": ("~: b", "expected text for a key, got None"),
    "a merge of text": ("<<: a", "expected a mapping, or a list of them"),
    "two documents": ("a\n---\nb", "found another document"),
    "no such anchor": ("*a", "found undefined alias 'a'"),
    "an anchor twice": ("[&a 1, &a 2]", "found duplicate anchor 'a'"),
    "an open list": ("[a", "expected ',' or ']'"),
    "a long tag": ("!" + "a" * 100_000 + " b", "no value of the kind"),
    "a long key twice": (("a" * 1000 + ": 1\n") * 2, "is there twice"),
    "a long alias": ("*" + "a" * 100_000, "found undefined alias"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_a_config_cannot_hold_is_a_line(case):
    text, message = REFUSED[case]
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        parse_yaml(text)
    assert_line(caught.value)


def test_aliases_and_merges_that_are_few_are_read_as_pyyaml_reads_them():
    for text in (
        "a: &a {b: 1, c: 2}\nd: *a\ne: {<<: *a, b: 3}",
        "a: &a {b: 1}\nc: &c {b: 2, d: 3}\ne: {<<: [*a, *c], f: 4}",
        "a: &a {b: 1}\nc: &c {<<: *a, d: 3}\ne: {<<: *c}",
        nested(DEEPEST - 1, "[", "]"),
        chained(DEEPEST - 3),
    ):
        assert same(parse_yaml(text), yaml.safe_load(text))


def test_nothing_is_shared():
    tree = parse_yaml("a: &a {b: 1}\nc: *a")
    tree["a"]["b"] = 2
    assert tree["c"] == {"b": 1}


def test_dates_are_text():
    assert parse_yaml("[2020-01-01, 2020-13-45, =]") == ["2020-01-01", "2020-13-45", "="]
