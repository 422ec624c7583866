"""Points of a study and the ids of its trials."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vislam.base.errors import ConfigError
from vislam.base.settings import parse
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.study.plan import Plan
from vislam.study.points import Point, all_points, all_trials, point_values
from vislam.study.settings import LatinHypercube, StudyConfig
from vislam.study.trials import Trials

CONFIGS = Path(__file__).parents[2] / "configs"
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
    assert ids(replace(short_config, seed=7, study=asdict(swept), blas_threads=2)) == ids(short_config)


def test_a_grid_combines_each_value_with_each():
    study = StudyConfig(grid={PIXELS: (0.5, 1.0), FRAMES: (20, 30, 40)})
    found = [(values[PIXELS], values[FRAMES]) for values in point_values(study)]
    assert found == [(0.5, 20), (0.5, 30), (0.5, 40), (1.0, 20), (1.0, 30), (1.0, 40)]


def test_around_a_config_one_value_differs_at_a_time(short_config):
    own = short_config.noise.pixel_sigma_px
    study = StudyConfig(around={PIXELS: (0.7, 0.9), "held_out.seed": (1,)})
    points = all_points(short_config, study)
    found = [tuple(point.values.values()) for point in points]
    assert found == [(own, 0), (0.7, 0), (0.9, 0), (own, 1)]
    assert configuration.parse(Config, points[0].tree) == short_config
    off = StudyConfig(around={"data.repair.clock.offset": (0.1,)})
    with pytest.raises(ConfigError, match=r"has, got data\.repair\.clock\.offset; switch its section on"):
        all_points(short_config, off)
    with pytest.raises(ConfigError, match="got the same one twice"):
        all_points(short_config, StudyConfig(around={PIXELS: (own,)}))


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


EQUAL = {
    "a number twice": {PIXELS: (0.5, 1.0, 0.5)},
    "whole and not": {PIXELS: (1, 1.0)},
    "a text of the number": {PIXELS: (1.0, "1.0")},
    "two of a grid": {FRAMES: (20, 30), PIXELS: (1.0, 1)},
    "options that nobody has read yet": {"estimators.ekf.gate": (1, 1.0)},
    "true and 1": {"estimators.ekf.gate": (True, 1)},
    "lists": {"noise.bias_mean": ([0, 0, 0, 0, 0, 1], [0.0, 0, 0, 0, 0, 1])},
    "sections": {"estimators.ekf": ({}, {})},
    "no number": {"estimators.ekf.x": (float("nan"), float("nan"))},
    "nothing and the default of nothing": {"noise.vertical_velocity": (None, None)},
}


@pytest.mark.parametrize("case", EQUAL)
def test_points_that_are_the_same_are_refused(case, short_config):
    with pytest.raises(
        ConfigError, match=r"study: expected points that differ, got the same one twice \("
    ) as told:
        all_points(short_config, StudyConfig(grid=EQUAL[case]))
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    "defects",
    [
        {"none": {PIXELS: 0.3}, "real": {PIXELS: 1.0}},
        {"one": {PIXELS: 1.0}, "again": {PIXELS: 1}},
        {"covered": {PIXELS: 1.0}, "covers": {PIXELS: 2.0}},
    ],
)
def test_cases_of_an_ablation_that_are_the_same_are_refused(defects, short_config):
    with pytest.raises(ConfigError, match=r"got the same one twice \(case .* and case .*\); leave one out"):
        all_points(short_config, StudyConfig(defects=defects))


@settings(deadline=None, max_examples=40)
@given(
    st.dictionaries(
        st.sampled_from([PIXELS, "estimators.ekf.x"]),
        st.lists(st.sampled_from([1, 1.0, True, 2, "1", 0.5, [1], [1.0], {"a": 1}]), min_size=1, max_size=3),
        min_size=1,
    )
)
def test_points_are_refused_or_all_different(short_config, grid):
    study = StudyConfig(grid={path: tuple(values) for path, values in grid.items()})
    try:
        points = all_points(short_config, study)
    except ConfigError:
        return
    records = ({"seed": 0, "point": one.values, "status": "failed", "reason": "x"} for one in points)
    groups = Trials.of_records(records).groups()
    assert len({point.digest for point in points}) == len(points) == len(groups)
    assert all(len(rows) == 1 for _, rows in groups)


def test_sections_can_be_swept(short_config):
    points = all_points(
        short_config, StudyConfig(grid={"noise.vertical_velocity": (None, {"walk": 0.1}, {"walk": 0.2})})
    )
    assert [
        point.tree["noise"]["vertical_velocity"] and point.tree["noise"]["vertical_velocity"]["walk"]
        for point in points
    ] == [
        None,
        0.1,
        0.2,
    ]


def test_ids_tell_the_files_apart_that_a_config_names(short_config, tmp_path):
    run = tmp_path / "run.npz"
    config = replace(short_config, estimators={"known_map": {"map": str(run)}})
    found = {*ids(config, seeds=range(1))}
    for text in ("one", "two"):
        run.write_text(text, encoding="utf-8")
        found |= {*ids(config, seeds=range(1))}
    assert len(found) == 3


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.yaml")))
def test_the_points_of_what_comes_along_differ(path):
    config = configuration.load(path)
    if config.study is not None:
        assert all_points(config, parse(StudyConfig, config.study, at="study"))


def test_named_levels_set_what_belongs_together_and_go_with_the_grid(short_config):
    seen, told = "data.simulation.pixel_sigma_px", PIXELS
    named = {"camera": {"as given": {}, "coarse": {seen: 2.0, told: 2.5}}, "length": {"long": {FRAMES: 30}}}
    points = all_points(short_config, StudyConfig(named=named, grid={"held_out.share": (0.0, 0.1)}))
    assert [point.values["camera"] for point in points] == ["as given"] * 2 + ["coarse"] * 2
    assert points[0].values == {"camera": "as given", "length": "long", "held_out.share": 0.0}
    first, last = (configuration.parse(Config, points[place].tree) for place in (0, -1))
    assert first.noise == short_config.noise
    assert (last.data.simulation.pixel_sigma_px, last.noise.pixel_sigma_px) == (2.0, 2.5)
    assert (last.data.simulation.frames, last.held_out.share) == (30, 0.1)


@pytest.mark.parametrize(
    ("study", "told"),
    [
        ({"named": {"a.b": {"x": {}}}}, "without a dot, which is no path, got a.b"),
        ({"named": {"a": {"x": {PIXELS: 1.0}}}, "grid": {PIXELS: [1.0]}}, "is set by grid, too"),
        ({"named": {"a": {"x": {PIXELS: 1.0}}, "b": {"y": {PIXELS: 2.0}}}}, "is set by a, too; leave it"),
        ({"named": {"a": {"x": {}}}, "around": {PIXELS: [1.0]}}, "named with grid alone"),
        ({"named": {"a": {}}}, "named.a"),
    ],
)
def test_named_levels_that_cannot_be_are_told(study, told):
    with pytest.raises(ConfigError, match=told):
        parse(StudyConfig, study, at="study")


def test_named_levels_are_bound_by_what_cannot_be_swept(short_config):
    with pytest.raises(ConfigError, match="seed cannot be swept"):
        all_points(short_config, StudyConfig(named={"a": {"x": {"seed": 3}}}))
    with pytest.raises(ConfigError, match="got the same one twice"):
        all_points(short_config, StudyConfig(named={"a": {"x": {}, "y": {}}}))


def test_the_shipped_study_of_raw_inertia_gives_estimators_the_noise_that_it_simulates():
    plan = Plan.of(configuration.load(CONFIGS / "imu_filter_vs_smoother.yaml"))
    assert (len(plan.points), plan.upright) == (12, True)
    for point in plan.points:
        config = configuration.parse(Config, point.tree)
        drive, told = config.data.source, config.noise.imu
        for key in ("gyro_density", "accel_density", "gyro_walk", "accel_walk", "gravity"):
            assert getattr(drive.imu, key) == getattr(told, key), (point.label, key)
        hertz = float(point.values["camera_hz"])
        assert drive.period == 1 / hertz
        assert drive.frames == 6 * hertz + 1
        assert np.isclose(drive.loss_probability, 1 - 0.96 ** (10 / hertz), atol=5e-5)
        room = configuration.load(CONFIGS / "euroc_like.yaml").data.source
        if point.values["scene"] == "room":
            same = ("path", "speed", "rig", "depth_min", "depth_max")
            assert all(getattr(drive, key) == getattr(room, key) for key in same)
            assert drive.imu.rate == room.imu.rate
