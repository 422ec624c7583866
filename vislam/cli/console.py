"""What the commands show in the terminal: notes, a progress bar, tables."""

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
_REMEMBERED = 3600.0
"""Time over which a bar averages its speed [s]: a trial of a study may take minutes."""


class Terminal:
    """Prints to standard output; the bar is quiet when that is no terminal."""

    def __init__(self) -> None:
        self._console = Console(highlight=False)
        if not self._console.is_terminal:
            self._console = Console(highlight=False, width=_FEWEST_COLUMNS)

    def note(self, text: str) -> None:
        """Print a line, whatever is in it."""
        self._console.print(one_line(text, limit=_LONGEST_NOTE), markup=False, soft_wrap=True)

    @contextmanager
    def bar(self, title: str, total: int) -> Iterator["_Bar"]:
        """Show a bar while the block works."""
        drawn = Progress(
            TextColumn("{task.description:16}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
            transient=True,
            speed_estimate_period=_REMEMBERED,
        )
        with drawn:
            yield _Bar(drawn, drawn.add_task(one_line(title), total=total))

    def rows(self, header: Sequence[str], rows: Sequence[Sequence[str]], *, title: str) -> None:
        """Print a table of text."""
        drawn = RichTable(title=Text(one_line(title), style="table.title"))
        for index, name in enumerate(header):
            drawn.add_column(Text(one_line(name)), justify="left" if index == 0 else "right")
        for row in rows:
            drawn.add_row(*(Text(one_line(cell)) for cell in row))
        self._console.print(drawn)


class _Bar:
    def __init__(self, drawn: Progress, task: TaskID) -> None:
        self._drawn, self._task = drawn, task

    def done(self, count: int) -> None:
        """Move to a count."""
        self._drawn.update(self._task, completed=count)
