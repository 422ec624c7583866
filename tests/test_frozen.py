"""The common observation set: what one estimator left out, none is given."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from tests.cli.test_compare import TINY, config_file
from tests.test_estimator import Scripted, everything
from vislam.base.errors import ConfigError, DivergedError
from vislam.cli.console import Terminal
from vislam.compare import main
from vislam.comparison.compare import compare, make_problem, pixel_sigma
from vislam.comparison.config import Config, HeldOutConfig
from vislam.comparison.members import members
from vislam.comparison.open import Dataset
from vislam.core import estimator
from vislam.core.observation_set import CommonSet
from vislam.estimators.ekf import EkfEstimator
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.loop import run


def build_ends(problem, options):
    """Fuses everything on the way, and in the end takes out track 3, as far as it was given that."""
    return Scripted(lambda frame: everything(frame) & (frame.stereo.track != 3))


def build_whole(problem, options):
    """Fuses whatever it is given; who asks is told what gate it was given, in the events."""
    return Scripted(everything, events=(f"gate {problem.gate_probability}",))


def build_blind(problem, options):
    return Scripted(lambda frame: ~everything(frame))


def build_failing(problem, options):
    def fail(frame):
        if frame.k == 4:
            raise DivergedError("lost")
        return everything(frame)

    return Scripted(fail)


@pytest.fixture
def scripted(monkeypatch):
    """Makes estimators installed that fuse what a test can foresee."""
    builders = {"picky": build_ends, "whole": build_whole, "blind": build_blind, "failing": build_failing}
    found = estimator.find
    monkeypatch.setattr(estimator, "find", lambda name, **at: builders.get(name) or found(name, **at))


def compared(config, folder, **changes):
    config = replace(config, seed=3, held_out=HeldOutConfig(share=0.0), **changes)
    return compare(
        config, out=folder, data_dir=None, allow_substitute=True, progress=Terminal(), report=False
    )


def test_what_one_refused_no_other_fuses(scripted, short: Dataset, short_config: Config, tmp_path):
    sections = {"whole": {}, "picky": {}, "free": {"estimator": "whole", "observations": "all"}}
    sections["ekf"] = {"track_errors": "states"}
    outcome = compared(short_config, tmp_path, estimators=sections, common_set_from=("picky", "ekf"))
    assert all(run.complete for run in outcome.results.runs.values())
    planted = short.sequence.track == 3
    assert planted.any()
    for name in ("whole", "picky", "ekf"):
        assert not np.any(outcome.results.runs[name].used & planted)
    assert outcome.results.runs["free"].used.all()
    # What the filter's gate refuses in its own run, on what the picky one left of it, is off the list, too.
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    alone = run(
        members(replace(short_config, estimators={"ekf": sections["ekf"]}))["ekf"].build(problem),
        short.sequence,
        sigma,
        name="ekf",
        usable=~planted,
    )
    assert alone.gated.any()
    # What is left of a track that is seen once says nothing of the motion.
    listed = alone.used & short.sequence.seen_again(alone.used)
    assert np.array_equal(outcome.results.runs["whole"].used, listed)
    assert np.array_equal(outcome.results.record.common_set.kept, listed)
    assert outcome.results.record.common_set.not_fused(outcome.results.runs) == {
        "whole": 0,
        "picky": 0,
        "ekf": 0,
    }
    # Nobody gates on the list; off it, all is as the config says.
    assert outcome.results.runs["whole"].log.events == ("gate 1.0",)
    assert outcome.results.runs["free"].log.events == (f"gate {short_config.gate_probability}",)
    assert not outcome.results.runs["ekf"].gated.any()


def test_the_list_has_a_name_of_its_own(short: Dataset):
    kept = np.arange(short.sequence.observations) % 5 > 0
    common_set = CommonSet.of(short.sequence, kept, by=("ekf",))
    assert len(common_set.digest) == 12
    assert CommonSet.of(short.sequence, kept.copy(), by=("ekf",)).digest == common_set.digest
    fewer = kept.copy()
    fewer[np.flatnonzero(kept)[-1]] = False
    assert CommonSet.of(short.sequence, fewer, by=("ekf",)).digest != common_set.digest
    other = replace(short.sequence, digest="another recording")
    assert CommonSet.of(other, kept, by=("ekf",)).digest != common_set.digest
    # The same observations, when a repair has dropped others already.
    dropped = short.sequence.select(kept)
    same = CommonSet.of(dropped, np.ones(dropped.observations, bool), by=("ekf",))
    assert same.digest == common_set.digest


CHAIN = """
common_set_from: [ekf, isam2]
gate_probability: 0.9
estimators:
  dead_reckoning: {}
  ekf_all: {estimator: ekf, observations: all}
  ekf: {}
  isam2: {}
