"""Points of a study and the ids of its trials."""

import json
from dataclasses import replace

import numpy as np
import pytest

from vislam import config as configuration
from vislam.config import Config
from vislam.errors import ConfigError
from vislam.study.points import Point, all_points, all_trials, point_values
from vislam.study.settings import LatinHypercube, StudyConfig

PIXELS, FRAMES = "noise.pixel_sigma_px", "data.simulation.frames"


def ids(config, *, seeds=range(2), code="abc", study=None):
    points = all_points(config, study or StudyConfig())
    return [trial.id for trial in all_trials(points, seeds=seeds, code=code)]


def test_ids_are_pure_and_tell_config_seed_and_code_apart(short_config):
    first = ids(short_config)
    assert first == ids(short_config)
    noisy = replace(short_config, noise=replace(short_config.noise, pixel_sigma_px=0.31))
    others = [*ids(noisy), *ids(short_config, seeds=range(2, 4)), *ids(short_config, code="abd")]
    assert len({*first, *others}) == 8


def test_ids_do_not_depend_on_how_a_study_came_to_its_trials(short_config):
    swept = StudyConfig(grid={FRAMES: (20, 25)}, metrics=("ate_rmse",))
    assert ids(short_config, study=swept)[2:] == ids(short_config)
    assert ids(replace(short_config, seed=7, study=swept, blas_threads=2)) == ids(short_config)


def test_a_grid_combines_each_value_with_each():
    study = StudyConfig(grid={PIXELS: (0.5, 1.0), FRAMES: (20, 30, 40)})
    found = [(values[PIXELS], values[FRAMES]) for values in point_values(study)]
    assert found == [(0.5, 20), (0.5, 30), (0.5, 40), (1.0, 20), (1.0, 30), (1.0, 40)]


def test_without_a_sweep_the_config_is_the_one_point(short_config):
    (point,) = all_points(short_config, StudyConfig())
    assert point.values == {}
    assert configuration.parse(Config, point.tree) == short_config


def test_a_latin_hypercube_has_one_point_in_each_part_of_each_range():
    ranges = {PIXELS: (0.2, 2.2), "noise.drift_px": (0.0, 0.5)}
    study = StudyConfig(latin_hypercube=LatinHypercube(samples=10, ranges=ranges, seed=4))
    found = list(point_values(study))
    assert found == list(point_values(study))
    for path, (low, high) in ranges.items():
        parts = [int(10 * (values[path] - low) / (high - low)) for values in found]
        assert sorted(parts) == list(range(10))
    other = StudyConfig(latin_hypercube=LatinHypercube(samples=10, ranges=ranges, seed=5))
    assert not np.isclose(next(point_values(other))[PIXELS], found[0][PIXELS])


def test_a_point_holds_its_values_and_survives_json(short_config):
    point = Point.of(short_config, {"estimators.ekf.gate": False, PIXELS: 2})
    found = configuration.parse(Config, json.loads(json.dumps(point.tree)))
    assert found.estimators["ekf"] == {"gate": False}
    assert found.noise.pixel_sigma_px == 2.0
    assert short_config.estimators["ekf"] == {}


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        ({"noise.pixel_sigma": (1.0,)}, "study: noise.pixel_sigma: unknown key"),
        ({PIXELS: (1.0, -1.0)}, "study: noise.pixel_sigma_px: .*greater than 0, got -1.0"),
        ({"name.of": (1,)}, "study: name.of cannot be swept"),
        ({"seed": (1, 2)}, "study: seed cannot be swept"),
        ({"estimators.ekff.gate": (True,)}, "study: estimators.ekff"),
    ],
)
def test_what_the_config_does_not_take_is_refused(short_config, grid, message):
    with pytest.raises(ConfigError, match=message):
        all_points(short_config, StudyConfig(grid=grid))
