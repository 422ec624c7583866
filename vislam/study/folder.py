"""The folder of a study: a file for each finished trial, and a table of them all."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vislam.base.errors import DataError, NotWrittenError
from vislam.base.files import check_writable, replace_whole, write_text
from vislam.comparison import config as configuration
from vislam.comparison.identity import code_digest
from vislam.study import saved
from vislam.study.points import Trial
from vislam.study.saved import Result
from vislam.study.trial import DONE, FAILED


class StudyFolder:
    """Results of trials under ``trials/``, by their id; one that is there is finished.

    Attributes
    ----------
    path : Path
    refused : set of str
        Ids of trials whose files were not taken, as they are not whole or say that they are of another.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.refused: set[str] = set()
        for file in ("study.json", "trials/a.json", "cases/a.yaml"):
            check_writable(path / file)

    def find(self, trial: Trial) -> Result | None:
        """Result of a finished trial; None if it is not there, not taken, or was lost with its worker."""
        path = self._file(trial)
        if not path.exists():
            return None
        try:
            found = saved.read(path, trial, code=code_digest())
        except saved.Refused:
            self.refused.add(trial.id)
            return None
        return found if found["status"] in (DONE, FAILED) else None

    def save(self, trial: Trial, result: Result) -> None:
        """Write the result of a trial, whole or not at all; DataError if it cannot be."""
        document = {"id": trial.id, "seed": trial.seed, "values": trial.point.values, **result}
        self.write_json(self._file(trial), document)

    def write_json(self, path: Path, document: Any) -> None:
        """Write plain data."""
        self.write_text(path, json.dumps(document, indent=1) + "\n")

    def write_text(self, path: Path, text: str) -> None:
        """Write a text, whole or not at all; DataError if it cannot be."""
        with told(path):
            write_text(path, text)

    def finished(self, trials: Iterable[Trial]) -> Iterator[tuple[Trial, Result]]:
        """Those of the trials that are finished, with their results, one after the other."""
        for trial in trials:
            if (found := self.find(trial)) is not None:
                yield trial, found

    def write_table(
        self, trials: Callable[[], Iterable[Trial]], *, swept: Sequence[str], metrics: Sequence[str]
    ) -> None:
        """Write ``trials.csv``: a row for each trial that is there, a column for each metric of each run.

        Parameters
        ----------
        trials : callable
            Gives the trials anew, once for the header and once for the rows.
        swept : sequence of str
            Dotted paths of what differs between points.
        metrics : sequence of str
            Keys to keep; none: all.
        """
        columns: dict[str, None] = {}
        for _, found in self.finished(trials()):
            columns |= dict.fromkeys(_wide(found, metrics))
        own = ("id", "seed", *swept, "status", "reason", "seconds")
        path = self.path / "trials.csv"
        with (
            told(path),
            replace_whole(path) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file)
            writer.writerow((*own, *columns))
            for trial, found in self.finished(trials()):
                wide = _wide(found, metrics)
                writer.writerow((*_own(trial, found), *(wide.get(name, "") for name in columns)))

    def _file(self, trial: Trial) -> Path:
        return self.path / "trials" / f"{trial.id}.json"


def _own(trial: Trial, result: Result) -> Iterator[Any]:
    """Cells before the metrics."""
    yield from (trial.id, trial.seed)
    for value in trial.point.values.values():
        yield configuration.inline(value) if isinstance(value, dict | list | tuple) else value
    yield from (result["status"], result["reason"], result["seconds"])


def _wide(result: Result, keys: Sequence[str]) -> dict[str, float]:
    """Metrics of a trial by ``<estimator>.<key>``, with ``.<estimate>`` behind those of one."""
    return {
        ".".join(filter(None, (metric["estimator"], metric["key"], metric["estimate"]))): metric["value"]
        for metric in result["metrics"]
        if not keys or metric["key"] in keys
    }


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Turn what the file system refuses into one line."""
    try:
        yield
    except NotWrittenError as error:
        raise DataError(f"{path}: cannot be written ({error.why}); finished trials are kept") from None
