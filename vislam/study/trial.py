"""One trial: a pure function of a config and a seed, whose result is plain data."""

import errno
import logging
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

from threadpoolctl import threadpool_limits

from vislam.base.errors import Interrupted, first_line
from vislam.base.progress import Silent
from vislam.comparison import config as configuration
from vislam.comparison.compare import run_comparison
from vislam.comparison.config import Config
from vislam.comparison.identity import code_digest, inputs_digest
from vislam.comparison.open import open_dataset
from vislam.datasets.find import search_path
from vislam.evaluation import evaluate
from vislam.evaluation.statistics import Statistic

DONE, FAILED = "done", "failed"
_PASSING = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EIO,
    errno.ENOMEM,
    errno.EMFILE,
    errno.ENFILE,
    errno.EAGAIN,
)
"""What a file system or a machine says that has no more, or fails: another time or elsewhere it may not."""
_LONGEST = 1000
"""Characters of a reason that are kept."""


def run_trial(tree: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Simulate, or read the recording, run the estimators, and score those that are complete.

    Whatever goes wrong is a result too: a trial that fails is to be counted, not to end the study. Only what
    is no fault of the trial is raised, a machine without memory or room left; then the trial is lost, and the
    next start of the study runs it again.

    Parameters
    ----------
    tree : mapping
        Effective config as plain data.
    seed : int
        In place of the config's.

    Returns
    -------
    dict
        ``status`` and ``reason``; ``runs``, by estimator whether it is complete and why not; ``metrics`` and
        ``statistics`` of the others; ``seconds``; ``code``, the digest of the code it ran with; ``inputs``,
        that of the files that its config names.
    """
    began, code = time.perf_counter(), code_digest()
    with threadpool_limits(1), _unheard():
        try:
            found = _measure(replace(configuration.parse(Config, dict(tree)), seed=seed))
        except Interrupted:
            raise
        except BaseException as error:
            # Somebody's estimator may call sys.exit, which would take the worker down.
            if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _PASSING):
                raise
            found = nothing(FAILED, _line(f"{type(error).__name__}: {first_line(error)}"))
    # A file that was changed meanwhile is told by the hash of what it is now.
    inputs = inputs_digest(tree, search_path(None))
    return {**found, "seconds": time.perf_counter() - began, "code": code, "inputs": inputs}


def nothing(status: str, reason: str) -> dict[str, Any]:
    """Result of a trial that measured nothing."""
    return {"status": status, "reason": reason, "runs": {}, "metrics": [], "statistics": []}


@contextmanager
def _unheard() -> Iterator[None]:
    """Keep what is logged of each of many trials out of the terminal."""
    log = logging.getLogger("vislam")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def _measure(config: Config) -> dict[str, Any]:
    dataset = open_dataset(config.data, seed=config.seed, allow_substitute=False, held_out=config.held_out)
    results = run_comparison(config, dataset, Silent())
    # An incomplete run has errors of the frames it finished: they are not those of the others.
    complete = {name: run for name, run in results.runs.items() if run.complete}
    evaluation = evaluate(complete, results.record)
    broken = {name: _line(run.log.error) for name, run in results.runs.items() if not run.complete}
    return {
        "status": DONE,
        "reason": "; ".join(f"{name}: {error}" for name, error in broken.items()),
        "runs": {
            name: {"complete": name not in broken, "error": broken.get(name, "")} for name in results.runs
        },
        "metrics": [
            {
                "estimator": metric.estimator,
                "key": metric.key,
                "estimate": metric.estimate,
                "value": _number(metric.value),
            }
            for metric in evaluation.metrics
        ],
        "statistics": [
            {"estimator": estimator, **_plain(statistic), "name": name, "estimate": estimate}
            for (estimator, name, estimate), statistic in evaluation.statistics.items()
        ],
    }


def _plain(statistic: Statistic) -> dict[str, Any]:
    """A statistic as plain data, null where there is no number."""
    return {
        key: _number(value) if isinstance(value, float) else value for key, value in asdict(statistic).items()
    }


def _number(value: float) -> float | None:
    """A finite number, or null, as other readers of JSON know no others."""
    return float(value) if math.isfinite(value) else None


def _line(text: str) -> str:
    """What somebody's error says, of bounded length, and such that it can be written anywhere."""
    return text[:_LONGEST].encode(errors="backslashreplace").decode()
