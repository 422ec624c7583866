"""Consider covariance and sandwich: against closed forms on a linear problem, whatever the estimator."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests import linear_filter
from tests.linear_filter import METRES_PER_PX, variance_of
from vislam.base.errors import ConfigError
from vislam.base.files import save_archive
from vislam.base.progress import Silent
from vislam.base.shipped import find_config
from vislam.comparison import config as configuration
from vislam.comparison.compare import prepare, run_comparison
from vislam.comparison.config import (
    ORDINARY,
    Config,
    ConsiderConfig,
    DataConfig,
    HeldOutConfig,
    NoiseConfig,
    SandwichConfig,
)
from vislam.comparison.considering import wanted
from vislam.comparison.open import open_dataset
from vislam.core.archive import _taken_apart
from vislam.core.moved_data import moved
from vislam.core.run import Run
from vislam.evaluation import evaluate
from vislam.evaluation.agreement import agreement
from vislam.inspection.finding import Inspection
from vislam.inspection.written import proposed_config
from vislam.models.odometry import ACROSS
from vislam.simulation import SimulationConfig

CONSIDER = ConsiderConfig(disparity_offset=0.4, velocity_direction=(0.01, 0.02))
PLUGINS = {
    "mine": {"estimator": "tests.linear_filter:build"},
    "smoother": {"estimator": "tests.linear_filter:build_smoother"},
}


def compared(config, dataset, estimators=PLUGINS, **values):
    config = replace(config, estimators=estimators, **values)
    return run_comparison(config, dataset, Silent())


@pytest.fixture(scope="module")
def results(short_config, short):
    return compared(short_config, short, consider=CONSIDER, sandwich=SandwichConfig(blocks=4))


def augmented(prepared, consider):
    """Covariances ``(T, 3, 3)`` of the position by the filter of position and parameters together.

    The covariance is that of Joseph's form with the gain of the filter that knows of no parameter, and none
    for the parameters: they are kept out of the update.
    """
    sequence, density = prepared.runner.sequence, prepared.problem.noise.twist[3:]
    joint = np.zeros((6, 6))
    joint[:3, :3] = 1e-4 * np.eye(3)
    joint[3:, 3:] = np.diag(np.square([consider.disparity_offset, *consider.velocity_direction]))
    alone, found = 1e-4 * np.eye(3), []
    by_state = np.array([1.0, 0.0, 0.0, METRES_PER_PX, 0.0, 0.0])
    for frame in sequence.frames(prepared.runner.sigma):
        step = np.eye(6)
        step[:3, 4:] = -frame.dt * frame.odometry.twist[3] * ACROSS[3:]
        noise = frame.dt * np.diag(density**2)
        joint, alone = step @ joint @ step.T, alone + noise
        joint[:3, :3] += noise
        if frame.k and len(frame.stereo):
            variance = variance_of(frame.stereo)
            gain = np.concatenate([alone[:, 0] / (alone[0, 0] + variance), np.zeros(3)])
            keep = np.eye(6) - np.outer(gain, by_state)
            joint = keep @ joint @ keep.T + variance * np.outer(gain, gain)
            alone = alone - np.outer(gain[:3], alone[0])
        found.append(joint[:3, :3])
    return np.array(found)


def test_it_is_the_augmented_filter_with_the_parameters_kept_out_of_the_update(short_config, short, results):
    expected = augmented(prepare(replace(short_config, estimators=PLUGINS), short, Silent()), CONSIDER)
    run = results.runs["mine"]
    assert run.considered.cause == ("disparity_offset", "velocity_direction_left", "velocity_direction_up")
    found = run.with_covariances("considered").filtered.cov[:, 3:, 3:]
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-14)
    assert np.abs(found - run.filtered.cov[:, 3:, 3:]).max() > 1e-5


def test_the_sandwich_is_that_of_the_scores_of_the_blocks(short_config, short, results):
    """By the weights of the blocks in the linear estimate, in closed form."""
    prepared = prepare(replace(short_config, estimators=PLUGINS), short, Silent())
    frames = list(prepared.runner.sequence.frames(prepared.runner.sigma))
    edges = np.linspace(0, len(frames), 5).round()
    block = np.searchsorted(edges, np.arange(len(frames)), side="right") - 1
    ends = [last_position(prepared, frames, np.ones(len(frames)))]
    ends += [last_position(prepared, frames, np.where(block == index, 0.8, 1.0)) for index in range(4)]
    expected = sum(np.square((ends[0] - other) / 0.2) for other in ends[1:])
    run = results.runs["mine"]
    assert len(run.sandwich.cause) == 4
    assert run.with_covariances("sandwich").filtered.cov[-1, 3, 3] == pytest.approx(expected, rel=1e-6)


def last_position(prepared, frames, weight):
    """Forward position at the end by information, with a weight of each frame's observations."""
    density, position, cov = prepared.problem.noise.twist[3], 0.0, 1e-4
    for frame, much in zip(frames, weight, strict=True):
        position += frame.dt * frame.odometry.twist[3]
        cov += frame.dt * density**2
        if frame.k and len(frame.stereo):
            measured = METRES_PER_PX * float(np.mean(frame.stereo.z[:, 0] - frame.stereo.z[:, 1]))
            information = much / variance_of(frame.stereo)
            cov = 1.0 / (1.0 / cov + information)
            position += cov * information * (measured - position)
    return position


