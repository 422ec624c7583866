"""What Ctrl-C or SIGTERM becomes on its way through somebody's code is still an interruption."""

import pytest

from vislam.base.errors import INTERRUPTED, Interrupted, interruption
from vislam.cli.command import answer
from vislam.comparison.members import Member, Unbuilt


def stopped_while_imported(*_):
    try:
        raise Interrupted("SIGTERM")
    except Interrupted as signal:
        raise ImportError("initialization failed") from signal


def stopped_while_closing(*_):
    try:
        raise Interrupted("SIGINT")
    finally:
        raise ValueError("seek of closed file")


each_way = pytest.mark.parametrize("work", [stopped_while_imported, stopped_while_closing])


@each_way
def test_a_command_says_that_it_was_interrupted(work, capsys):
    assert answer(work, verbose=False) == INTERRUPTED
    assert capsys.readouterr().err.strip() == "vislam: interrupted"


@each_way
def test_an_estimator_that_is_stopped_while_it_is_built_has_not_failed(work):
    with pytest.raises(Interrupted):
        Member(work, {}, takes_all=False).build(None)


def test_failures_of_its_own_are_none():
    def broken(*_):
        raise ImportError("no such module")

    assert isinstance(Member(broken, {}, takes_all=False).build(None), Unbuilt)
    assert interruption(ValueError("alone")) is None
    with pytest.raises(ImportError, match="no such module"):
        answer(broken, verbose=False)
