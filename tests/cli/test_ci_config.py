"""The config that tells whether the estimators are sound: what it says of sound ones, and of others."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from vislam.compare import main
from vislam.comparison import config as configuration

CONFIG = Path(__file__).parents[2] / "configs" / "ci.yaml"
ESTIMATORS = ["ekf", "ekf_invariant", "eks", "isam2"]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder of the results of the config as it is, and of their XML."""
    folder = tmp_path_factory.mktemp("ci")
    asked = ["--config", str(CONFIG), "--out", str(folder / "out"), "--no-report"]
    code = main([*asked, "--junit", str(folder / "out.xml")])
    return code, json.loads(next(folder.rglob("metrics.json")).read_text()), folder / "out.xml"


def test_its_noise_section_states_what_is_simulated():
    config = configuration.load(CONFIG)
    simulated, noise = config.data.simulation, config.noise
    sigma = np.repeat([simulated.gyro_sigma, simulated.velocity_sigma], 3)
    assert noise.twist_density == pytest.approx(sigma * np.sqrt(simulated.period), rel=1e-8)
    assert (noise.pixel_sigma_px, noise.drift_px, noise.matching_bias_px) == (
        simulated.pixel_sigma_px,
        0.0,
        0.0,
    )
    assert (simulated.drift_px, simulated.matching_bias_px) == (0.0, 0.0)
    assert (simulated.outlier_probability, simulated.duplication_probability) == (0.0, 0.0)
    bias = np.array([*simulated.gyro_bias, *simulated.velocity_bias])
    assert np.all(np.abs(bias - noise.bias_mean) <= noise.bias_sigma)


@pytest.mark.slow
def test_every_run_completes_within_its_bounds(results):
    code, document, _ = results
    assert code == 0, [check for check in document["checks"] if not check["holds"]]
    assert list(document["runs"]) == ESTIMATORS
    assert all(run["complete"] for run in document["runs"].values())
    bounds = [check for check in document["checks"] if check["name"] == "ate_rmse"]
    assert [check["estimator"] for check in bounds] == [*ESTIMATORS, "isam2"]
    assert all(check["holds"] for check in bounds), bounds


@pytest.mark.slow
def test_nothing_is_chosen_by_its_noise(results):
    _, document, _ = results
    value = {(m["estimator"], m["key"]): m["value"] for m in document["metrics"]}
    counts = document["dataset"]["counts"]
    # What is held out is so before it is counted.
    given = counts["observations"]
    assert value["ekf_invariant", "observations_used"] == given
    assert all(value[name, "observations_gated"] == 0.0 for name in ESTIMATORS)


@pytest.mark.slow
def test_the_xml_has_a_case_for_each_run_and_each_check(results):
    _, document, path = results
    suite = ElementTree.parse(path).getroot()[0]
    assert int(suite.get("tests")) == len(ESTIMATORS) + len(document["checks"])
    assert suite.get("errors") == "0"
    assert int(suite.get("failures")) == sum(not check["holds"] for check in document["checks"])


def failing(folder, *options, estimators):
    """Checks that do not hold, by estimator and name, of a run that finishes and of which some fail."""
    asked = ["--config", str(CONFIG), "--out", str(folder), "--no-report", "--estimators", estimators]
    assert main([*asked, *options]) == 3
    checks = json.loads(next(folder.rglob("metrics.json")).read_text())["checks"]
    return {(check["estimator"], check["name"]) for check in checks if not check["holds"]}


@pytest.mark.slow
@pytest.mark.parametrize("pixels", [0.45, 0.6])
def test_a_wrong_level_of_noise_is_caught_in_filter_and_smoother(pixels, tmp_path):
    """The pixels scatter by 0.5."""
    wrong = ["--set", f"noise.pixel_sigma_px={pixels}"]
    failed = failing(tmp_path, *wrong, estimators="ekf_invariant,isam2")
    assert failed >= {("ekf_invariant", "nis"), ("isam2", "fit")}


def test_too_little_noise_of_the_motion_is_caught(tmp_path):
    wrong = ["--set", f"noise.twist_density={[0.0019] * 3 + [0.0316] * 3}"]
    assert ("ekf_invariant", "nis") in failing(tmp_path, *wrong, estimators="ekf_invariant")


def test_a_sign_error_in_a_jacobian_is_caught(tmp_path, monkeypatch):
    from vislam.estimators.ekf.measurement import View

    true = View.jacobians

    def turned(self, *arguments):
        by_nav, by_landmark = true(self, *arguments)
        by_nav[:, :, 3:6] *= -1.0
        return by_nav, by_landmark

    monkeypatch.setattr(View, "jacobians", turned)
    failed = failing(tmp_path, estimators="ekf_invariant")
    assert {name for _, name in failed} >= {"ate_rmse", "nis", "nees_pose"}


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf_invariant", "eks", "isam2"])
def test_a_swapped_order_of_the_tangent_is_caught(estimator, tmp_path, monkeypatch):
    """Covariances in the order (v, omega)."""
    from vislam.comparison import running

    true = running.loop.run

    def swapped(*arguments, **options):
        run = true(*arguments, **options)
        order = np.ix_(range(len(run.stamp)), [3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
        filtered, smoothed = (
            None if poses is None else replace(poses, cov=poses.covariances[order])
            for poses in (run.filtered, run.smoothed)
        )
        return replace(run, filtered=filtered, smoothed=smoothed)

    monkeypatch.setattr(running.loop, "run", swapped)
    failed = failing(tmp_path, estimators=estimator)
    assert (estimator, "nees_pose") in failed


def test_a_wrong_baseline_moves_the_drive_out_of_its_bounds(tmp_path):
    wrong = ["--set", "data.simulation.stated_baseline=0.62"]
    assert ("ekf_invariant", "ate_rmse") in failing(tmp_path, *wrong, estimators="ekf_invariant")
