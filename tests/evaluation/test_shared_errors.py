"""Shared errors as runs have estimated them, for metrics.json and the page."""

import numpy as np

from tests.evaluation.test_evaluation import circle, made_run
from vislam.core.run import StateHistory
from vislam.evaluation.shared_errors import estimated_errors
from vislam.report.page_tables import shared_errors_table


def test_the_last_estimate_and_the_last_sigma_that_was_given():
    value, sigma = np.zeros((4, 3)), np.full((4, 3), np.nan)
    value[-1], sigma[1] = [0.003, -0.002, 0.001], [1e-3, 2e-3, 3e-3]
    pose = circle(frames=4)
    never = StateHistory(np.full((4, 1), 0.25), np.full((4, 1), np.nan))
    states = {"camera_rotation": StateHistory(value, sigma), "disparity_offset": never, "scale": never}
    runs = {"one": made_run("one", pose, states=states), "other": made_run("other", pose)}
    rotation, offset = estimated_errors(runs)
    assert rotation.record() == {
        "run": "one",
        "name": "camera_rotation",
        "value": [0.003, -0.002, 0.001],
        "sigma": [1e-3, 2e-3, 3e-3],
        "unit": "rad",
    }
    assert offset.record()["sigma"] is None
    rows = shared_errors_table(runs).rows
    assert rows[0] == ["one", "camera rotation 1", "rad", "0.003", "0.001"]
    assert rows[3] == ["one", "disparity offset", "px", "0.25", "-"]
