"""Whether information was equal: planted differences are named, and shipped configs have none."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import SHORT
from vislam.base.progress import Silent
from vislam.base.shipped import shipped_configs
from vislam.comparison.compare import make_problem, run_comparison
from vislam.comparison.config import Config, DataConfig, load
from vislam.comparison.members import members
from vislam.comparison.open import open_dataset
from vislam.core.observation_set import CommonSet
from vislam.core.run import Innovations, Run
from vislam.core.trajectory import Poses
from vislam.evaluation.information import shared_information, unequal_line

N = 1000
SAID = {"noise of the tracks": "independent", "kernel": "none", "twist bias": "estimated"}


def made(name, *, used=None, blind=False, **information):
    nothing = np.zeros(N, bool)
    return Run(
        name=name,
        frames_expected=1,
        frame=np.arange(1),
        stamp=np.zeros(1),
        filtered=Poses(np.eye(4)[None]),
        innovations=Innovations.unknown(1),
        used=~nothing if used is None else used,
        gated=nothing,
        blind=blind,
        information={**SAID, **information} if information != {"silent": True} else {},
    )


def listed(exempt=()):
    return CommonSet(("ekf_invariant",), exempt, np.ones(N, bool), "x")


def differs(*runs, common_set):
    (found,) = shared_information({run.name: run for run in runs}, common_set)
    assert found.equal == (not found.differs)
    return list(found.differs)


def left_out(count):
    used = np.ones(N, bool)
    used[:count] = False
    return used


def test_the_same_is_the_same_and_a_blind_run_is_in_no_pair():
    assert differs(made("a"), made("b"), common_set=listed()) == []
    assert differs(made("a"), made("b", used=left_out(10)), common_set=listed()) == []
    assert shared_information({"a": made("a"), "d": made("d", blind=True)}, listed()) == []
    assert unequal_line(shared_information({"a": made("a"), "b": made("b")}, listed())) == ""


def test_many_runs_of_two_kinds_are_one_clause():
    runs = [made("a"), made("b", kernel="huber"), made("c"), made("d", kernel="huber")]
    found = shared_information({run.name: run for run in runs}, listed())
    assert unequal_line(found) == "Information was not equal: a (so c) and b (so d) (kernel: none and huber)."


def test_runs_that_differ_from_each_other_only_are_named():
    runs = [made("a", used=left_out(8)), made("b", used=left_out(0)), made("c", used=left_out(16))]
    found = shared_information({run.name: run for run in runs}, None)
    assert [item.equal for item in found] == [True, True, False]
    assert unequal_line(found) == (
        "Information was not equal: b and c (no common list, 16 observations were fused by one of them only)."
    )


@pytest.mark.parametrize(
    ("other", "common_set", "said"),
    [
        (made("b", used=left_out(11)), listed(), "b left out 1.1 % of the common observations"),
        (made("b"), listed(exempt=("b",)), "b was given all observations"),
        (
            made("b", used=left_out(11)),
            None,
            "no common list, 11 observations were fused by one of them only",
        ),
        (made("b", kernel="huber"), listed(), "kernel: none and huber"),
        (made("b", silent=True), listed(), "b does not say what it assumes"),
    ],
    ids=["observations", "exempt", "no list", "kernel", "silent"],
)
def test_a_planted_difference_is_named(other, common_set, said):
    assert differs(made("a"), other, common_set=common_set) == [said]
    pairs = shared_information({"a": made("a"), "b": other}, common_set)
    assert unequal_line(pairs) == f"Information was not equal: a and b ({said})."


HEADLINES = ["ds3", "kitti07", "kitti00", "tiny"]


@pytest.mark.parametrize("name", HEADLINES)
def test_the_headline_configs_pose_one_problem_to_all(name):
    """Built as shipped, on a short simulated drive in place of the recording."""
    config = load(shipped_configs()[name])
    seeing = {key: value for key, value in config.estimators.items() if key != "dead_reckoning"}
    assert len(seeing) >= 2
    short = replace(
        config,
        data=DataConfig(simulation=replace(SHORT, outlier_probability=0.02), repair=config.data.repair),
        estimators=seeing,
    )
    short = replace(short, data=replace(short.data, repair=replace(short.data.repair, consensus=None)))
    dataset = open_dataset(short.data, seed=1)
    results = run_comparison(_without_climb(short), dataset, Silent())
    assert results.record.common_set is not None
    for pair in results.shared_information():
        assert pair.equal, pair


def _without_climb(config: Config) -> Config:
    """The short drive has no vertical velocity."""
    return replace(config, noise=replace(config.noise, vertical_velocity=None))


def test_members_of_the_families_say_what_they_assume(short, short_config):
    sections = ["ekf", "ekf_track_states", "ekf_invariant", "eks", "isam2", "fixed_lag", "batch", "batch_gnc"]
    config = replace(short_config, estimators={name: {} for name in sections})
    problem = make_problem(config, short)
    for name, member in members(config).items():
        assert member.build(problem).information.keys() == SAID.keys(), name
