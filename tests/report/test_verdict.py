"""The sentences at the top of a report: what is said, and of whom nothing is."""

from dataclasses import replace

import numpy as np
import pytest

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import altered, made_record
from vislam.core.record import Tracks
from vislam.core.trajectory import Poses
from vislam.evaluation import evaluate
from vislam.geometry import se3
from vislam.report.page_tables import pairs_table
from vislam.report.table import comparison_tables
from vislam.report.verdict import verdict

FRAMES = 300
SIGMA = np.array([0.002, 0.002, 0.002, 0.05, 0.05, 0.05])


def scattered(name, rng, *, sigma=SIGMA, claimed=SIGMA, **values):
    """A run whose poses scatter about the truth by sigma, and which claims something of it."""
    truth = circle(FRAMES)
    error = sigma * rng.normal(size=(FRAMES, 6))
    error[0] = 0.0
    cov = np.broadcast_to(np.diag(claimed**2), (FRAMES, 6, 6))
    pose = se3.retract(truth, error)
    # What made the first pose certain makes it no claim.
    return made_run(name, pose, cov=cov, **values)


def record(rng, **values):
    """A drive with held-out tracks of points ahead."""
    truth = circle(FRAMES)
    plain = made_record(of_truth(truth), frames=FRAMES)
    frame, track, z = [], [], []
    for index, first in enumerate(range(0, FRAMES - 8, 2)):
        views = np.arange(first, first + 8)
        cam_T_world = se3.inverse(truth[views] @ plain.rig.imu_T_cam)
        point = se3.transform(truth[first], np.array([[40.0, rng.uniform(-8, 8), 1.0]]))
        seen = plain.rig.project(se3.transform(cam_T_world, point)[:, 0])
        frame.append(views)
        track.append(np.full(8, index))
        z.append(seen + 0.2 * rng.normal(size=seen.shape))
    held = Tracks(np.concatenate(frame), np.concatenate(track), np.concatenate(z), np.ones((8 * len(z), 3)))
    order = np.argsort(held.frame, kind="stable")
    held = Tracks(*(getattr(held, key)[order] for key in ("frame", "track", "z", "sigma")))
    return replace(plain, held_out=held, **values)


def said(runs, drive):
    named = {run.name: run for run in runs}
    return verdict(named, evaluate(named, drive), drive.reference)


def test_who_is_close_predicts_and_is_consistent_is_said(rng):
    good = scattered("good", rng)
    bad = scattered("bad", rng, sigma=8.0 * SIGMA)
    accuracy, prediction, claims, *rest = said([bad, good], record(rng))
    assert accuracy.startswith("Filtered: closest to truth is good (ATE, SE(3) aligned: good 0.0")
    assert "median error: good " in prediction
    assert "good is better than bad on" in prediction
    assert "bad is overconfident (NEES of the pose per degree of freedom" in claims
    assert "good is consistent (NEES of the pose per degree of freedom" in claims
    assert rest[-1] == "Filtered: total time bad 1.0 s, good 1.0 s."


def test_equal_runs_cannot_be_told_apart(rng):
    one = scattered("one", rng)
    found = said([one, replace(one, name="two")], record(rng))
    assert "one and two cannot be told apart (p 1)" in found[1]
    assert not any("contradict" in sentence for sentence in found)


def test_too_little_is_claimed_as_well(rng):
    (claims,) = [
        text for text in said([scattered("shy", rng, claimed=5.0 * SIGMA)], record(rng)) if "NEES" in text
    ]
    assert "shy is conservative" in claims


def test_runs_that_part_are_named_with_the_surer_one(rng):
    sure = scattered("sure", rng, sigma=0.1 * SIGMA, claimed=0.1 * SIGMA)
    moved = sure.final.world_T_imu.copy()
    moved[60:, 0, 3] += 3.0
    vague = altered(scattered("vague", rng), world_T_imu=moved)
    (parting,) = [text for text in said([sure, vague], record(rng)) if "contradict" in text]
    assert parting.startswith("Filtered: sure and vague contradict each other from frame 60 on")
    assert "sure estimates 0.01 times the variance of vague" in parting


@pytest.mark.parametrize("turned", [False, True])
def test_the_better_one_is_named_whatever_the_order(rng, turned):
    runs = [scattered("good", rng), scattered("bad", rng, sigma=8.0 * SIGMA)]
    found = said(runs[::-1] if turned else runs, record(rng))
    share = float(found[1].split("good is better than bad on ")[1].split(" %")[0])
    assert share > 70.0


