"""Configurations: those that build on others, and those that are none."""

import dataclasses
import math
import os
import re
from copy import deepcopy
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from vislam.base.errors import ConfigError
from vislam.base.yaml_text import parse_yaml
from vislam.comparison import config
from vislam.comparison.config import Config
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.msckf.options import MsckfOptions
from vislam.estimators.smoother.options import SmootherOptions
from vislam_baselines.mapping_only import MappingOnlyOptions
from vislam_baselines.report_ekf import ReportEkfOptions

CONFIGS = sorted((Path(__file__).parents[1] / "configs").rglob("*.yaml"))
BASE = """
name: base
data: {simulation: {frames: 30, speed: 9.0}}
noise: {pixel_sigma_px: 0.7}
estimators: {ekf: {gate: false}, isam2: {}}
"""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_config_goes_over_the_one_it_extends(tmp_path):
    write(tmp_path, "base.yaml", BASE)
    path = write(
        tmp_path,
        "own.yaml",
        "extends: base.yaml\nname: own\ndata: {simulation: {frames: 40}}\nestimators: {eks: {}}",
    )
    found = config.load(path, overrides={"noise.drift_px": 0.1})
    assert found.name == "own"
    assert (found.data.simulation.frames, found.data.simulation.speed) == (40, 9.0)
    assert (found.noise.pixel_sigma_px, found.noise.drift_px) == (0.7, 0.1)
    assert found.estimators == {"eks": {}}


LADDER = {"ekf": "the camera", "isam2": "smoothing"}


def test_an_ablation_chain_is_replaced_whole_and_told_whole(tmp_path):
    write(tmp_path, "base.yaml", f"{BASE}ablation_chain: {LADDER}")
    own = write(
        tmp_path,
        "own.yaml",
        "extends: base.yaml\nestimators: {eks: {}, ekf: {}}\nablation_chain: {eks: all, ekf: less}",
    )
    found = config.load(own)
    assert list(found.ablation_chain) == ["eks", "ekf"]
    chosen = config.with_estimators(found, {"ekf": {}, "eks": {}, "isam2": {}})
    assert chosen.ablation_chain == found.ablation_chain
    assert config.with_estimators(found, {"ekf": {}}).ablation_chain == {}


FORMER = """
noise: {match_px: 0.3, climb: {walk: 0.1}}
data:
  simulation: {match_px: 0.2, match_share: 0.01, levelled_velocity: true, stale_probability: 0.1}
  repair: {stale_tracks: false, single_sightings: false, levelled_velocity: true}
ladder: {ekf: all}
frozen_by: [ekf]
study: {grid: {noise.match_px: [0.1, 0.2], noise.climb.walk: [0.1]}}
"""


def test_former_names_of_keys_are_accepted_and_noted_in_one_line(tmp_path, caplog):
    former = write(tmp_path, "former.yaml", f"name: former\n{FORMER}")
    found = config.load(former, overrides={"frozen_by": ["isam2"], "noise.climb.walk": 0.2})
    assert found.ablation_chain == {"ekf": "all"}
    assert found.common_set_from == ("isam2",)
    assert (found.noise.matching_bias_px, found.noise.vertical_velocity.walk) == (0.3, 0.2)
    simulated, repair = found.data.simulation, found.data.repair
    assert (simulated.matching_bias_px, simulated.matching_bias_share) == (0.2, 0.01)
    assert (simulated.navigation_frame_velocity, simulated.duplication_probability) == (True, 0.1)
    assert (repair.duplicated_tracks, repair.single_observations) == (None, None)
    assert repair.navigation_frame_velocity is not None
    assert list(found.study["grid"]) == ["noise.matching_bias_px", "noise.vertical_velocity.walk"]
    (line,) = [record.message for record in caplog.records if "former.yaml" in record.message]
    assert "frozen_by is now called common_set_from" in line
    assert "noise.match_px is now called matching_bias_px" in line
    assert line.endswith("this version takes the former names, too")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frozen_by: []\ncommon_set_from: []", "frozen_by is the former name of common_set_from: give one"),
        ("noise: {match_px: 1, matching_bias_px: 1}", "match_px is the former name of matching_bias_px"),
    ],
)
def test_a_key_under_both_its_names_gets_a_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        config.load(write(tmp_path, "both.yaml", f"{BASE.partition('noise')[0]}{text}"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: none.yaml", "none.yaml: cannot be read"),
        ("extends: 3", "extends: expected a file name, got 3"),
        ("extends: own.yaml", "in a circle"),
    ],
)
def test_what_cannot_be_extended_gets_a_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        config.load(write(tmp_path, "own.yaml", text))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_config_is_one(path):
    assert config.load(path).name == path.stem