ablation_chain: {dead_reckoning: inertial samples, ekf: the camera, isam2: smoothing}
"""


@pytest.mark.slow
def test_the_command_reports_set_and_chain_and_a_rerun_has_the_same(tmp_path, capsys):
    config = config_file(tmp_path / "steps.yaml", f"extends: {TINY}\nname: steps\n{CHAIN}")
    documents = []
    for out in ("one", "two"):
        assert main(["--config", config, "--out", str(tmp_path / out)]) == 0
        (folder,) = (tmp_path / out).iterdir()
        documents.append(json.loads((folder / "metrics.json").read_text()))
    common_set = documents[0]["dataset"]["common_set"]
    assert common_set == documents[1]["dataset"]["common_set"]
    assert common_set["by"] == ["ekf", "isam2"]
    assert 0 < common_set["kept"] < common_set["of"]
    runs = documents[0]["runs"]
    assert runs["dead_reckoning"]["listed_not_fused"] == common_set["kept"]
    assert runs["ekf"]["listed_not_fused"] == 0
    assert runs["ekf_all"]["listed_not_fused"] is None
    assert runs["ekf"]["events"] == []
    page = (folder / "report.html").read_text()
    kept, of = common_set["kept"], common_set["of"]
    said = f"Common observation set {common_set['digest']}: {kept} of {of} observations, "
    said += "which ekf"
    assert said in capsys.readouterr().out
    assert said in page
    assert "instead: ekf_all." in page
    value = {
        m["estimator"]: m["value"]
        for m in documents[0]["metrics"]
        if (m["key"], m["estimate"]) == ("ate_rmse", "filtered")
    }
    steps = documents[0]["attribution"]
    assert [step["run"] for step in steps] == ["dead_reckoning", "ekf", "isam2"]
    assert steps[2]["filtered_change"] == value["isam2"] - value["ekf"]
    assert "<td>the camera</td>" in page
    assert f"<td>{steps[2]['filtered_change']:+.2f}</td>" in page


def test_a_filter_takes_a_gate_of_one_for_none(short: Dataset, short_config: Config):
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    open_gate = EkfEstimator(replace(problem, gate_probability=1.0), EkfOptions())
    without = EkfEstimator(problem, EkfOptions(gate=False))
    one = run(open_gate, short.sequence, sigma, name="one")
    other = run(without, short.sequence, sigma, name="other")
    assert not one.gated.any()
    assert np.array_equal(one.final.world_T_imu, other.final.world_T_imu)


NO_LIST = {
    "a name that does not run": (
        {"ekf": {}},
        ("isam3",),
        ConfigError("estimators.common_set_from.estimator: isam3: no such estimator"),
    ),
    "no list to be exempt from": (
        {"ekf": {"observations": "all"}},
        (),
        ConfigError("estimators.ekf.observations: all are given anyway"),
    ),
    "neither the list nor all": (
        {"ekf": {"observations": "some"}},
        ("ekf",),
        ConfigError("estimators.ekf.observations: Input should be"),
    ),
    "nothing is left": (
        {"blind": {}},
        ("blind",),
        ConfigError("common_set_from: blind has fused no observation"),
    ),
    "one that fails": (
        {"failing": {}},
        ("failing",),
        DivergedError(
            "common_set_from: failing is incomplete, so there is no list: frame 4: DivergedError: lost"
        ),
    ),
}


@pytest.mark.parametrize("case", sorted(NO_LIST))
@pytest.mark.usefixtures("scripted")
def test_what_makes_no_list_gets_a_line(case, short_config, tmp_path):
    sections, by, wanted = NO_LIST[case]
    with pytest.raises(type(wanted), match=re.escape(str(wanted))):
        compared(short_config, tmp_path, estimators=sections, common_set_from=by)


def test_by_default_a_consistent_filter_makes_the_list_for_all(scripted, short_config, tmp_path):
    del scripted
    default = replace(short_config, common_set_from=Config.__dataclass_fields__["common_set_from"].default)
    outcome = compared(default, tmp_path, estimators={"whole": {}, "ekf": {}, "isam2": {}})
    common_set = outcome.results.record.common_set
    assert common_set.by == ("ekf_invariant",)
    for name in ("whole", "ekf"):
        assert np.array_equal(outcome.results.runs[name].used, common_set.kept)
    assert np.mean(outcome.results.runs["isam2"].used[common_set.kept]) > 0.99


def test_a_default_list_that_cannot_be_made_stops_nothing(monkeypatch, short_config, tmp_path):
    whole = EkfEstimator.process

    def failing(self, frame):
        if frame.k == 5 and self._options.error == "invariant":
            raise DivergedError("covariance lost")
        return whole(self, frame)

    monkeypatch.setattr(EkfEstimator, "process", failing)
    default = replace(short_config, common_set_from=Config.__dataclass_fields__["common_set_from"].default)
    outcome = compared(default, tmp_path, estimators={"ekf": {}})
    assert outcome.results.record.common_set is None
    assert outcome.results.runs["ekf"].complete
