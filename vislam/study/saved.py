"""The file of a trial: accepted only if it is whole and matches its name."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StrictBool, StrictInt, StrictStr, TypeAdapter
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT
from vislam.core.run import Estimate
from vislam.study.points import Trial

Result = dict[str, Any]

_LARGEST = 64 << 20
"""Size beyond which a file is that of no trial [bytes]; four estimators leave 52 kB."""
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=0, lt=1 << 63)]


class Refused(ValueError):
    """A file that is not the result of the trial that it is named for."""


@dataclass(frozen=True, slots=True, config=STRICT)
class _Run:
    complete: StrictBool
    error: StrictStr


@dataclass(frozen=True, slots=True, config=STRICT)
class _Metric:
    estimator: StrictStr
    key: StrictStr
    estimate: Estimate | None
    value: _Number | None


@dataclass(frozen=True, slots=True, config=STRICT)
class _Statistic:
    estimator: StrictStr
    name: StrictStr
    estimate: Estimate | None
    value: _Number | None
    freedom: _Number | None
    samples: _Count
    effective: _Number | None
    convention: StrictStr
    fitted: StrictBool


@dataclass(frozen=True, slots=True, config=STRICT)
class _Document:
    id: StrictStr
    seed: StrictInt
    values: dict[str, Any]
    status: Literal["done", "failed", "lost"]
    reason: StrictStr
    runs: dict[str, _Run]
    metrics: list[_Metric]
    statistics: list[_Statistic]
    seconds: Annotated[_Number, Field(ge=0)] | None
    code: StrictStr
    inputs: StrictStr

    def __post_init__(self) -> None:
        """Reject numbers of runs that did not finish, and those that are there twice."""
        scored = {name for name, run in self.runs.items() if run.complete}
        names = {found.estimator for found in self.metrics} | {found.estimator for found in self.statistics}
        if not all(scored.issuperset(name.split("|")) for name in names):
            raise ValueError("a run has numbers and is not complete")
        entries = {(metric.estimator, metric.key, metric.estimate) for metric in self.metrics}
        if len(entries) < len(self.metrics):
            raise ValueError("a metric is there twice")
        if self.status != "done" and self.runs:
            raise ValueError(f"a trial that is {self.status} has no runs")


_DOCUMENT = TypeAdapter(_Document)


def read(path: Path, trial: Trial, *, code: str) -> Result:
    """Read the file of a trial.

    Parameters
    ----------
    path : Path
    trial : Trial
        That the file is named for.
    code : str
        Digest of the code that the trial is to have run with.

    Raises
    ------
    Refused
        If it is not a whole result of this trial, by this code, of the files that its config names.
    """
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST:
            raise Refused(f"{path}: no file, or too large")
        content = path.read_bytes()
        found = json.loads(content)
        document = _DOCUMENT.validate_python(found)
        if b"\\u" in content:
            # Half a character can be escaped, but not be written to a table.
            json.dumps(found, ensure_ascii=False).encode()
    except (OSError, ValueError, RecursionError) as error:
        raise Refused(f"{path}: not the result of a trial") from error
    told = (document.id, document.seed, document.code, document.inputs, _text(document.values))
    point = trial.point
    if told != (trial.id, trial.seed, code, point.inputs, _text(json.loads(json.dumps(point.values)))):
        raise Refused(f"{path}: of another trial")
    if document.status == "done" and document.runs.keys() != point.tree["estimators"].keys():
        raise Refused(f"{path}: of other estimators")
    return found


def _text(values: dict[str, Any]) -> str:
    """Values so that 1, 1.0 and true differ, as in a config, and what is no number equals itself."""
    return json.dumps(values, sort_keys=True)