def circular(folder):
    write(folder, "other.yaml", "extends: own.yaml")
    return "extends: other.yaml"


def long_chain(folder):
    for link in range(100):
        write(folder, f"{link}.yaml", f"extends: {link + 1}.yaml")
    return "extends: 0.yaml"


def named_pipe(folder):
    os.mkfifo(folder / "pipe")
    return "extends: pipe"


def looping_link(folder):
    (folder / "loop").symlink_to("loop")
    return "extends: loop"


def not_text(folder):
    (folder / "bytes").write_bytes(b"name: \xff")
    return "extends: bytes"


def huge(folder):
    with (folder / "huge").open("wb") as file:
        file.truncate(10**10)
    return "extends: huge"


BAD_BASES = {
    circular: "in a circle",
    long_chain: "more than 16 files build on each other",
    named_pipe: "pipe: cannot be read (it is a pipe, not a file)",
    looping_link: "loop: cannot be read (Too many levels of symbolic links)",
    not_text: "bytes: not a YAML file ('utf-8' codec can't decode byte 0xff",
    huge: "huge: not a YAML file (expected at most 262144 bytes, got more)",
    lambda _: "extends: .": "cannot be read (it is a folder, not a file)",
    lambda _: "extends: /dev/zero": "cannot be read (it is a device, not a file)",
    lambda _: f"extends: {'a' * 300}": "cannot be read (File name too long)",
    lambda _: f"extends: {'a/' * 5000}b": "cannot be read (File name too long)",
    lambda _: 'extends: "a\\0b"': "expected letters that a file can hold",
    lambda _: f"extends: [{'a, ' * 5000}]": "expected a file name, got ['a', 'a'",
}


@pytest.mark.parametrize("make", BAD_BASES, ids=BAD_BASES.values())
def test_what_cannot_be_built_on_is_one_bounded_line(tmp_path, make):
    path = write(tmp_path, "own.yaml", make(tmp_path))
    with pytest.raises(ConfigError, match=re.escape(BAD_BASES[make])) as caught:
        config.load(path)
    assert_short(caught.value)


def assert_short(error):
    assert len(str(error)) <= 1000
    assert str(error).isprintable()


def finite_fields(kind, path=()):
    """Path of every number of a section that is not a whole one; numbers that go together have one."""
    for item in dataclasses.fields(kind):
        yield from _numbers(item.type, (*path, item.name))


def _numbers(annotation, path):
    if annotation is float:
        yield path
    elif isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        yield from finite_fields(annotation, path)
    else:
        for part in get_args(annotation):
            yield from _numbers(part, path)


KINDS = (Config, EkfOptions, MsckfOptions, SmootherOptions, MappingOnlyOptions, ReportEkfOptions)
NUMBERS = [
    (kind, path)
    for kind in KINDS
    for path in dict.fromkeys(finite_fields(kind))
    # Lists of sections, whose items have names of their own.
    if path[0] != "checks"
]
FRAME = {
    "name": "n",
    "data": {
        "file": "a.npz",
        "simulation": {"recorded": {"file": "a", "format": "tum"}, "path": "recorded"},
        "reference": {"file": "a", "format": "tum", "name": "a", "limits": "a"},
        "redraw_inertial": {"twist_density": [0.0] * 6},
    },
    "study": {"latin_hypercube": {"samples": 1, "ranges": {"a": [0, 1]}}},
}


def test_the_numbers_are_found():
    assert len(NUMBERS) > 60
    assert (Config, ("data", "repair", "clock", "offset")) in NUMBERS


@pytest.mark.parametrize(
    "value", [math.inf, -math.inf, math.nan, "inf", "nan", "1e999", 10**400], ids=lambda value: str(value)[:6]
)
def test_every_number_is_finite(value):
    for kind, path in NUMBERS:
        tree = deepcopy(FRAME) if kind is Config else {}
        if path[:2] == ("data", "packaged"):
            tree["data"] = {"packaged": {"name": "kitti00"}}
        if path[:2] == ("data", "source"):
            made = path[2] in ("gyro_sigma", "velocity_sigma")
            poses = {"recorded": {"file": "a", "format": "tum"}, "path": "recorded"}
            source = {"format": "kitti00"} if made else {"format": "simulation", **poses}
            tree["data"] = {"source": source}
        if path[:2] == ("data", "redraw_inertial"):
            tree["data"] = {"redraw_inertial": {"twist_density": [1.0] * 6}}
        section = tree
        for part in path[:-1]:
            if not isinstance(section.get(part), dict):
                section[part] = {}
            section = section[part]
        name = path[-1]
        section[name] = {"a": [0, value]} if name == "ranges" else value
        found = []
        for shaped in (section[name], [value] * 2, [value] * 3, [value] * 6):
            section[name] = shaped
            with pytest.raises(ConfigError) as caught:
                config.parse(kind, tree)
            assert_short(caught.value)
            found.append(str(caught.value))
        where = ".".join(path)
        words = ("finite", "valid number", "below 2^63")
        assert any(f"{where}" in told and any(word in told for word in words) for told in found), found


