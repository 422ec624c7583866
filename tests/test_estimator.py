"""What the loop makes of what an estimator says."""

import numpy as np
import pytest

from vislam.comparison.open import Dataset
from vislam.core.step import Final, Step
from vislam.estimators import loop


class Scripted:
    """Stays where it is, fuses what the script says of each frame, and says in the end what it is given."""

    def __init__(self, uses, **final):
        self._uses, self._final = uses, final

    def process(self, frame):
        return Step(np.eye(4), used=self._uses(frame) & frame.stereo.usable)

    def finalize(self):
        return Final(**self._final)


def scripted_run(short, uses, **final):
    sigma = np.ones((short.sequence.observations, 3))
    return loop.run(Scripted(uses, **final), short.sequence, sigma, name="scripted")


def everything(frame):
    return np.ones(len(frame.stereo), bool)


def test_the_frames_have_the_last_word_unless_the_end_has(short: Dataset, rng):
    sequence = short.sequence
    odd = scripted_run(short, lambda frame: frame.stereo.track % 2 == 1)
    assert np.array_equal(odd.used, sequence.track % 2 == 1)
    # In any order, and one of them named twice.
    chosen = rng.permutation(sequence.observations)[: sequence.observations // 3]
    chosen = np.append(chosen, chosen[0])
    late = scripted_run(short, everything, fused=(sequence.frame_of[chosen], sequence.track[chosen]))
    assert late.complete
    assert np.array_equal(np.flatnonzero(late.used), np.unique(chosen))
    nothing = np.empty(0, np.int64)
    assert not scripted_run(short, everything, fused=(nothing, nothing)).used.any()


@pytest.mark.parametrize("track", [0, 10**6], ids=["out of view", "unknown"])
def test_an_observation_that_never_was_makes_a_run_incomplete(short: Dataset, track):
    last = len(short.sequence) - 1
    assert 0 not in short.sequence.track[short.sequence.offset[last] :]
    found = scripted_run(short, everything, fused=(np.array([last]), np.array([track])))
    assert found.log.error.endswith("1 of 1 pairs of frame and track are no observations of simulation")


def test_events_reach_the_run(short: Dataset):
    assert scripted_run(short, everything).log.events == ()
    assert scripted_run(short, everything, events=("frame 3: rescued",)).log.events == ("frame 3: rescued",)
