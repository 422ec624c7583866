"""Steps that cannot be solved: what is rejected, what is told, and when the run ends."""

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import BUILD, ate, drive, gap, member
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.loop import run
from vislam.estimators.smoother import engine
from vislam.estimators.smoother.tree import IndeterminateError
from vislam.repair.tracks import Interruptions

FRAMES = 30
AT = 15
MEMBERS = ["isam2", "fixed_lag", "batch"]
KIND = {"isam2": engine.WholeGraph, "fixed_lag": engine.FixedLag, "batch": engine.WholeGraph}


@pytest.fixture(scope="module")
def simulated():
    return drive(seed=8, frames=FRAMES, tracks_in_view=25)


@pytest.fixture(scope="module")
def plain(simulated):
    """Function that gives the run of a member in which nothing fails, each run once."""
    return cache(lambda name, factorization: go(name, simulated, factorization=factorization)[0])


def frame_of(newest):
    return gtsam.symbolIndex(newest[0])


def landmarks(stamps):
    return [key for key in stamps if chr(gtsam.symbolChr(key)) not in "xwvhc"]


def plant(monkeypatch, name, times, *, at=AT, key=lambda stamps: None):
    """Let updates fail after GTSAM has taken them, ``times`` of them from frame ``at`` on."""
    failures = []
    update = KIND[name].update

    def fails(self, graph, values, *, stamps, newest, **rest):
        slots = update(self, graph, values, stamps=stamps, newest=newest, **rest)
        if frame_of(newest) >= at and len(failures) < times:
            failures.append(key(stamps))
            raise IndeterminateError("planted", failures[-1])
        return slots

    monkeypatch.setattr(KIND[name], "update", fails)
    return failures


def go(name, simulated, **options):
    config, dataset = simulated
    estimator = BUILD[name](make_problem(config, dataset), options)
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name=name)
    return result, estimator


def check_set_aside_is_not_used(result, estimator, sequence):
    """What is rejected has no observation in ``used``, and no factor that could be taken out."""
    fused = np.unique(sequence.track[result.used])
    assert np.array_equal(fused, np.unique(result.landmarks.track))
    held = estimator._solver.engine.factors()
    keys = {
        key
        for factor in held.values()
        if isinstance(factor, gtsam.GenericStereoFactor3D)
        for key in list(factor.keys())
        if chr(gtsam.symbolChr(key)) != "x"
    }
    assert keys <= {track.key for track in estimator._solver.tracks.landmarks}


@pytest.mark.parametrize("name", MEMBERS)
def test_a_step_that_fails_once_is_rescued_and_told(name, simulated, monkeypatch):
    plant(monkeypatch, name, 1)
    result, estimator = go(name, simulated, factorization="qr")
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert len(result.log.events) == 1
    assert result.log.events[0].startswith(f"frame {AT}: planted")
    assert len(result.final.world_T_imu) == FRAMES
    assert ate(result.final.world_T_imu, simulated[1]) < 0.2
    check_set_aside_is_not_used(result, estimator, simulated[1].sequence)


@pytest.mark.parametrize("name", MEMBERS)
def test_a_landmark_that_the_error_names_is_set_aside_alone(name, simulated, plain, monkeypatch):
    named = plant(monkeypatch, name, 1, key=lambda stamps: landmarks(stamps)[3])
    result, estimator = go(name, simulated, factorization="qr")
    monkeypatch.undo()
    without = plain(name, "qr")
    assert named != [None]
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert result.log.counts["landmarks_rejected"] == without.log.counts["landmarks_rejected"] + 1
    assert f"frame {AT}: planted; 1 landmarks rejected, as track " in result.log.events[0]
    gone = set(without.landmarks.track.tolist()) - set(result.landmarks.track.tolist())
    assert len(gone) == 1
    of_gone = np.isin(simulated[1].sequence.track, list(gone))
    assert np.array_equal(result.used, without.used & ~of_gone)
    with_it, plainly = (ate(run.final.world_T_imu, simulated[1]) for run in (result, without))
    assert with_it < 1.5 * plainly + 0.01
    check_set_aside_is_not_used(result, estimator, simulated[1].sequence)


@pytest.mark.parametrize("name", MEMBERS)
def test_landmarks_that_errors_name_one_after_the_other_are_all_set_aside(name, simulated, monkeypatch):
    index = iter(range(3))
    named = plant(monkeypatch, name, 3, key=lambda stamps: sorted(landmarks(stamps))[next(index)])
    result, estimator = go(name, simulated, factorization="qr")
    assert len(set(named)) == 3
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert "3 landmarks rejected" in result.log.events[0]
    check_set_aside_is_not_used(result, estimator, simulated[1].sequence)
    assert not {track.key for track in estimator._solver.tracks.landmarks} & set(named)


