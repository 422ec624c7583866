"""Runs that are no answer to the data are marked and not ranked; sound ones are never marked."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import made_record
from vislam.core.observation_set import CommonSet
from vislam.core.record import Tracks
from vislam.core.trajectory import Poses
from vislam.evaluation import evaluate
from vislam.evaluation.degenerate import degeneracies
from vislam.geometry import se3
from vislam.report.table import comparison_tables
from vislam.report.verdict import verdict

OBSERVATIONS = 1000


def tracks(count=OBSERVATIONS, frames=400):
    frame = np.arange(count) * frames // max(count, 1)
    return Tracks(frame, np.arange(count), np.zeros((count, 3)), np.ones((count, 3)))


def record_of(pose, *, scale=1.0, **values):
    """Record whose inertial data are exactly those of a path, in metres times ``scale``."""
    twist = np.zeros((len(pose), 6))
    twist[1:] = se3.log(se3.inverse(pose[:-1]) @ pose[1:]) / 0.1
    twist[:, 3:] *= scale
    return made_record(
        of_truth(pose), frames=len(pose), step_twist=twist, given=tracks(frames=len(pose)), **values
    )


def run_of(pose, *, fused=OBSERVATIONS, **values):
    return made_run("a", pose, **{"used": np.arange(OBSERVATIONS) < fused, **values})


def scaled(pose, scale):
    out = pose.copy()
    out[:, :3, 3] *= scale
    return out


@pytest.mark.parametrize("scale", [0.001, 1.0, 1000.0], ids=["insect", "car", "plane"])
def test_a_sound_run_is_not_marked_whatever_its_scale(scale, rng):
    truth = circle()
    noisy = scaled(truth, scale) @ se3.exp(rng.normal(0.0, 1.0, (400, 6)) * [*[1e-3] * 3, *[0.1 * scale] * 3])
    assert degeneracies(run_of(noisy), record_of(truth, scale=scale)) == ()


def test_one_that_fused_nothing_is_dead_reckoning_under_another_name():
    truth = circle()
    record = record_of(truth)
    (told,) = degeneracies(run_of(truth, fused=0), record)
    assert told == "fused no observation: it is dead reckoning under another name"
    # Dead reckoning itself makes no other claim, and one that broke off is marked for that.
    assert degeneracies(run_of(truth, fused=0, blind=True), record) == ()
    assert degeneracies(run_of(truth, fused=0, error="frame 3: lost"), record) == ()
    # Where nothing was given there is nothing to fuse.
    empty = replace(record, given=tracks(0))
    assert degeneracies(replace(run_of(truth), used=np.zeros(0, bool)), empty) == ()


@pytest.mark.parametrize(("fused", "marked"), [(4, True), (49, True), (50, False), (400, False)])
def test_one_that_fused_next_to_nothing_is_marked(fused, marked):
    truth = circle()
    told = degeneracies(run_of(truth, fused=fused), record_of(truth))
    assert told == ((f"fused {fused} of 1000 observations only",) if marked else ())


def test_what_was_not_on_the_list_counts_for_nothing():
    truth = circle()
    listed = CommonSet(("a",), (), np.arange(OBSERVATIONS) < 40, "")
    assert degeneracies(run_of(truth, fused=40), record_of(truth, common_set=listed)) == ()
    assert degeneracies(run_of(truth, fused=1), record_of(truth, common_set=listed))
    exempt = replace(listed, exempt=("a",))
    assert degeneracies(run_of(truth, fused=40), record_of(truth, common_set=exempt))


@settings(max_examples=60, deadline=None)
@given(
    frame=st.integers(1, 399),
    steps=st.floats(0.0, 1e6),
    scale=st.sampled_from([0.01, 1.0, 100.0]),
)
def test_a_jump_is_marked_by_the_usual_step_and_not_in_metres(frame, steps, scale):
    truth = circle()
    step = float(np.linalg.norm(truth[1, :3, 3] - truth[0, :3, 3])) * scale
    jumped = scaled(truth, scale)
    jumped[frame:, 1, 3] += steps * step
    told = degeneracies(run_of(jumped), record_of(truth, scale=scale))
    if steps < 8.0:
        assert told == ()
    if steps > 13.0:
        assert told
        assert told[0].startswith("jumps: 1 steps beyond")
        assert f"at frame {frame}," in told[0]


def test_a_jump_that_the_covariance_before_it_allows_is_none():
    truth = circle()
    jumped = truth.copy()
    jumped[200:, 1, 3] += 100.0
    unsure = np.tile(np.diag([1e-6] * 3 + [900.0] * 3), (400, 1, 1))
    assert degeneracies(run_of(jumped), record_of(truth))
    assert degeneracies(run_of(jumped, cov=unsure), record_of(truth)) == ()
    assert degeneracies(run_of(jumped, cov=unsure / 100.0), record_of(truth))


def test_a_covariance_holds_until_the_next_one():
    truth = circle()
    jumped = truth.copy()
    jumped[205:, 1, 3] += 100.0
    unsure = np.full((400, 6, 6), np.nan)
    unsure[::10] = np.diag([1e-6] * 3 + [900.0] * 3)
    assert degeneracies(run_of(jumped, cov=unsure), record_of(truth)) == ()
    assert degeneracies(run_of(jumped, cov=unsure / 100.0), record_of(truth))
    # One that is told at the frame before is all that holds.
    unsure[204] = unsure[200] / 100.0
    assert degeneracies(run_of(jumped, cov=unsure), record_of(truth))


@pytest.mark.parametrize("blind", [40, 2])
def test_the_first_observations_after_a_stretch_without_may_correct_what_it_went(blind):
    truth = circle()
    step = float(np.linalg.norm(truth[1, :3, 3] - truth[0, :3, 3]))
    jumped = truth.copy()
    jumped[300:, 1, 3] += 30.0 * step
    run, record = run_of(jumped), record_of(truth)
    frame = record.given.frame
    unseen = replace(run, used=run.used & ((frame < 300 - blind) | (frame >= 300)))
    assert bool(degeneracies(run, record))
    assert bool(degeneracies(unseen, record)) == (blind == 2)
    # Who estimates how far off it can be is judged by that.
    sure = np.tile(1e-6 * np.eye(6), (400, 1, 1))
    assert degeneracies(replace(run_of(jumped, cov=sure), used=unseen.used), record)


def test_a_turn_on_the_spot_is_a_jump_too():
    truth = circle()
    turned = truth.copy()
    turned[200:, :3, :3] = turned[200:, :3, :3] @ se3.exp(np.array([0.0, 0.0, 1.0, 0, 0, 0]))[:3, :3]
    (told,) = degeneracies(run_of(turned), record_of(truth))
    assert told.startswith(
        "jumps: 1 turns beyond what the inertial data allow, the largest 1.02 rad at frame 200"
    )


def test_only_steps_between_neighbouring_frames_count():
    truth = circle()
    kept = np.r_[0:100, 300:400]
    some = run_of(truth[kept], frame=kept, stamp=0.1 * kept)
    assert degeneracies(some, record_of(truth)) == ()


@pytest.mark.parametrize("each", [1e3, 1e8])
def test_residuals_beyond_all_noise_are_marked(each):
    truth = circle()
    record = record_of(truth)
    (told,) = degeneracies(run_of(truth, fit=(1.01 * each * 50, 50)), record)
    assert told.startswith("does not fit its measurements: fit per degree of freedom 1")
    (told,) = degeneracies(
        run_of(truth, nis=np.full(400, 3.03 * each), dof=np.full(400, 3, np.int64)), record
    )
    assert told.startswith("does not predict its measurements: NIS per degree of freedom 1")
    # Noise that is stated ten times too small is a fault of its own, with a number of its own.
    assert degeneracies(run_of(truth, fit=(100.0 * 50, 50)), record) == ()
    assert degeneracies(run_of(truth, fit=(0.0, 0)), record) == ()


def test_what_is_degenerate_is_marked_in_the_table_and_not_ranked():
    truth = circle()
    record = record_of(truth)
    far = truth @ se3.exp(np.array([0, 0, 1e-3, 0.3, 0, 0]) * np.linspace(0, 1, 400)[:, None])
    runs = {"good": replace(run_of(far), name="good"), "blown": replace(run_of(truth, fused=3), name="blown")}
    evaluation = evaluate(runs, record)
    assert evaluation.value("blown", "ate_rmse") < evaluation.value("good", "ate_rmse")
    headline, second, *_ = verdict(runs, evaluation, record.reference).sentences
    assert headline == "Filtered: good 0.071 m with none to compare it with."
    assert second == "Filtered: degenerate and not ranked: blown (fused 3 of 1000 observations only)."
    assert comparison_tables(runs, evaluation)["filtered"].rows[0] == ["status", "complete", "DEGENERATE"]
    only = {"blown": runs["blown"]}
    (none,) = verdict(only, evaluate(only, record), record.reference).answer
    assert none.startswith("Filtered: no estimator")


def test_each_estimate_is_judged_by_its_own_poses():
    truth = circle()
    record = record_of(truth)
    jumping = truth.copy()
    jumping[200:, 0, 3] += 50.0
    run = replace(run_of(truth), filtered=Poses(jumping), smoothed=Poses(truth), fit=(1e6 * 50, 50))
    (jump,) = degeneracies(run, record, "filtered")
    assert jump.startswith("jumps: 1 steps")
    (fit,) = degeneracies(run, record, "smoothed")
    assert fit.startswith("does not fit its measurements")
    assert degeneracies(run, record) == (fit,)
