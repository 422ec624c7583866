"""One trial: a pure function of a config and a seed, whose result is plain data."""

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

from threadpoolctl import threadpool_limits

from vislam import config as configuration
from vislam.comparison import run_comparison
from vislam.config import Config
from vislam.data.source import open_dataset
from vislam.errors import first_line
from vislam.evaluation import evaluate
from vislam.identity import code_digest
from vislam.terminal import Terminal

DONE, FAILED = "done", "failed"


def run_trial(tree: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Simulate, or read the recording, run the estimators, and score those that are complete.

    Whatever goes wrong is a result too: a trial that fails is to be counted, not to end the study.

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
        ``statistics`` of the others; ``seconds``; ``code``, the digest of the code it ran with.
    """
    began = time.perf_counter()
    with threadpool_limits(1), _unheard():
        try:
            found = _measure(replace(configuration.parse(Config, dict(tree)), seed=seed))
        except Exception as error:
            found = nothing(FAILED, f"{type(error).__name__}: {first_line(error)}")
    return {**found, "seconds": time.perf_counter() - began, "code": code_digest()}


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
    dataset = open_dataset(config.data, seed=config.seed, allow_stand_in=False)
    results = run_comparison(config, dataset, Terminal(quiet=True))
    # An incomplete run has errors of the frames it finished: they are not those of the others.
    complete = {name: run for name, run in results.runs.items() if run.complete}
    evaluation = evaluate(complete, results.record)
    return {
        "status": DONE,
        "reason": "; ".join(f"{name}: {run.error}" for name, run in results.runs.items() if not run.complete),
        "runs": {name: {"complete": run.complete, "error": run.error} for name, run in results.runs.items()},
        "metrics": [
            {"estimator": metric.estimator, "key": metric.key, "value": metric.value}
            for metric in evaluation.metrics
        ],
        "statistics": [
            {"estimator": estimator, **asdict(statistic), "name": name}
            for (estimator, name), statistic in evaluation.statistics.items()
        ],
    }
