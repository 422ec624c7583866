"""What a calibration reports while it runs: how long it will take, each round, and the best config so far."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from vislam.calibration.search import Round
from vislam.comparison.config import Config

CHOICES = 3
"""How often the gate may choose the observations."""
_ROUNDS, _CHOICES, _MATCHES = 6, 2, 3
"""Rounds, choices and iterations of the matching bias that a search takes as a rule."""
_COMPARED = 1.25
"""Time of a run whose predictions are compared with another's, over that of the filter before."""
_SHARED, _ALONE = 20.0, 3.0
"""Runs that what was found is scored by, side by side and one after the other."""


@dataclass(frozen=True)
class Work:
    """Runs of the filter that a calibration takes as a rule.

    Attributes
    ----------
    shared : float
        Those that processes share.
    alone : float
        Those that wait for each other.
    """

    shared: float
    alone: float

    @classmethod
    def of(cls, parameters: int, *, processes: int) -> "Work":
        """Of so many parameters, of which each process compares some with a run of its own."""
        round_ = _COMPARED * (parameters + min(processes, parameters))
        return cls(_ROUNDS * round_ + parameters + 2 * _CHOICES + _SHARED, 1 + _MATCHES + _CHOICES + _ALONE)

    def seconds(self, run: float, *, processes: int) -> float:
        """Time of it, where a run takes so long [s]."""
        cores = min(processes, os.cpu_count() or 1)
        return run * (self.shared / cores + self.alone)


@dataclass
class Reporter:
    """Reports the progress of the calibration, and passes on the best config so far.

    Attributes
    ----------
    say : callable
        Is given a line.
    keep : callable
        Is given the best config so far after each round, and which round that is.
    processes : int
    """

    say: Callable[[str], None]
    keep: Callable[[Config, str], None]
    processes: int = 1
    _began: float = field(default_factory=time.monotonic)
    _expected: float = 0.0

    def begin(self, work: Work, *, run: float) -> None:
        """Report how long it will take, where a run takes so long [s]."""
        self._began = time.monotonic()
        self._expected = work.seconds(run, processes=self.processes)
        self.say(
            f"it will take about {_duration(self._expected)}: some {work.shared + work.alone:.0f} runs of "
            f"the filter of {run:.2g} s, {self.processes} side by side"
        )

    def round(self, config: Config, ended: Round, *, choice: int) -> None:
        """Report a round that has ended with this config."""
        where = f"choice {choice} of at most {CHOICES}, round {ended.number}"
        left = self._expected - (time.monotonic() - self._began)
        remains = f"about {_duration(left)} left" if left > 0.0 else "takes longer than searches do as a rule"
        self.keep(config, where)
        self.say(f"{where}: log likelihood {ended.log_likelihood:.1f}, gained {ended.gain:.1f}; {remains}")


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"
