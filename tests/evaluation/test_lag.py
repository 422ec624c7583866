"""Poses as known at each lag: what is scored of them, and when half of the gain has come."""

from dataclasses import replace

import numpy as np
import pytest

from tests.records import made_record
from vislam.core.lagged import Lagged
from vislam.core.reference import truth_reference
from vislam.core.run import Cost, Innovations, Run
from vislam.core.trajectory import Poses
from vislam.evaluation.evaluate import evaluate
from vislam.evaluation.lag import LagScores, half_time
from vislam.geometry import se3

FRAMES = 120


@pytest.fixture
def scored(rng):
    """A run whose errors halve with each lag, and claims that fit them at lag 2 alone."""
    truth = se3.exp(
        np.column_stack([np.zeros((FRAMES, 3)), np.linspace(0.0, 60.0, FRAMES), np.zeros((FRAMES, 2))])
    )
    off = rng.standard_normal((FRAMES, 6)) * 0.1
    off[0] = 0.0
    poses = {lag: se3.retract(truth, off / (1 + lag)) for lag in (0, 2, FRAMES - 1)}
    cov = np.broadcast_to((0.1 / 3) ** 2 * np.eye(6), (FRAMES, 6, 6)).copy()
    cov[np.arange(FRAMES) % 10 > 0] = np.nan
    lagged = Lagged.of({lag: Poses(pose, cov) for lag, pose in poses.items()})
    run = Run(
        name="made",
        frames_expected=FRAMES,
        frame=np.arange(FRAMES),
        stamp=0.1 * np.arange(FRAMES),
        filtered=Poses(poses[0]),
        innovations=Innovations.unknown(FRAMES),
        used=np.zeros(0, bool),
        gated=np.zeros(0, bool),
        smoothed=Poses(poses[FRAMES - 1]),
        lagged=lagged,
        cost=Cost(np.full(FRAMES, 2e-3)),
    )
    record = made_record(truth_reference(truth, np.empty(0, np.int64), np.empty((0, 3))), frames=FRAMES)
    return run, evaluate({"made": run}, record)


def test_the_ends_are_the_filtered_and_the_smoothed_scores(scored):
    _, found = scored
    assert found.value("made", "ate_rmse_lag_0") == found.value("made", "ate_rmse", "filtered")
    assert found.value("made", "ate_rmse_lag_all") == found.value("made", "ate_rmse", "smoothed")
    assert found.value("made", "rpe_1s_rmse_lag_2") == pytest.approx(
        found.value("made", "rpe_1s_rmse", "filtered") / 3.0, rel=0.05
    )


def test_the_nees_is_of_the_frames_that_have_a_covariance(scored):
    _, found = scored
    lags = found.scores["made"].lags
    assert [lag.frames for lag in lags] == [0, 2, None]
    assert [lag.nees.samples for lag in lags] == [FRAMES // 10 - 1] * 3
    assert lags[0].nees.value / lags[1].nees.value == pytest.approx(9.0, rel=1e-6)


def test_the_document_has_lags_in_frames_and_in_seconds(scored):
    _, found = scored
    document = found.lag_records()["made"]
    assert document["step_time_mean_ms"] == pytest.approx(2.0)
    row = document["lags"][1]
    assert row["frames"] == 2
    assert row["seconds"] == pytest.approx(0.2)
    assert row["nees"]["low_95"] < row["nees"]["high_95"]
    assert document["lags"][2]["seconds"] is None


def test_a_run_without_lags_has_none(scored):
    run, found = scored
    assert not evaluate({"made": replace(run, lagged=None)}, made_record(frames=FRAMES)).lag_records()
    assert found.scores["made"].lags


def made(*errors: float) -> list[LagScores]:
    frames = (0, 1, 5, 10, None)
    return [
        LagScores(lag, None if lag is None else 0.1 * lag, {"ate_rmse": error}, None)
        for lag, error in zip(frames, errors, strict=True)
    ]


@pytest.mark.parametrize(
    ("errors", "seconds"),
    [
        ((4.0, 3.0, 2.0, 2.0, 2.0), 0.1),
        ((4.0, 4.0, 2.0, 2.0, 2.0), 0.3),
        ((4.0, 4.0, 4.0, 2.5, 1.0), 1.0),
        ((4.0, 4.0, 4.0, 4.0, 1.0), None),
    ],
)
def test_half_of_the_gain_comes_where_the_lines_say(errors, seconds):
    found = half_time(made(*errors), "ate_rmse")
    assert found.seconds == (None if seconds is None else pytest.approx(seconds))
    assert (found.longest, found.filtered, found.smoothed) == (1.0, errors[0], errors[-1])


@pytest.mark.parametrize("last", [3.99, 4.0, 5.0])
def test_of_nothing_there_is_no_half(last):
    assert half_time(made(4.0, 4.0, 4.0, 4.0, last), "ate_rmse") is None
    assert half_time(made(4.0, 4.0, 4.0, 4.0, 1.0), "held_out_median") is None
