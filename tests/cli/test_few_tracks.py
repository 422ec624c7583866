"""Three tracks a frame, with slips and vehicles: what inspect writes is compared, and nobody is wrong
unsaid."""

import pytest
import yaml

from vislam.base.progress import Silent
from vislam.cli.inspect import main as inspect
from vislam.comparison import config as configuration
from vislam.comparison.compare import run_comparison
from vislam.comparison.open import open_dataset
from vislam.evaluation import evaluate
from vislam.report.verdict import verdict

SIMULATION = {
    "frames": 250,
    "tracks_in_view": 3.0,
    "loss_probability": 0.2,
    "outlier_probability": 0.02,
    "moving_share": 0.15,
    "pixel_sigma_px": 0.3,
    "drift_px": 0.1,
    "matching_bias_px": 0.3,
    "gyro_bias": [0.004, -0.003, 0.002],
    "navigation_frame_velocity": True,
    "clock_offset": 0.05,
}
NOTHING = {"duplicated_tracks": False, "disparity": False, "consensus": False}
RUNS = {"dead_reckoning": {}, "ekf": {}, "ekf_invariant": {}, "eks": {}, "isam2": {"marginals": "poses"}}
WORSE = 1.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_nobody_is_worse_than_without_a_camera_and_sure_of_it_unsaid(tmp_path, seed):
    written, proposed = tmp_path / "sparse.yaml", tmp_path / "proposed.yaml"
    data = {"simulation": SIMULATION, "repair": NOTHING}
    written.write_text(yaml.safe_dump({"name": "sparse", "seed": seed, "data": data, "estimators": RUNS}))
    out = str(tmp_path / "inspection")
    assert inspect(["--config", str(written), "--out", out, "--write-config", str(proposed)]) == 0
    config = configuration.load(proposed)
    # Three tracks a frame tell the bias of the gyro to a fraction of the prior that is the default.
    assert max(config.noise.bias_sigma[:3]) < 0.5 * 0.02
    assert config.data.repair.consensus is not None
    dataset = open_dataset(config.data, seed=seed)
    results = run_comparison(config, dataset, Silent())
    evaluation = evaluate(results.runs, results.record)
    told = verdict(results.runs, evaluation, dataset.reference).answer
    alone = evaluation.value("dead_reckoning", "ate_rmse", "filtered")
    for name, run in results.runs.items():
        for estimate in run.estimates:
            error = evaluation.value(name, "ate_rmse", estimate)
            nees = evaluation.statistic(name, "nees_pose", estimate)
            sure = nees is not None and nees.value > nees.interval(0.95)[1]
            if error > WORSE * alone and sure:
                first = next(
                    line for line in told if line.startswith(f"{estimate.capitalize()}: do not trust")
                )
                assert told.index(first) < len(run.estimates)
                assert name in first
    assert evaluation.value("eks", "ate_rmse", "smoothed") < WORSE * alone
    # Where it goes astray it ends a hundred times farther off.
    assert evaluation.value("isam2", "ate_rmse", "smoothed") < 2.0 * alone
