"""The sentences at the top of a report: what is said, and of whom nothing is."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import made_record
from vislam.core.record import Tracks
from vislam.core.trajectory import Poses
from vislam.evaluation import evaluate
from vislam.evaluation.spread import Spread
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
    return verdict(named, evaluate(named, drive), drive.reference).sentences


def test_who_is_close_predicts_and_is_consistent_is_said(rng):
    good = scattered("good", rng)
    bad = scattered("bad", rng, sigma=8.0 * SIGMA)
    first, prediction, claims, *_ = said([bad, good], record(rng))
    assert first.startswith("Filtered: good is best, 0.0")
    assert "; bad is 0." in first
    assert " m worse (0." in first
    assert re.search(r"; overconfident \(sigmas too small\): bad [78]\.\d times\.$", first)
    assert "median error: good " in prediction
    assert "good is better than bad on" in prediction
    assert re.search(
        r"bad: overconfident, sigmas [78]\.\d times too small, 0 % within the 90 % region \(NEES ", claims
    )
    assert re.search(r"good: consistent, [89]\d % within the 90 % region \(NEES ", claims)


def test_the_summary_has_accuracy_covariance_and_cost_of_each(rng):
    runs = [scattered("bad", rng, sigma=8.0 * SIGMA), scattered("good", rng)]
    runs.append(scattered("alone", rng, sigma=4.0 * SIGMA, blind=True))
    named = {run.name: run for run in runs}
    drive = record(rng)
    table = verdict(named, evaluate(named, drive), drive.reference).summary
    good, bad, alone = (dict(zip(table.header, row, strict=True)) for row in table.rows)
    assert (good["estimator"], good["against the lowest [m]"]) == ("good", "lowest")
    assert bad["estimator"] == "bad"
    assert re.fullmatch(r"worse \(0\.\d\d to 0\.\d\d\)", bad["against the lowest [m]"])
    assert float(bad["ATE, SE(3) aligned [m]"]) > float(good["ATE, SE(3) aligned [m]"])
    assert (good["estimated sigmas"], bad["within the 90 % region"]) == ("consistent", "0 %")
    assert re.fullmatch(r"[78]\.\d times too small", bad["estimated sigmas"])
    assert alone["against the lowest [m]"] == "no camera"
    assert [row["total time [s]"] for row in (good, bad, alone)] == ["1.0"] * 3
    drive = replace(drive, reference=None)
    unreferenced = verdict(named, evaluate(named, drive), None).summary
    assert unreferenced.header[2] == "held-out tracks, median error [px]"
    assert "against the lowest [m]" not in unreferenced.header


def test_equal_runs_cannot_be_told_apart(rng):
    one = scattered("one", rng)
    found = said([one, replace(one, name="two")], record(rng))
    assert found[0].startswith("Filtered: one and two agree, 0.0")
    assert "neither is better" in found[0]
    assert "one and two cannot be told apart (p 1)" in found[1]


def test_too_little_is_claimed_as_well(rng):
    (claims,) = [
        text for text in said([scattered("shy", rng, claimed=5.0 * SIGMA)], record(rng)) if "NEES" in text
    ]
    assert re.search(r"shy: conservative, sigmas [45]\.\d times too large, 100 % within", claims)


@pytest.mark.parametrize("turned", [False, True])
def test_the_better_one_is_named_whatever_the_order(rng, turned):
    runs = [scattered("good", rng), scattered("bad", rng, sigma=8.0 * SIGMA)]
    found = said(runs[::-1] if turned else runs, record(rng))
    share = float(found[1].split("good is better than bad on ")[1].split(" %")[0])
    assert share > 70.0


def test_without_a_reference_the_data_alone_speak(rng):
    drive = replace(record(rng), reference=None)
    first, none, prediction, *_ = said(
        [scattered("one", rng), scattered("bad", rng, sigma=8.0 * SIGMA)], drive
    )
    assert first.startswith("Filtered: one predicts the held-out tracks best (")
    assert none == "There is no reference: what is said is from the data alone."
    assert prediction.startswith("Filtered: held-out tracks, median error: ")


def test_nothing_is_said_of_what_did_not_finish(rng):
    broken = scattered("broken", rng, error="frame 299: lost")
    found = said([broken], record(rng))
    assert found == ["Filtered: no estimator finished with a sound estimate."]


def mixed_pair(rng):
    """A filter, and a smoother that is worse than it at each frame and perfect in the end."""
    plain = scattered("plain", rng)
    late = scattered("late", rng, sigma=8.0 * SIGMA)
    return plain, replace(late, smoothed=Poses(circle(FRAMES), late.filtered.cov))


def test_a_filtered_and_a_smoothed_estimate_are_not_ranked(rng):
    pair, drive = mixed_pair(rng), record(rng)
    found = said(pair, drive)
    assert found[0].startswith("Filtered: plain is best, 0.0")
    assert found[1].startswith("Smoothed: late 0.00 m with none to compare it with")
    filtered = [text for text in found[1:] if text.startswith("Filtered: ")]
    smoothed = [text for text in found[1:] if text.startswith("Smoothed: ")]
    assert len(filtered) + len(smoothed) + 1 == len(found)
    assert any("plain is better than late on" in text for text in filtered)
    assert not any("plain" in text or "better" in text for text in smoothed)
    # Ranked as they end, the smoother would have been the closest, and is where it meets its like.
    other = replace(pair[1], name="other", smoothed=pair[0].filtered)
    told = said([*pair, other], drive)[1]
    assert told.startswith("Smoothed: late is best, 0.000 m; other is 0.088 m worse")


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
    first, second, *_ = said([alone, led, good], record(rng))
    assert first.startswith("Filtered: do not trust led: farther from truth than alone, which uses no camera")
    assert "and overconfident (led " in first
    assert second.startswith("Filtered: good is best")
    # One that says how far off it may be is ranked, not warned of.
    honest = scattered("led", rng, sigma=8.0 * SIGMA, claimed=8.0 * SIGMA)
    for runs in ([alone, honest, good], [alone, good], [led, good]):
        assert said(runs, record(rng))[0].startswith("Filtered: good ")


def test_unequal_information_is_said_before_who_is_closest(rng):
    named = {run.name: run for run in (scattered("one", rng), scattered("other", rng))}
    drive = record(rng)
    found = verdict(
        named, evaluate(named, drive), drive.reference, unequal="Information was not equal: x."
    ).sentences
    assert found[0].startswith("On unequal information, filtered: ")
    assert found[1] == "Information was not equal: x."


def correlated(name, rng, *, length, sigma=SIGMA, frames=FRAMES, **values):
    """A run whose errors stay for about ``length`` frames."""
    keep = np.exp(-1.0 / length)
    white = rng.normal(size=(frames + 10 * length, 6))
    error = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)[-frames:]
    cov = np.broadcast_to(np.diag(sigma**2), (frames, 6, 6))
    return made_run(name, se3.retract(circle(frames), sigma * error), cov=cov, **values)


def by_error(runs, frames):
    """Headline of runs without held-out tracks."""
    named = {run.name: run for run in runs}
    drive = made_record(of_truth(circle(frames)), frames=frames)
    return verdict(named, evaluate(named, drive), drive.reference).answer[0]


def test_a_real_difference_of_errors_that_stay_is_called_real(rng):
    one = correlated("one", rng, length=10, frames=2000)
    worse = correlated("other", rng, length=10, sigma=1.3 * SIGMA, frames=2000)
    found = by_error([worse, one], 2000)
    assert "one is best" in found
    assert "other is 0.0" in found
    assert "m worse (0.0" in found


def test_a_difference_of_a_few_stretches_is_not_told(rng):
    one = correlated("one", rng, length=300, frames=600)
    worse = correlated("other", rng, length=300, sigma=1.3 * SIGMA, frames=600)
    found = by_error([worse, one], 600)
    assert "not told apart on this path is" in found
    assert "worse" not in found
    assert "agree" not in found


def test_equal_information_is_said_where_runs_state_theirs(rng):
    stated = [replace(scattered(name, rng), information={"kernel": "none"}) for name in ("one", "two")]
    assert said(stated, record(rng))[0].startswith("On equal information, filtered: ")
    assert said([stated[0], scattered("two", rng)], record(rng))[0].startswith("Filtered: ")


def test_one_effective_sample_does_not_make_a_run_consistent(rng):
    truth = circle(FRAMES)
    # An offset that comes within the first frame, and stays.
    error = np.tile(SIGMA * np.array([0.5, -0.5, 1.0, -1.0, 0.7, 0.9]), (FRAMES, 1))
    error[0] = 0.0
    turn = np.zeros((FRAMES, 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = truth[:, :3, :3].transpose(0, 2, 1)
    staying = (turn @ error[:, :, None])[:, :, 0]
    cov = np.broadcast_to(np.diag(np.full(6, 1.0) * SIGMA**2), (FRAMES, 6, 6))
    one = made_run("one", se3.retract(truth, staying), cov=cov)
    (told,) = [text for text in said([one], record(rng)) if "NEES" in text]
    assert "one: cannot be told from one effective sample, " in told
    assert "consistent" not in told


def test_correlated_innovations_deny_independence(rng):
    keep = 0.9
    noise = np.abs(lfilter([1.0], [1.0, -keep], rng.normal(size=FRAMES))) + 0.1
    dof = np.full(FRAMES, 30, np.int64)
    one = scattered("one", rng, nis=30.0 * noise, dof=dof)
    white = scattered("white", rng, nis=rng.chisquare(30, FRAMES), dof=dof)
    (told,) = [text for text in said([one, white], record(rng)) if "innovations correlated" in text]
    assert "innovations correlated (lag-1 one 0." in told
    assert told.endswith("): covariances rest on independence that the data deny.")
    assert not any("innovations" in text for text in said([white], record(rng)))


def test_without_nis_and_reference_the_verdict_says_what_there_is(rng):
    """As under a robust kernel, where there is no NIS."""
    runs = [scattered("good", rng), scattered("bad", rng, sigma=8.0 * SIGMA)]
    count = len(runs[0].used)
    frame = np.linspace(0, FRAMES - 1, count).astype(int)
    fused = Tracks(frame, np.arange(count), np.zeros((count, 3)), np.ones((count, 3)))
    twist = np.tile([0.0, 0.0, 0.0, 7.0, 0.0, 0.0], (FRAMES, 1))
    drive = record(rng, reference=None, step_twist=twist, given=fused)
    found = said(runs, drive)
    assert found[0].startswith("Filtered: good predicts the held-out tracks best (")
    assert " px), bad (" in found[0]
    assert found[1] == "There is no reference: what is said is from the data alone."
    assert "Path length good " in found[2]
    assert found[2].endswith("209.3 m by the inertial data alone.")
    assert not any("NIS" in text or "consistent" in text for text in found)


def test_a_p_value_at_the_floor_is_a_bound(rng):
    found = said([scattered("good", rng), scattered("bad", rng, sigma=20.0 * SIGMA)], record(rng))
    assert any("p < 0.0002" in text for text in found) or any("p 0.00" in text for text in found)


def test_a_ranking_that_the_settings_reverse_is_none(rng):
    runs = {run.name: run for run in (scattered("good", rng), scattered("bad", rng, sigma=2.0 * SIGMA))}
    drive = record(rng)
    evaluation = evaluate(runs, drive)
    assert "bad is 0." in verdict(runs, evaluation, drive.reference).answer[0]
    values = {("good", "filtered"): (0.1, 0.3, 0.1), ("bad", "filtered"): (0.2, 0.25, None)}
    spread = Spread("ate_rmse", ("-", "a 1", "a 2"), values)
    told = verdict(runs, evaluation, drive.reference, spread=spread).sentences
    assert "not told apart on this path is bad" in told[0]
    assert (
        "Filtered: over 3 choices of held-out tracks and settings ATE, SE(3) aligned is good 0.10 to 0.30 m, "
        "bad 0.20 to 0.25 m; no ranking: good before bad (-0.05 to +0.10 m)."
    ) in told
    lasting = replace(spread, values={**values, ("good", "filtered"): (0.1, 0.2, 0.1)})
    assert "bad is 0." in verdict(runs, evaluation, drive.reference, spread=lasting).answer[0]
