"""Results of an earlier run, as its ``metrics.json`` has them, to compare new ones with."""

import json
import os
from dataclasses import dataclass as plain_dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, StrictBool, StrictFloat
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.errors import ConfigError, DataError, first_line
from vislam.base.files import open_regular
from vislam.base.legible import brief
from vislam.checks.settings import SAVED, Check
from vislam.core.run import Estimate
from vislam.evaluation.lookup import Entry
from vislam.evaluation.metric import is_error

_MOST_BYTES = 1 << 26
"""Largest ``metrics.json``; that of ten estimators has less than a hundredth."""
_Word = Annotated[str, Field(strict=True, pattern="^[ -~]{1,200}$")]


@dataclass(frozen=True)
class _Metric:
    estimator: _Word
    key: _Word
    estimate: Estimate | None
    value: Annotated[StrictFloat, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class _Run:
    complete: StrictBool


@dataclass(frozen=True)
class _Dataset:
    name: str
    digest: str
    reference: str | None


@dataclass(frozen=True)
class _Document:
    dataset: _Dataset
    runs: dict[str, _Run]
    metrics: list[_Metric]


@plain_dataclass(frozen=True)
class Saved:
    """Saved results.

    Attributes
    ----------
    path : Path
        Their ``metrics.json``.
    data, digest : str
        Name and hash of the data.
    reference : str or None
        Name of what they were scored against.
    complete : dict of str to bool
        Whether each run had finished.
    values : dict of Entry to float
        Metrics by run, key and estimate.
    """

    path: Path
    data: str
    digest: str
    reference: str | None
    complete: dict[str, bool]
    values: dict[Entry, float]

    @classmethod
    def read(cls, path: Path, *, schema_version: int) -> "Saved":
        """Read a ``metrics.json``, or that of a folder of results; a DataError names what is invalid."""
        path = path / "metrics.json" if os.path.isdir(path) else path
        tree = _tree(path)
        if tree.get("schema_version") != schema_version:
            raise DataError(
                f"{path}: schema_version must be {schema_version}, "
                f"got {brief(repr(tree.get('schema_version')))}; "
                "write it again with this version"
            )
        try:
            found = settings.parse(_Document, tree)
        except ConfigError as error:
            raise DataError(f"{path}: {brief(str(error))}") from None
        values = {(metric.estimator, metric.key, metric.estimate): metric.value for metric in found.metrics}
        if len(values) < len(found.metrics):
            raise DataError(f"{path}: must hold each metric of a run once; write it again with this version")
        return cls(
            path=path,
            data=found.dataset.name,
            digest=found.dataset.digest,
            reference=found.dataset.reference,
            complete={name: run.complete for name, run in found.runs.items()},
            values=values,
        )

    def refuse_other(self, *, digest: str, reference: str | None) -> None:
        """Raise DataError if results on other data, or against another reference, are to be compared."""
        if self.digest != digest:
            raise DataError(
                f"{self.path}: of other data ({brief(self.data)}, digest {brief(self.digest[:10])}, here "
                f"{digest[:10]}), so its errors are no measure; save results of this data"
            )
        if self.reference != reference:
            raise DataError(
                f"{self.path}: scored against {brief(self.reference or 'no reference')}, here it is "
                f"{reference or 'none'}; save results with the same reference"
            )

    def checks(self, estimators: tuple[str, ...], *, tolerance: float) -> tuple[Check, ...]:
        """Checks that no metric of accuracy of these runs has become worse by more than a share.

        What the saved results have and the new ones lack does not hold.

        Raises
        ------
        DataError
            If the saved results have no such metric.
        """
        found = tuple(
            Check(estimator=name, metric=key, estimate=estimate, at_most=1.0 + tolerance, times=SAVED)
            for name, key, estimate in self.values
            if name in estimators and is_error(key)
        )
        if not found:
            raise DataError(f"{self.path}: no error of {', '.join(estimators)} in it to compare with")
        return found


def _tree(path: Path) -> dict[str, Any]:
    try:
        with open_regular(path) as file:
            text = file.read(_MOST_BYTES + 1)
        if len(text) > _MOST_BYTES:
            raise DataError(f"{path}: must have at most {_MOST_BYTES} bytes; name another")
        tree = json.loads(text)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({first_line(error)})") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not a metrics.json ({first_line(error)})") from None
    if not isinstance(tree, dict):
        raise DataError(f"{path}: expected a mapping of keys, got {type(tree).__name__}")
    return tree