@pytest.mark.parametrize("name", MEMBERS)
def test_a_pose_that_is_not_finite_is_rescued(name, simulated, monkeypatch):
    """The update went well, so that its factors are noted: they are not noted twice."""
    read, failures = KIND[name].pose, []

    def fails(self, key):
        if key == gtsam.symbol("x", AT) and not failures:
            failures.append(key)
            return np.full((4, 4), np.nan)
        return read(self, key)

    monkeypatch.setattr(KIND[name], "pose", fails)
    result, estimator = go(name, simulated, factorization="qr")
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert result.log.events[0].startswith(f"frame {AT}: the pose is not finite")
    for track in estimator._solver.tracks.landmarks:
        assert len(set(track.slots)) == len(track.slots)
    check_set_aside_is_not_used(result, estimator, simulated[1].sequence)


def test_a_try_that_fails_when_it_is_read_leaves_the_next_one_its_factors(simulated, monkeypatch):
    read, failures = engine.WholeGraph.pose, []

    def fails(self, key):
        if key == gtsam.symbol("x", AT) and len(failures) < 2:
            failures.append(key)
            raise IndeterminateError("planted")
        return read(self, key)

    monkeypatch.setattr(engine.WholeGraph, "pose", fails)
    result, estimator = go("isam2", simulated, factorization="auto")
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert [event.partition(":")[0] for event in result.log.events] == [f"frame {AT}"]
    held = estimator._solver.engine.factors()
    for track in estimator._solver.tracks.landmarks:
        assert len(track.slots) == len(track.views)
        assert all(track.key in list(held[slot].keys()) for slot in track.slots)


def check_equal(result, other, *, within=1e-6):
    assert np.array_equal(result.used, other.used)
    assert max(gap(result.filtered.world_T_imu, other.filtered.world_T_imu)) < within
    assert max(gap(result.final.world_T_imu, other.final.world_T_imu)) < within


@pytest.mark.parametrize("name", MEMBERS)
def test_a_step_that_cholesky_refuses_is_solved_with_qr_and_is_no_rescue(name, simulated, plain, monkeypatch):
    plant(monkeypatch, name, 1)
    result, estimator = go(name, simulated)
    monkeypatch.undo()
    assert result.complete
    assert result.log.counts["recoveries"] == 0
    assert result.log.counts["cholesky_failures"] == 1
    assert result.log.counts["steps_by_qr"] == 1
    assert result.log.events == (f"frame {AT}: planted to Cholesky; QR for this step",)
    assert estimator._solver.factorization == "cholesky"
    check_equal(result, plain(name, "qr"))


@pytest.mark.parametrize("name", MEMBERS)
def test_what_cholesky_refuses_at_every_frame_is_built_anew_ever_more_seldom(
    name, simulated, plain, monkeypatch
):
    """From frame 5 on: refused at 5, in going back at 5, 6, 8, 12 and 20, and that of 36 never comes."""
    start, update, built = KIND[name].__init__, KIND[name].update, []

    def noted(self, options, parameters):
        start(self, options, parameters)
        self.factorization = parameters.getFactorization().lower()
        built.append(self.factorization)

    def fails(self, graph, values, *, newest, **rest):
        slots = update(self, graph, values, newest=newest, **rest)
        if self.factorization == "cholesky" and frame_of(newest) >= 5:
            raise IndeterminateError("planted")
        return slots

    monkeypatch.setattr(KIND[name], "__init__", noted)
    monkeypatch.setattr(KIND[name], "update", fails)
    result, estimator = go(name, simulated)
    monkeypatch.undo()
    assert result.complete
    assert built == ["cholesky", "qr", *["cholesky"] * 5]
    assert result.log.counts["recoveries"] == 0
    assert result.log.counts["cholesky_failures"] == 6
    assert result.log.counts["steps_by_qr"] == FRAMES - 5
    assert result.log.events == ("frame 5: planted to Cholesky; QR for this step",)
    assert estimator._solver.factorization == "qr"
    check_equal(result, plain(name, "qr"))


@pytest.mark.parametrize("name", MEMBERS)
def test_refusals_far_from_each_other_cost_one_step_with_qr_each(name, simulated, plain, monkeypatch):
    update, refused = KIND[name].update, []

    def fails(self, graph, values, *, newest, **rest):
        slots = update(self, graph, values, newest=newest, **rest)
        if frame_of(newest) in (8, 25) and frame_of(newest) not in refused:
            refused.append(frame_of(newest))
            raise IndeterminateError("planted")
        return slots

    monkeypatch.setattr(KIND[name], "update", fails)
    result, estimator = go(name, simulated)
    monkeypatch.undo()
    assert refused == [8, 25]
    assert result.log.counts["cholesky_failures"] == result.log.counts["steps_by_qr"] == 2
    assert estimator._solver.factorization == "cholesky"
    check_equal(result, plain(name, "qr"))


def without_tracks(*, sigma):
    """A drive without any track, of whose beginning next to nothing is known."""
    config, dataset = drive(seed=8, frames=20, tracks_in_view=20)
    nothing = np.zeros(dataset.sequence.observations, bool)
    dataset = replace(dataset, sequence=Interruptions().apply(dataset.sequence.select(nothing)))
    first = (0.01, 0.01, 0.01, sigma, sigma, sigma)
    return replace(config, noise=replace(config.noise, first_pose_sigma=first)), dataset