def test_poses_from_all_data_have_changes_of_their_own(results):
    run = results.runs["smoother"]
    causal, final = run.considered.filtered, run.considered.smoothed
    assert np.allclose(final[:, 1:], causal[:, 1:] + 0.5 * np.diff(causal, axis=1), atol=1e-12)
    both = run.with_covariances("considered")
    assert not np.allclose(both.smoothed.cov, both.filtered.cov)
    assert results.runs["mine"].considered.smoothed is None


def test_varied_runs_are_given_what_the_run_had_and_gate_nothing(short_config, short):
    linear_filter.BUILT.clear()
    config = replace(short_config, common_set_from=("ekf",), gate_probability=0.9)
    config = replace(config, estimators={"mine": PLUGINS["mine"], "ekf": {}})
    done = run_comparison(replace(config, consider=ConsiderConfig(clock=0.01)), short, Silent())
    (_, own), (problem, varied) = (one for one in linear_filter.BUILT if one[1])
    assert problem.gate_probability == 1.0
    assert np.array_equal(np.concatenate(own), np.concatenate(varied))
    assert np.array_equal(np.concatenate(own), done.record.common_set.kept)
    assert not np.concatenate(own).all()


def test_what_a_run_rejected_itself_stays_out_and_nothing_more(short_config, short):
    config = replace(short_config, gate_probability=0.9, estimators={"ekf": {}})
    run = run_comparison(
        replace(config, consider=ConsiderConfig(disparity_offset=1e-9)), short, Silent()
    ).runs["ekf"]
    assert run.gated.any()
    # With next to no change of the parameter there is next to none of the poses.
    assert 0.0 < np.abs(run.considered.filtered).max() < 1e-6


def test_without_standard_deviations_nothing_is_run(short_config, short):
    linear_filter.BUILT.clear()
    done = compared(
        short_config, short, estimators={"mine": PLUGINS["mine"]}, consider=ConsiderConfig(clock=0.0)
    )
    assert not wanted(done.config)
    assert len(linear_filter.BUILT) == 1
    assert done.runs["mine"].beside == ()


def test_who_has_no_covariance_is_not_run_again(short_config, short):
    linear_filter.BUILT.clear()
    estimators = {"bare": {"estimator": "tests.linear_filter:build_bare"}}
    done = compared(short_config, short, estimators=estimators, consider=CONSIDER)
    assert len(linear_filter.BUILT) == 1
    assert done.runs["bare"].beside == ()


def test_a_parameter_is_estimated_or_considered_and_not_both(short_config, short):
    noise = replace(short_config.noise, clock_sigma=0.01)
    with pytest.raises(ConfigError, match=r"consider.clock: expected 0, as noise.clock_sigma = 0.01 has it"):
        compared(replace(short_config, noise=noise), short, consider=ConsiderConfig(clock=0.02))


def test_where_a_varied_run_fails_there_are_no_changes_and_it_says_so(short_config, short):
    estimators = {"mine": {"estimator": "tests.linear_filter:build_failing"}}
    consider = ConsiderConfig(velocity_direction=(0.9, 0.0))
    run = compared(short_config, short, estimators=estimators, consider=consider).runs["mine"]
    assert run.complete
    assert run.considered is None
    assert run.log.events[-1].startswith(
        "no considered covariances, as a run for them is incomplete: velocity_dir"
    )


def test_changes_are_saved_with_the_run(results, tmp_path):
    for name, run in results.runs.items():
        run.save(tmp_path / f"{name}.npz")
        again = Run.load(tmp_path / f"{name}.npz")
        for kind in ("considered", "sandwich"):
            one, other = getattr(run, kind), getattr(again, kind)
            assert one.cause == other.cause
            assert np.array_equal(one.filtered, other.filtered)
            assert (one.smoothed is None) == (other.smoothed is None)


