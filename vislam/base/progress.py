"""How the library reports progress: to the terminal if a command runs it, else not at all."""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Bar(Protocol):
    """A bar that grows."""

    def done(self, count: int) -> None:
        """Report how much of the whole is done."""
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
    """Reports nothing."""

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