def test_without_a_reference_the_data_alone_speak(rng):
    drive = replace(record(rng), reference=None)
    accuracy, prediction, *_ = said([scattered("one", rng), scattered("bad", rng, sigma=8.0 * SIGMA)], drive)
    assert accuracy == "There is no reference: what follows is from the data alone."
    assert prediction.startswith("Filtered: held-out tracks, median error: ")


def test_nothing_is_said_of_what_did_not_finish(rng):
    broken = scattered("broken", rng, error="frame 299: lost")
    found = said([broken], record(rng))
    assert found == ["Filtered: no estimator finished with a sound estimate, so none can be called closest."]


def mixed_pair(rng):
    """A filter, and a smoother that is worse than it at each frame and perfect in the end."""
    plain = scattered("plain", rng)
    late = scattered("late", rng, sigma=8.0 * SIGMA)
    return plain, replace(late, smoothed=Poses(circle(FRAMES), late.filtered.cov))


def test_a_filtered_and_a_smoothed_estimate_are_not_ranked(rng):
    pair, drive = mixed_pair(rng), record(rng)
    found = said(pair, drive)
    filtered = [text for text in found if text.startswith("Filtered: ")]
    smoothed = [text for text in found if text.startswith("Smoothed: ")]
    assert len(filtered) + len(smoothed) == len(found)
    assert filtered[0].startswith("Filtered: closest to truth is plain (ATE, SE(3) aligned: plain 0.0")
    assert any("plain is better than late on" in text for text in filtered)
    assert (
        smoothed[0] == "Smoothed: late 0.00 m from truth (ATE, SE(3) aligned), with none to compare it with."
    )
    assert not any("plain" in text or "better" in text for text in smoothed)
    # Ranked as they end, the smoother would have been the closest, and is where it meets its like.
    other = replace(pair[1], name="other", smoothed=pair[0].filtered)
    last = [text for text in said([*pair, other], drive) if "closest" in text][-1]
    assert last.startswith("Smoothed: closest to truth is late (ATE, SE(3) aligned: late 0.00 m, other 0.0")


def test_a_run_without_smoothed_poses_is_in_one_block(rng):
    runs = {run.name: run for run in mixed_pair(rng)}
    evaluation = evaluate(runs, record(rng))
    tables = comparison_tables(runs, evaluation)
    assert [list(table.header) for table in tables.values()] == [["", "plain", "late"], ["", "late"]]
    cells = {estimate: {row[0]: row[1:] for row in table.rows} for estimate, table in tables.items()}
    assert cells["smoothed"]["ATE, SE(3) aligned [m]"] == ["0.00"]
    assert float(cells["filtered"]["ATE, SE(3) aligned [m]"][1]) > 0.3
    assert [row[:2] for row in pairs_table(evaluation).rows] == [["plain and late", "filtered"]]
    alone = comparison_tables({"plain": runs["plain"]}, evaluation)
    assert list(alone) == ["filtered"]


def test_who_is_worse_than_without_the_camera_and_sure_of_it_comes_first(rng):
    alone = scattered("alone", rng, sigma=4.0 * SIGMA, claimed=4.0 * SIGMA, blind=True)
    led = scattered("led", rng, sigma=8.0 * SIGMA)
    good = scattered("good", rng)
    first, *rest = said([alone, led, good], record(rng))
    assert first.startswith("Filtered: do not trust led: farther from truth than alone, which uses no camera")
    assert "and overconfident (led " in first
    assert rest[0].startswith("Filtered: closest to truth is good")
    # One that says how far off it may be is ranked, not warned of.
    honest = scattered("led", rng, sigma=8.0 * SIGMA, claimed=8.0 * SIGMA)
    for runs in ([alone, honest, good], [alone, good], [led, good]):
        assert said(runs, record(rng))[0].startswith("Filtered: closest to truth is good")


def test_unequal_information_is_said_before_who_is_closest(rng):
    named = {run.name: run for run in (scattered("one", rng), scattered("other", rng))}
    drive = record(rng)
    found = verdict(named, evaluate(named, drive), drive.reference, unequal="Information was not equal: x.")
    assert found[0] == "Information was not equal: x."
    assert found[1].startswith("Filtered: closest to truth is ")
