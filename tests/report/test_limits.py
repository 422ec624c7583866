"""What waiting buys and how near errors come to the bound, from a comparison to its page."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vislam.base.errors import ConfigError
from vislam.base.progress import Silent
from vislam.comparison.bounding import refuse_unbounded
from vislam.comparison.compare import run_comparison
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.comparison.results import Results, metrics_document
from vislam.core.record import Record
from vislam.core.run import Run
from vislam.evaluation import Evaluation, evaluate
from vislam.report.figures import all_figures
from vislam.report.page_tables import lags_table
from vislam.report.shown import Shown
from vislam.report.verdict import verdict

EFFICIENCY = Path(__file__).parents[2] / "configs" / "efficiency.yaml"


@pytest.fixture(scope="module")
def found() -> tuple[Results, Evaluation]:
    small = {"data.simulation.frames": 16, "data.simulation.tracks_in_view": 14, "held_out.share": 0.2}
    config = load(EFFICIENCY, overrides=small)
    estimators = {"eks": {"gate": False}, "isam2": {"marginals": "poses"}, "dead_reckoning": {}}
    config = replace(config, estimators=estimators, lags=(0, 2, 5), lag_cov_every=3)
    dataset = open_dataset(config.data, seed=config.seed, held_out=config.held_out)
    results = run_comparison(config, dataset, Silent())
    return results, evaluate(results.runs, results.record)


def test_the_document_has_a_block_of_lags(found):
    results, evaluation = found
    document = metrics_document(results, evaluation, (), ())
    assert list(document["lag"]) == ["eks", "isam2"]
    lags = document["lag"]["eks"]["lags"]
    assert [lag["frames"] for lag in lags] == [0, 2, 5, None]
    assert {"ate_rmse", "rpe_1s_rmse", "held_out_median", "nees"} <= lags[0].keys()


def test_the_page_has_table_figures_and_a_sentence(found):
    results, evaluation = found
    table = lags_table(evaluation)
    assert [row[1] for row in table.rows] == ["0", "2", "5", "all"] * 2
    assert {len(row) for row in table.rows} == {len(table.header)}
    figures = all_figures(Shown.of(results.runs, results.record, evaluation, ()))
    assert {"lag_curve", "bound_filtered", "bound_smoothed"} <= figures.keys()
    told = [
        line
        for line in verdict(results.runs, evaluation, results.record.reference).reasons
        if "smoothing buys" in line
    ]
    assert [line.partition(":")[0] for line in told] == ["eks", "isam2"]


def test_estimates_are_near_the_bound_and_one_without_the_camera_is_not(found):
    _, evaluation = found
    for name in ("eks", "isam2"):
        for part in ("rotation", "position"):
            assert abs(evaluation.value(name, f"bound_excess_{part}", "smoothed")) < 20.0
    assert evaluation.value("dead_reckoning", "bound_ratio_position", "filtered") > 1.5


def test_lags_and_bound_are_kept_with_the_results(found, tmp_path):
    results, evaluation = found
    results.record.save(tmp_path / "record.npz")
    results.runs["eks"].save(tmp_path / "eks.npz")
    record, run = Record.load(tmp_path / "record.npz"), Run.load(tmp_path / "eks.npz")
    assert np.array_equal(record.bound.smoothed, results.record.bound.smoothed)
    again = evaluate({"eks": run}, record)
    for key in ("bound_excess_position", "ate_rmse_lag_5"):
        assert again.value("eks", key) == evaluation.value("eks", key)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("data.simulation.pixel_sigma_px", 0.4),
        ("data.simulation.outlier_probability", 0.01),
        ("data.simulation.gyro_sigma", 0.02),
        ("data.simulation.inertial_noise", "sample"),
        ("data.simulation.velocity_bias_walk", 0.1),
        ("data.simulation.gyro_bias", [0.01, 0.0, 0.0]),
        ("noise.acceleration_density", [0.1, 0.1, 0.1, 1.0, 1.0, 1.0]),
        ("noise.vertical_velocity", {}),
        ("data.file", "03.npz"),
        ("motion", "imu"),
    ],
)
def test_a_drive_without_a_bound_gets_a_line(path, value):
    with pytest.raises(
        ConfigError, match=r"^(data|noise|motion)\S*: expected .*, got .*bound: true"
    ) as raised:
        refuse_unbounded(load(EFFICIENCY, overrides={path: value}))
    assert "\n" not in str(raised.value)
    refuse_unbounded(load(EFFICIENCY, overrides={path: value, "bound": False}))


@pytest.mark.parametrize("lags", [[1, 0], [0, 0], [-1]])
def test_lags_out_of_order_get_a_line(lags):
    with pytest.raises(ConfigError, match="lags"):
        load(EFFICIENCY, overrides={"lags": lags})


@pytest.mark.statistical
def test_nobody_is_below_the_bound_and_the_optimum_is_on_it():
    config = load(EFFICIENCY, overrides={"data.simulation.frames": 50})
    config = replace(config, estimators={"eks": {"gate": False}, "batch": {}})
    excess = []
    for seed in range(1, 7):
        dataset = open_dataset(config.data, seed=seed, held_out=config.held_out)
        results = run_comparison(replace(config, seed=seed), dataset, Silent())
        found = evaluate(results.runs, results.record)
        keys = [f"bound_excess_{part}" for part in ("rotation", "position")]
        excess.append([[found.value(name, key, "smoothed") for key in keys] for name in config.estimators])
    mean, error = np.mean(excess, axis=0), np.std(excess, axis=0, ddof=1) / np.sqrt(len(excess))
    # Three standard errors of the mean, and 1 % for what is not linear.
    assert (mean > -3.0 * error - 1.0).all()
    assert (np.abs(mean[1]) < 5.0).all()
