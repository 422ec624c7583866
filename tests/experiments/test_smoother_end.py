"""The benchmark of the smoother's end runs, and its two solvers agree."""

import pytest

from experiments.smoother_end import end
from experiments.timing import CONFIGS


@pytest.mark.slow
def test_the_end_is_solved_in_all_ways_with_the_same_covariances():
    part = end(CONFIGS / "tiny.yaml")
    assert {"all steps", "the end", "ours", "GTSAM, QR, COLAMD"} <= set(part.values)
    assert all(seconds >= 0.0 for seconds in part.values.values())
    assert part.values["apart"] < 1e-6
