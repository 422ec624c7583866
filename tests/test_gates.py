"""Whose gate decisions hold for whom: ``gates_from``."""

import numpy as np
import pytest

from vislam.base.progress import Silent
from vislam.comparison.compare import pixel_sigma
from vislam.comparison.keeping import NoKeeper
from vislam.comparison.open import Dataset
from vislam.comparison.running import Runner
from vislam.core.step import Final, Step

NAMES = ("before", "gating", "after", "last")


class Told:
    """Notes what it may not use, and gates every fifth observation of a frame if it is to."""

    def __init__(self, *, gates: bool) -> None:
        self.gates = gates
        self.refused: list[np.ndarray] = []

    def process(self, frame):
        usable = frame.stereo.usable
        self.refused.append(~usable)
        gated = np.zeros(len(usable), bool)
        gated[:: 5 if self.gates else len(usable) + 1] = self.gates
        return Step(np.eye(4), used=~gated & usable, gated=gated)

    def finalize(self):
        return Final()


def no_process(name, usable):
    raise AssertionError(f"{name} needs no process of its own")


def run_all(short: Dataset, short_config, gates_from):
    sigma = pixel_sigma(short_config, short)
    runner = Runner(short.sequence, sigma, 1, Silent(), NoKeeper(), "")
    told = {name: Told(gates=name == "gating") for name in NAMES}
    runs, interrupted = runner.run_all(told, common_set=None, gates_from=gates_from, job=no_process)
    assert not interrupted
    return runs, {name: np.concatenate(one.refused) for name, one in told.items()}


def test_the_decisions_of_one_hold_for_all_that_run_after_it(short: Dataset, short_config):
    runs, refused = run_all(short, short_config, "gating")
    gated = runs["gating"].gated
    assert 0.15 < gated.mean() < 0.3
    assert not refused["before"].any()
    assert not refused["gating"].any()
    for name in ("after", "last"):
        assert np.array_equal(refused[name], gated)
        assert not (runs[name].used & gated).any()


@pytest.mark.parametrize("gates_from", [None, "before"])
def test_without_decisions_nothing_is_refused(short: Dataset, short_config, gates_from):
    _, refused = run_all(short, short_config, gates_from)
    assert not any(one.any() for one in refused.values())
