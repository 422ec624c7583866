"""What the commands show in the terminal: notes, a progress bar, tables."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table as RichTable
from rich.text import Text

from vislam.base.legible import one_line

_FEWEST_COLUMNS = 100
"""Width of a table that goes to a file or a pipe."""
_LONGEST_NOTE = 10_000
"""Letters of a note."""
_EVERY = 10.0
"""Time between the lines that stand for a bar where there is no terminal [s]."""
_REMEMBERED = 3600.0
"""Time over which a bar averages its speed [s]: a trial of a study may take minutes."""


class Terminal:
    """Prints to standard output; where that is no terminal, a line now and then stands for the bar."""

    def __init__(self) -> None:
        self._console = Console(highlight=False)
        if not self._console.is_terminal:
            self._console = Console(highlight=False, width=_FEWEST_COLUMNS)

    def note(self, text: str) -> None:
        """Print a line, whatever is in it."""
        self._console.print(one_line(text, limit=_LONGEST_NOTE), markup=False, soft_wrap=True)
        self._console.file.flush()

    @contextmanager
    def bar(self, title: str, total: int) -> Iterator["_Bar | _Lines"]:
        """Show how far the block is while it works."""
        if not self._console.is_terminal:
            yield _Lines(self, title, total)
            return
        drawn = Progress(
            TextColumn("{task.description:16}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            speed_estimate_period=_REMEMBERED,
        )
        with drawn:
            yield _Bar(drawn, drawn.add_task(one_line(title), total=total))

    def rows(self, header: Sequence[str], rows: Sequence[Sequence[str]], *, title: str) -> None:
        """Print a table of text."""
        shown = [[one_line(cell) for cell in row] for row in (header, *rows)]
        console, parts = self._console, [list(range(len(header)))]
        widths = [_width([row[column] for row in shown]) for column in parts[0]]
        if sum(widths) + 1 > console.width:
            if console.is_terminal:
                parts = _parts(widths, keys=_key_columns(shown[1:]), room=console.width)
            else:
                console = Console(highlight=False, width=sum(widths) + 1)
        for part in parts:
            fits = sum(widths[column] for column in part) + 1 <= console.width
            drawn = RichTable(title=Text(one_line(title), style="table.title"))
            for column in part:
                drawn.add_column(
                    Text(shown[0][column]),
                    justify="left" if column == 0 else "right",
                    overflow="fold",
                    # Else long headers would take room from cells.
                    min_width=widths[column] - 3 if fits else None,
                )
            for row in shown[1:]:
                drawn.add_row(*(Text(row[column]) for column in part))
            console.print(drawn)


def _width(cells: Sequence[str]) -> int:
    """Letters that a column takes: a header may be broken between words, the cells below it are not."""
    header, *others = cells
    return 3 + max((len(word) for word in (*header.split(), *others)), default=0)


def _key_columns(rows: Sequence[Sequence[str]]) -> int:
    """How many columns come before the first one of numbers: they say what a row is about."""
    count = len(rows[0]) if rows else 1
    numeric = (place for place in range(1, count) if any(row[place][:1].isdigit() for row in rows))
    return next(numeric, 1)


def _parts(widths: Sequence[int], *, keys: int, room: int) -> list[list[int]]:
    """Columns of the tables that one is cut into; each begins with those that name its rows."""
    names = list(range(keys))
    found: list[list[int]] = []
    for column in range(keys, len(widths)):
        if found and sum(widths[place] for place in (*found[-1], column)) + 1 <= room:
            found[-1].append(column)
        else:
            found.append([*names, column])
    return found or [names]


class _Lines:
    """Says now and then how far some work is."""

    def __init__(self, terminal: Terminal, title: str, total: int) -> None:
        self._terminal, self._title, self._total = terminal, title, total
        self._begun = self._said = time.monotonic()

    def done(self, count: int) -> None:
        """Say it if it was not said for some time."""
        now = time.monotonic()
        if now - self._said >= _EVERY:
            self._said = now
            taken = now - self._begun
            left = f", {taken * (self._total - count) / count:.0f} s left" if count else ""
            self._terminal.note(f"{self._title}: {count} of {self._total} after {taken:.0f} s{left}")


class _Bar:
    def __init__(self, drawn: Progress, task: TaskID) -> None:
        self._drawn, self._task = drawn, task

    def done(self, count: int) -> None:
        """Move to a count."""
        self._drawn.update(self._task, completed=count)
