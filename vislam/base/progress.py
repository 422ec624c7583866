"""How the library says what it does: to the terminal if a command runs it, else to nobody."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Bar(Protocol):
    """A bar that grows."""

    def done(self, count: int) -> None:
        """Say how much of the whole is done."""
        ...


class Progress(Protocol):
    """What takes lines, tables and how far some work is."""

    def note(self, text: str) -> None:
        """Take a line."""
        ...

    def rows(self, header: Sequence[str], rows: Sequence[Sequence[str]], *, title: str) -> None:
        """Take a table of text."""
        ...

    def bar(self, title: str, total: int) -> AbstractContextManager[Bar]:
        """Follow the work of a block."""
        ...


class Silent:
    """Says nothing."""

    def note(self, text: str) -> None:
        """Drop a line."""

    def rows(self, header: Sequence[str], rows: Sequence[Sequence[str]], *, title: str) -> None:
        """Drop a table."""

    @contextmanager
    def bar(self, title: str, total: int) -> Iterator[Bar]:
        """Follow nothing."""
        yield self

    def done(self, count: int) -> None:
        """Drop a count."""
