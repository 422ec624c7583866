"""What leaves a lag: our window agrees with GTSAM's fixed-lag smoother, and with itself, however seldom it
eliminates."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests import inertial
from tests.shared_errors import every_shared_error
from tests.smoother.drives import BUILD, dark, drive, gap, landmark_on_the_baseline, member
from tests.smoother.gtsam_lag import GtsamLag
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.loop import run
from vislam.estimators.smoother import engine, window
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.window import Window

SHORT = {"tracks_in_view": 12, "loss_probability": 0.2}
LAG = {"lag_s": 0.5, "relinearize_beyond": None}


def plain():
    return drive(seed=3, frames=60, **SHORT)


def long_tracks():
    """Landmarks that stay in view for longer than the lag, and are tied by marginals."""
    return drive(seed=4, frames=50, tracks_in_view=12)


def inertia():
    return inertial.drive(frames=45)


def vertical():
    settings = {"navigation_frame_velocity": True, "hills_m": 10.0, **SHORT}
    config, _ = drive(seed=8, frames=45, **settings)
    data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
    noise = replace(config.noise, vertical_velocity=VerticalVelocityConfig(walk=0.05, tilt_sigma=0.05))
    return replace(config, data=data, noise=noise), open_dataset(data, seed=8)


def shared():
    config, dataset = drive(seed=3, frames=45, **SHORT)
    return replace(config, noise=replace(config.noise, **every_shared_error(walk=0.1))), dataset


def gap_of_the_lag():
    """No tracks for longer than the lag."""
    config, dataset = plain()
    return config, replace(dataset, sequence=dark(25, 8)(dataset.sequence))


def rejecting():
    """Landmarks that become degenerate after a part of their factors has gone into marginals."""
    config, dataset = long_tracks()
    return config, replace(dataset, sequence=landmark_on_the_baseline(dataset.sequence))


CASES = {
    "plain": (plain, {}),
    "long tracks": (long_tracks, {}),
    "relinearised at each step": (plain, {"relinearize_every": 1, "window": 1}),
    "long tracks, relinearised": (long_tracks, {"relinearize_every": 5}),
    "raw inertia": (inertia, {"factorization": "qr"}),
    "vertical velocity": (vertical, {}),
    "shared errors": (shared, {"factorization": "qr"}),
    "a gap of more than the lag": (gap_of_the_lag, {}),
    "rejected landmarks": (rejecting, {}),
}


def lagged(config, dataset, options):
    solver = BUILD["fixed_lag"](make_problem(config, dataset), {**LAG, "pose_cov_every": 1, **options})
    return run(solver, dataset.sequence, pixel_sigma(config, dataset), name="fixed_lag")


def relative(cov, other):
    """Largest difference of covariances, in standard deviations of the second."""
    scale = np.sqrt(np.diagonal(other, axis1=1, axis2=2))
    return float(np.abs((cov - other) / (scale[:, :, None] * scale[:, None, :])).max())


def agree(ours, theirs):
    """Gaps of the poses and of the covariances, filtered and smoothed."""
    assert ours.complete, ours.log.error
    assert theirs.complete, theirs.log.error
    assert np.array_equal(ours.used, theirs.used)
    assert ours.log.counts == theirs.log.counts
    gaps = [
        *gap(ours.filtered.world_T_imu, theirs.filtered.world_T_imu),
        *gap(ours.smoothed.world_T_imu, theirs.smoothed.world_T_imu),
        np.abs(ours.map.points_world - theirs.map.points_world).max(),
    ]
    return max(gaps), relative(ours.filtered.covariances, theirs.filtered.covariances)


@pytest.mark.parametrize("case", CASES)
def test_estimates_and_covariances_are_those_of_gtsams_own_lag(case, monkeypatch):
    made, options = CASES[case]
    config, dataset = made()
    ours = lagged(config, dataset, options)
    monkeypatch.setattr(engine, "FixedLag", GtsamLag)
    theirs = lagged(config, dataset, options)
    apart, of_cov = agree(ours, theirs)
    assert apart < 1e-7
    assert of_cov < 1e-7


def test_what_is_relinearised_and_what_keeps_its_point_matters():
    """The cases with relinearisation differ from those without by far more than they may from GTSAM's."""
    for made in (plain, long_tracks):
        config, dataset = made()
        runs = [lagged(config, dataset, {"relinearize_every": every, "window": 1}) for every in (0, 1)]
        assert gap(*(run.filtered.world_T_imu for run in runs))[1] > 1e-3


def test_a_landmark_is_rejected_with_factors_in_a_marginal_and_some_in_what_has_left():
    config, dataset = rejecting()
    assert lagged(config, dataset, {}).log.counts["landmarks_rejected"] > 0


@pytest.mark.parametrize("every", [1, 7, 10**6])
def test_it_is_the_same_when_what_has_left_is_eliminated(every, monkeypatch):
    config, dataset = plain()
    usual = lagged(config, dataset, {"relinearize_every": 5})
    monkeypatch.setattr(window, "_EVERY", every)
    apart, of_cov = agree(lagged(config, dataset, {"relinearize_every": 5}), usual)
    assert apart < 1e-8
    assert of_cov < 1e-8


def test_to_read_the_factors_changes_nothing(monkeypatch):
    config, dataset = plain()
    usual = lagged(config, dataset, {"relinearize_every": 5})
    update = engine.FixedLag.update

    def read(self, *given, **named):
        slots = update(self, *given, **named)
        held = self.factors()
        assert list(held)[-len(slots) :] == slots
        keys = {key for factor in held.values() for key in list(factor.keys())}
        assert keys == set(self.estimate().keys())
        assert keys < set(self.linearization_point().keys())
        return slots

    monkeypatch.setattr(engine.FixedLag, "update", read)
    apart, of_cov = agree(lagged(config, dataset, {"relinearize_every": 5}), usual)
    assert apart < 1e-8
    assert of_cov < 1e-8


def test_a_window_holds_no_more_late_than_early(monkeypatch):
    config, dataset = drive(seed=2, frames=150, **SHORT)
    update, sizes = Window.update, []

    def counted(self, *given):
        numbers = update(self, *given)
        parts = (self.factors, self._slots, self._of, self.fixed)
        values, slots = self.tree.getLinearizationPoint(), self.tree.getFactorsUnsafe()
        sizes.append([*map(len, parts), values.size(), slots.size(), len(set(self._slots.values()))])
        return numbers

    monkeypatch.setattr(Window, "update", counted)
    assert member("fixed_lag", config, dataset, **LAG).complete
    early, late = np.max(sizes[30:70], axis=0), np.max(sizes[110:], axis=0)
    assert np.all(late <= 1.5 * early)
    # Each factor has a slot of its own.
    assert all(row[1] == row[-1] for row in sizes)


def test_what_has_left_is_no_variable_of_the_window():
    config, dataset = plain()
    solver = BUILD["fixed_lag"](make_problem(config, dataset), LAG)
    for frame in dataset.sequence.frames(pixel_sigma(config, dataset)):
        solver.process(frame)
        keys = set(solver._solver.engine.estimate().keys())
        held = solver._solver.held()
        assert {X(k) for k in range(frame.k + 1)} & keys == {X(k) for k in held}
        steps = [gtsam.symbolIndex(key) for key in keys if chr(gtsam.symbolChr(key)) == "w"]
        assert len(steps) == min(frame.k, len(held))
        assert all(k in held for k in steps)
