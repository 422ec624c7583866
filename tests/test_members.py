"""Two settings of one estimator in one comparison."""

from dataclasses import replace

import numpy as np

from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.members import members
from vislam.comparison.open import Dataset
from vislam.estimators.loop import run


def test_a_section_may_name_its_estimator(short: Dataset, short_config: Config):
    sections = {
        "ekf_track_states": {},
        "plain": {"estimator": "ekf_track_states"},
        "ungated": {"estimator": "ekf_track_states", "gate": False},
    }
    config = replace(short_config, estimators=sections)
    problem, sigma = make_problem(config, short), pixel_sigma(config, short)
    runs = {
        name: run(member.build(problem), short.sequence, sigma, name=name)
        for name, member in members(config).items()
    }
    assert list(runs) == ["ekf_track_states", "plain", "ungated"]
    assert np.array_equal(runs["ekf_track_states"].final.world_T_imu, runs["plain"].final.world_T_imu)
    assert runs["ekf_track_states"].gated.any()
    assert not runs["ungated"].gated.any()
