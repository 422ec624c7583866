"""Former names of options: accepted for one version, and noted."""

import numpy as np
import pytest

import vislam
from vislam.base import former as former_names
from vislam.base.errors import ConfigError, DataError
from vislam.base.files import save_archive
from vislam.base.shipped import find_config
from vislam.checks.settings import Check
from vislam.comparison.compare import make_problem
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.archive import read_archive
from vislam.core.estimator import find
from vislam.core.schema import Plain, Section, mask
from vislam.estimators.ekf import EkfOptions
from vislam.study.settings import StudyConfig


@pytest.fixture(autouse=True)
def _nothing_noted_before():
    """What is noted once in a process may have been noted by another test."""
    former_names._note.cache_clear()


def test_former_options_are_accepted_and_noted(short: Dataset, short_config: Config, caplog):
    problem = make_problem(short_config, short)
    former = {"finished": "as_left", "error": "first_estimates", "landmarks": "disparity"}
    built = find("ekf")(problem, former)
    assert built._options == EkfOptions(
        marginalised_landmarks="filtered", error="fej", landmarks="anchored_uvd"
    )
    (line,) = (message for message in caplog.messages if "SIMULATED" not in message)
    assert line.startswith("estimators.ekf: finished is now called marginalised_landmarks")
    assert "error: first_estimates is now called fej" in line
    with pytest.raises(ConfigError, match="finished is the former name of marginalised_landmarks"):
        find("ekf")(problem, {"finished": "as_left", "marginalised_landmarks": "smoothed"})
    smoother = {"start_clearance": 4.0, "max_waiting_views": 9, "max_rescues": 3}
    assert find("isam2")(problem, smoother)._options.initialisation_snr == 4.0


def test_former_keys_of_metrics_and_names_of_configs_are_accepted(caplog):
    assert (
        Check(estimator="ekf", metric="yaw_information_gained", at_most=1.0).metric
        == "spurious_yaw_information"
    )
    ranked = StudyConfig(metrics=("parting_frame", "ate_rmse"))
    assert ranked.metrics == ("divergence_frame", "ate_rmse")
    assert find_config("ladder") == find_config("ablation_chain") is not None
    noted = " ".join(caplog.messages)
    for one in (
        "yaw_information_gained is now",
        "parting_frame is now",
        "ladder is now called ablation_chain",
    ):
        assert one in noted


def test_archives_of_the_version_before_are_read(tmp_path):
    former = {
        "stand_in": True,
        "frozen": {"by": ["ekf"], "kept": {"array": "frozen.kept"}},
    }
    path = tmp_path / "a.npz"
    save_archive(path, former, {"frozen.kept": np.array([True, False])})
    table = {
        "synthetic": Plain(bool),
        "common_set": Section(optional=True),
        "common_set.by": Plain(tuple[str, ...]),
        "common_set.kept": mask("n"),
    }
    names = {"stand_in": "synthetic", "frozen": "common_set"}
    found = read_archive(path, table, what="an archive", former=names)
    assert found["synthetic"] is True
    assert found["common_set"]["kept"].tolist() == [True, False]
    with pytest.raises(DataError, match="an unknown field 'stand_in'"):
        read_archive(path, table, what="an archive")


def test_the_former_keyword_of_the_substitute_is_accepted(caplog):
    with pytest.raises(DataError, match=r"absent\.npz"):
        vislam.compare("tiny", allow_stand_in=False, **{"data.file": "absent.npz"})
    assert "allow_stand_in is now called allow_substitute" in caplog.text