def test_a_run_that_was_saved_before_there_was_any_of_it_can_be_read(results, tmp_path):
    arrays = {}
    plain = _taken_apart(replace(results.runs["mine"], considered=None, sandwich=None), arrays, at="")
    for name in ("considered", "sandwich", "lagged"):
        assert plain.pop(name) is None
    save_archive(tmp_path / "run.npz", plain, arrays)
    found = Run.load(tmp_path / "run.npz")
    assert found.beside == ()
    assert found.lagged is None
    assert np.array_equal(found.filtered.cov, results.runs["mine"].filtered.cov)


def test_scores_are_by_each_of_the_covariances(results):
    evaluation = evaluate(results.runs, results.record)
    own, wider = (evaluation.value("mine", f"nees_position{kind}") for kind in ("", "_considered"))
    assert wider < own
    for key in ("scale_gap_position", "coverage_90_position", "log_score_position"):
        assert evaluation.value("mine", f"{key}_considered") is not None
    assert evaluation.statistic("mine", "nees_position_considered").interval()[0] > 0.0


def test_what_acts_on_two_runs_alike_does_not_set_them_apart(results):
    one = results.runs["mine"]
    shifted = one.filtered.world_T_imu.copy()
    shifted[1:, 0, 3] += 0.1
    other = replace(one, name="other", filtered=replace(one.filtered, world_T_imu=shifted))
    own, found = agreement(one, other), agreement(one, other, considered=True)
    assert own.squared.min() > 0.0
    assert np.allclose(own.squared, found.squared, rtol=1e-9)
    unmoved = replace(other.considered, filtered=0.0 * other.considered.filtered)
    assert agreement(one, replace(other, considered=unmoved), considered=True).per_freedom < own.per_freedom
    assert agreement(one, replace(other, considered=None), considered=True) is None


@pytest.mark.slow
def test_processes_that_share_the_runs_come_to_the_same(short_config, short):
    config = replace(short_config, estimators=PLUGINS, consider=CONSIDER)
    alone, shared = (prepare(config, short, Silent()).run(processes).runs["mine"] for processes in (1, 2))
    assert np.array_equal(alone.considered.filtered, shared.considered.filtered)


@pytest.mark.statistical
def test_a_wrong_extrinsic_is_inside_the_interval_where_it_is_considered_and_outside_where_not():
    """Over drives whose camera is turned in the body by 3 mrad (one sigma) about each axis."""
    simulation = SimulationConfig(frames=100, tracks_in_view=25, pixel_sigma_px=0.3)
    root = np.sqrt(simulation.period)
    density = [simulation.gyro_sigma * root] * 3 + [simulation.velocity_sigma * root] * 3
    config = Config(
        name="turned",
        data=DataConfig(simulation=simulation),
        noise=NoiseConfig(pixel_sigma_px=0.3, twist_density=tuple(density)),
        held_out=HeldOutConfig(share=0.0),
        consider=ConsiderConfig(camera_rotation=0.003),
        estimators={"eks": {}},
    )
    rng, found = np.random.default_rng(7), []
    for seed in range(10):
        dataset = open_dataset(config.data, seed=seed)
        sequence = dataset.sequence
        for index, turn in enumerate(0.003 * rng.standard_normal(3)):
            sequence = moved(sequence, "camera_rotation", index=index, amount=turn)
        done = run_comparison(config, replace(dataset, sequence=sequence), Silent())
        evaluation = evaluate(done.runs, done.record)
        keys = [f"{key}_pose{kind}" for key in ("nees", "coverage_90") for kind in ("", "_considered")]
        found.append([evaluation.value("eks", key) for key in keys])
    nees, considered, coverage, covered = np.mean(found, axis=0)
    assert nees > 3.0
    assert coverage < 0.6
    # Ten drives with one draw of three numbers each: 30 degrees of freedom beside the noise.
    assert 0.5 < considered < 1.7
    assert 0.75 < covered <= 1.0


def test_one_setting_of_what_is_considered_is_shipped_and_written():
    for name in ("ds3_considered", "kitti07_considered"):
        assert configuration.load(find_config(name)).consider == ORDINARY
    for motion, absent in (("odometry", ""), ("imu", "velocity_direction")):
        tree = {"name": "a", "data": {"file": "a.npz"}, "motion": motion}
        text = proposed_config(tree, Inspection("a", (), {}), folders=[], written_to=Path("a.yaml"))
        line = next(line for line in text.splitlines() if "what all tracks may share" in line)
        section = yaml.safe_load(line.partition(": ")[2])
        assert set(asdict(ORDINARY)) - {name for name, value in asdict(ORDINARY).items() if not value} - {
            absent
        } == set(section)
        assert configuration.parse(Config, {**tree, "consider": section}).consider.tracker_bias == 0.05