@pytest.mark.parametrize("name", ["isam2", "fixed_lag"])
def test_cholesky_is_not_refused_where_the_place_is_far_less_known_than_the_step(name, monkeypatch):
    """Known to 100 m, with steps of 5 mm; without the anchor it is rejected."""
    config, dataset = without_tracks(sigma=100.0)
    options = {"sigma": np.empty((0, 3)), **({"lag_s": 0.5} if name == "fixed_lag" else {})}
    result = member(name, config, dataset, **options)
    assert result.log.counts["cholesky_failures"] == 0
    check_equal(result, member(name, config, dataset, **options, factorization="qr"))
    start = KIND[name].__init__

    def without_anchor(self, options, factorization, **rest):
        start(self, options, factorization, **rest)
        self._anchored = False

    monkeypatch.setattr(KIND[name], "__init__", without_anchor)
    assert member(name, config, dataset, **options).log.counts["cholesky_failures"] > 1


def test_there_is_one_anchor_and_nobody_is_told_of_it(simulated):
    _, estimator = go("isam2", simulated)
    told = estimator._solver.engine
    held = told.factors()
    keys = {key for factor in held.values() for key in list(factor.keys())}
    assert not [key for key in keys if chr(gtsam.symbolChr(key)) == "a"]
    assert set(told.estimate().keys()) == keys
    inside = set(told.linearization_point().keys()) - keys
    assert inside == {gtsam.symbol("a", FRAMES - 1)}


@pytest.mark.parametrize("name", ["isam2", "batch"])
def test_cholesky_that_was_asked_for_is_kept(name, simulated, monkeypatch):
    plant(monkeypatch, name, 1)
    result, estimator = go(name, simulated, factorization="cholesky")
    assert result.complete
    assert result.log.counts["recoveries"] == 1
    assert estimator._solver.factorization == "cholesky"


@pytest.mark.parametrize("name", MEMBERS)
def test_more_rescues_than_allowed_end_the_run_and_the_frames_before_are_kept(name, simulated, monkeypatch):
    update = KIND[name].update
    failed = set()

    def fails_once_a_frame(self, graph, values, *, newest, **rest):
        slots = update(self, graph, values, newest=newest, **rest)
        if frame_of(newest) >= AT and frame_of(newest) not in failed:
            failed.add(frame_of(newest))
            raise IndeterminateError("planted")
        return slots

    monkeypatch.setattr(KIND[name], "update", fails_once_a_frame)
    result, _ = go(name, simulated, factorization="qr", max_recoveries=2)
    assert not result.complete
    assert result.log.error == f"frame {AT + 2}: DivergedError: planted; it would be recovery 3"
    assert len(result.final.world_T_imu) == AT + 2
    assert np.isfinite(result.final.world_T_imu).all()


@pytest.mark.parametrize("name", MEMBERS)
def test_a_step_that_never_can_be_solved_ends_the_run_and_keeps_the_rest(name, simulated, monkeypatch):
    plant(monkeypatch, name, 1000)
    result, _ = go(name, simulated)
    assert not result.complete
    assert result.log.error == f"frame {AT}: DivergedError: planted, also without any landmark in view"
    assert len(result.final.world_T_imu) == AT


@pytest.mark.parametrize("at", [AT, 25])
def test_whatever_gtsam_raises_in_the_lag_ends_the_run_with_the_frames_before_it(simulated, monkeypatch, at):
    update = engine.FixedLag.update

    def fails(self, graph, values, *, newest, **rest):
        if frame_of(newest) == at:
            raise ValueError("Asking to remove variables from the variable index that are not unused")
        return update(self, graph, values, newest=newest, **rest)

    monkeypatch.setattr(engine.FixedLag, "update", fails)
    result, _ = go("fixed_lag", simulated)
    assert not result.complete
    assert "variable index" in result.log.error
    assert len(result.final.world_T_imu) == at
    assert np.isfinite(result.final.world_T_imu).all()


def test_a_lag_goes_on_after_a_rescue_that_came_with_marginals(simulated, monkeypatch):
    """Rescued at frames 30 and 33 of 80, with a lag of 10 frames: what was rejected leaves with it."""
    config, dataset = drive(seed=8, frames=80, tracks_in_view=25)
    read, failures = engine.FixedLag.pose, []

    def fails(self, key):
        if key in (gtsam.symbol("x", 30), gtsam.symbol("x", 33)) and key not in failures:
            failures.append(key)
            raise IndeterminateError("planted")
        return read(self, key)

    monkeypatch.setattr(engine.FixedLag, "pose", fails)
    result, estimator = go("fixed_lag", (config, dataset), lag_s=1.0, factorization="qr")
    assert result.complete
    assert result.log.counts["recoveries"] == 2
    assert ate(result.final.world_T_imu, dataset) < 1.0
    held = {
        chr(gtsam.symbolChr(key)) + str(gtsam.symbolIndex(key))
        for key in list(estimator._solver.engine.estimate().keys())
    }
    assert not {f"x{k}" for k in range(69)} & held
    own = {track.key for track in estimator._solver.tracks.landmarks}
    points = {
        key
        for key in list(estimator._solver.engine.estimate().keys())
        if chr(gtsam.symbolChr(key)) not in "xwv"
    }
    assert points <= own