TREES = {path.stem: config.read(path) for path in CONFIGS}
ANY_TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
NASTY = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | ANY_TEXT
    | st.sampled_from(
        [10**5000, "x" * 10**5, ["x"] * 1000, {"a": {"b": {"c": 1}}}, {}, [], "$[/]", "a\x1b[31m"]
    )
    | st.lists(st.floats(), max_size=6)
    | st.dictionaries(st.text(max_size=4), st.integers(), max_size=2)
)


def places(tree, path=()):
    yield path
    if isinstance(tree, dict):
        for key, item in tree.items():
            yield from places(item, (*path, key))
    elif isinstance(tree, list):
        for index, item in enumerate(tree):
            yield from places(item, (*path, index))


@settings(deadline=None, max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_a_config_with_anything_in_any_place_is_one_or_a_line(data):
    tree = deepcopy(TREES[data.draw(st.sampled_from(sorted(TREES)))])
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(list(places(tree))[1:]))
        section = tree
        for part in path[:-1]:
            section = section[part]
        key = (
            data.draw(st.text(max_size=5)) if data.draw(st.booleans()) and type(path[-1]) is str else path[-1]
        )
        section[key] = deepcopy(data.draw(NASTY))
    try:
        found = config.parse(Config, tree)
    except ConfigError as error:
        assert_short(error)
    else:
        # Not equal in themselves: an estimator's options, which it checks when it is built, may hold NaN.
        text = config.dump(found)
        assert config.dump(config.parse(Config, parse_yaml(text))) == text


@given(st.text(), NASTY)
@example("", 1)
@example("a..b", 1)
@example(".name", 1)
@example("name.", 1)
@example("name.first", 1)
@example("checks.0.at_most", 1)
@example("a." * 100_000 + "a", 1)
@example("noise", 3)
@example("seed", 10**5000)
@example("estimators.ekf.gate", 10**5000)
@example("name", "a\0b")
def test_a_value_by_its_path_is_put_or_refused_with_a_line(dotted, value):
    tree = deepcopy(TREES["ci"])
    try:
        config.put(tree, dotted, value)
        config.parse(Config, tree)
    except ConfigError as error:
        assert_short(error)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth_min": 9.0, "depth_max": 5.0}, "depth_min must not be above depth_max, got 9 and 5"),
        (
            {"extrinsic_axes": ["x", "y", "w"]},
            "extrinsic_axes: an axis must be x, y, z, -x, -y or -z, got 'w'",
        ),
        ({"extrinsic_axes": ["x", "x", "z"]}, "extrinsic_axes: axes must form a right-handed turn"),
        ({"extrinsic_axes": ["x", "y", "-z"]}, "extrinsic_axes: axes must form a right-handed turn"),
        ({"extrinsic_axes": ["x", "y", ""]}, "extrinsic_axes: an axis must be x, y, z"),
    ],
)
def test_swapped_depths_and_wrong_axes_have_a_line_of_their_own(changes, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        config.parse(Config, {"name": "n", "data": {"simulation": changes}})


@pytest.mark.parametrize("name", ["", "x" * 129, "x" * 10**6, 3, None])
def test_a_name_has_a_bounded_length(name):
    with pytest.raises(ConfigError, match="name: ") as caught:
        config.parse(Config, {"name": name, "data": {"simulation": {}}})
    assert_short(caught.value)


@pytest.mark.parametrize("section", ["seed", "held_out.seed"])
@pytest.mark.parametrize("value", [-1, 1 << 63, "9" * 5000, 0.5])
def test_a_seed_fits_into_a_table(section, value):
    tree = {"name": "n", "data": {"simulation": {}}}
    config.put(tree, section, value)
    with pytest.raises(ConfigError, match=section):
        config.parse(Config, tree)
