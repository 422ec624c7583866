"""What a calibration says of the time that it takes."""

import numpy as np
import pytest

from vislam.calibration.reporter import Reporter, Work
from vislam.calibration.search import Round


def test_processes_share_what_does_not_wait():
    work = Work(shared=10.0, alone=4.0)
    assert work.seconds(2.0, processes=1) == pytest.approx(28.0)
    assert work.seconds(2.0, processes=10**6) < 28.0


def test_each_parameter_adds_runs_and_so_does_each_process_that_compares():
    assert Work.of(10, processes=1).shared > Work.of(9, processes=1).shared
    assert Work.of(9, processes=2).shared > Work.of(9, processes=1).shared
    assert Work.of(2, processes=50).shared == Work.of(2, processes=2).shared


def test_the_time_is_told_first_and_with_each_round_what_is_left(monkeypatch):
    lines, kept, now = [], [], [0.0]
    monkeypatch.setattr("vislam.calibration.reporter.time.monotonic", lambda: now[0])
    monkeypatch.setattr("vislam.calibration.reporter.os.cpu_count", lambda: 2)
    reporter = Reporter(lines.append, lambda config, where: kept.append((config, where)), processes=2)
    reporter.begin(Work(shared=20.0, alone=5.0), run=2.0)
    now[0] = 10.0
    reporter.round("config", Round(1, np.zeros(1), -10.0, 3.0), choice=1)
    now[0] = 31.0
    reporter.round("other", Round(2, np.zeros(1), -9.0, 1.0), choice=2)
    assert lines == [
        "it will take about 30 s: some 25 runs of the filter of 2 s, 2 side by side",
        "choice 1 of at most 3, round 1: log likelihood -10.0, gained 3.0; about 20 s left",
        "choice 2 of at most 3, round 2: log likelihood -9.0, gained 1.0; "
        "takes longer than searches do as a rule",
    ]
    assert [config for config, _ in kept] == ["config", "other"]
