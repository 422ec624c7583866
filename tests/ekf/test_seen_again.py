"""Landmarks seen again: the filter has what the dense filter has, the smoother takes factors more."""

from dataclasses import replace

import numpy as np
import pytest

from tests.ekf.test_backward import FORMS, RELATIVE, both, check_equal, off, world
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import DataConfig, LandmarksConfig
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.repair.tracks import Interruptions

ALL = LandmarksConfig(kept="always")


def interrupted(dataset):
    """The drive with each other track out of view for some frames, its id the same behind them."""
    sequence = dataset.sequence
    frame, track = sequence.frame_of, sequence.track
    hidden = (track % 2 == 0) & (frame >= 6) & (frame < 11)
    return replace(dataset, sequence=sequence.select(~hidden))


def keeping(config, kept):
    return replace(config, data=replace(config.data, landmarks=kept))


@pytest.fixture(scope="module")
def gaps(short):
    return interrupted(short)


def come_back(sequence):
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    return int(np.sum((np.diff(track[order]) == 0) & (np.diff(frame[order]) > 1)))


@pytest.mark.parametrize("options", FORMS)
def test_the_backward_pass_equals_the_dense_filter(gaps, short_config, options):
    assert come_back(gaps.sequence) > 5
    smoothed, dense, working = both(gaps, keeping(short_config, ALL), **options)
    assert len(working.state.track) == len(smoothed.landmarks.track)
    check_equal(smoothed, dense)


def test_the_most_recent_are_kept_and_no_others(gaps, short_config):
    few = LandmarksConfig(kept="most 14")
    cut = Interruptions(kept=14).apply(gaps.sequence)
    assert 0 < come_back(cut) < come_back(gaps.sequence)
    assert cut.counts["seen_again"] == come_back(cut)
    smoothed, dense, working = both(replace(gaps, sequence=cut), keeping(short_config, few))
    assert len(working.state.track) == len(cut.track[cut.offset[-2] :]) + 14
    points, cov, _ = world(dense)
    assert off(smoothed.landmarks.points_world, points) < RELATIVE
    assert off(smoothed.landmarks.points_cov, cov) < RELATIVE


def test_without_it_an_id_never_comes_back(gaps):
    assert come_back(Interruptions().apply(gaps.sequence)) == 0
    assert come_back(Interruptions(kept=10**6).apply(gaps.sequence)) == come_back(gaps.sequence)


def test_a_track_does_not_drift_while_it_is_out_of_view(gaps, short):
    whole, age = short.sequence, gaps.sequence.age()
    assert np.array_equal(whole.age(), whole.frame_of - whole.frame_of[whole.first_rows()])
    again = np.isin(whole.row, gaps.sequence.row)
    away = whole.age()[again] - age
    # Out of view for five frames, which count as one; and tracks that began while they were hidden.
    frame, first = gaps.sequence.frame_of, gaps.sequence.frame_of[gaps.sequence.first_rows()]
    through = (gaps.sequence.track % 2 == 0) & (first < 6) & (frame >= 11)
    assert through.sum() > 5
    assert np.all(away[through] == 5)
    assert np.all(away[gaps.sequence.track % 2 == 1] == 0)


@pytest.mark.parametrize("name", ["isam2", "batch", "fixed_lag"])
def test_smoothers_take_what_is_seen_again_as_factors_more(gaps, short_config, name):
    config = keeping(short_config, ALL)
    problem = make_problem(config, gaps)
    sigma = pixel_sigma(config, gaps)
    options = {"lag_s": 0.4} if name == "fixed_lag" else {}
    found = run(find(name)(problem, options), gaps.sequence, sigma, name=name)
    assert found.complete, found.log.error
    assert len(np.unique(found.map.track)) == len(found.map.track)
    assert found.used.mean() > 0.97
    if name == "batch":
        eks = run(find("eks")(problem, {"gate": False}), gaps.sequence, sigma, name="eks")
        apart = np.linalg.norm(found.final.world_T_imu[:, :3, 3] - eks.final.world_T_imu[:, :3, 3], axis=1)
        spread = np.sqrt(np.trace(eks.final.cov[:, 3:, 3:], axis1=1, axis2=2))
        assert np.all(apart < 0.5 * spread + 1e-3)


def test_the_state_holds_what_is_out_of_view(gaps, short_config):
    problem = make_problem(keeping(short_config, ALL), gaps)
    working = find("ekf")(problem, {})
    for frame in gaps.sequence.first(9).frames(pixel_sigma(short_config, gaps)):
        working.process(frame)
    state = working.state
    assert len(state.cov) == state.layout.size + state.layout.landmark * len(state.track)
    assert np.any(state.seen_at == 5)


def test_the_config_says_what_is_kept():
    assert [LandmarksConfig(kept=kept).most for kept in ("while_tracked", "always", "most 7")] == [
        0,
        10**6,
        7,
    ]
    with pytest.raises(ValueError, match="pattern"):
        LandmarksConfig(kept="most 0")
    data = DataConfig(file="a.npz", landmarks=LandmarksConfig(kept="most 7"))
    assert data.repairs.interruptions == Interruptions(kept=7)
    assert data.repair.interruptions == Interruptions()


@pytest.mark.parametrize("kind", ["smoothed", "filtered"])
def test_a_landmark_that_was_forgotten_is_told_once(gaps, short_config, kind):
    """Repairs behind the one that renames ids can take observations, and with them who was seen last."""
    few = keeping(short_config, LandmarksConfig(kept="most 2"))
    assert come_back(gaps.sequence) > 5
    estimator = find("ekf_invariant")(
        make_problem(few, gaps), {"marginalised_landmarks": kind, "gate": False}
    )
    found = run(estimator, gaps.sequence, pixel_sigma(few, gaps), name="ekf")
    assert found.complete, found.log.error
    assert len(np.unique(found.map.track)) == len(found.map.track)
    assert set(found.map.track) == set(gaps.sequence.track)
