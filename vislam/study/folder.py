"""The folder of a study: a file for each finished trial, and a table of them all."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from vislam.base.errors import DataError, NotWrittenError
from vislam.base.files import check_writable, remove, write_text
from vislam.comparison.identity import code_digest
from vislam.study import saved
from vislam.study.points import Trial
from vislam.study.saved import Result
from vislam.study.table import Table, as_text, csv_table, has_parquet, kind_of, parquet_table
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
        self,
        trials: Callable[[], Iterable[Trial]],
        *,
        swept: Mapping[str, Sequence[Any]],
        metrics: Sequence[str],
    ) -> list[Path]:
        """Write a row for each trial that is there, with a column for each metric of each run.

        ``trials.csv``, and ``trials.parquet`` where pyarrow is installed; else one of an earlier start is
        removed.

        Parameters
        ----------
        trials : callable
            Gives the trials anew, once for the header and once for the rows.
        swept : mapping of str to sequence
            Values at the points by the dotted paths of what differs between them.
        metrics : sequence of str
            Keys to keep; none: all.

        Returns
        -------
        list of Path
            The files.
        """
        columns: dict[str, None] = {}
        for _, found in self.finished(trials()):
            columns |= dict.fromkeys(_wide(found, metrics))
        kinds = {"id": "string", "seed": "int64"}
        kinds |= {path: kind_of(values) for path, values in swept.items()}
        kinds |= {
            "status": "string",
            "reason": "string",
            "seconds": "double",
            **dict.fromkeys(columns, "double"),
        }
        with self._tables(kinds) as tables:
            for trial, found in self.finished(trials()):
                row = {**_own(trial, found, kinds), **_wide(found, metrics)}
                for table in tables.values():
                    table.write(row)
            return list(tables)

    @contextmanager
    def _tables(self, kinds: Mapping[str, str]) -> Iterator[dict[Path, Table]]:
        """Give the tables to be written, by their files."""
        whole, compact = self.path / "trials.csv", self.path / "trials.parquet"
        tables = {}
        with ExitStack() as stack:
            stack.enter_context(told(whole))
            tables[whole] = stack.enter_context(csv_table(whole, list(kinds)))
            stack.enter_context(told(compact))
            if has_parquet():
                tables[compact] = stack.enter_context(parquet_table(compact, kinds))
            else:
                remove(compact)
            yield tables

    def _file(self, trial: Trial) -> Path:
        return self.path / "trials" / f"{trial.id}.json"


def _own(trial: Trial, result: Result, kinds: Mapping[str, str]) -> dict[str, Any]:
    """Cells before the metrics."""
    values = {path: as_text(value) for path, value in trial.point.values.items()}
    texts = {
        path: str(value) for path, value in values.items() if kinds[path] == "string" and value is not None
    }
    told = {key: result[key] for key in ("status", "reason", "seconds")}
    return {"id": trial.id, "seed": trial.seed, **values, **texts, **told}


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
