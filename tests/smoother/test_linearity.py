"""A linearisation that is off is mended at once: in a lag beside its marginals, and among few landmarks."""

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from tests import inertial
from tests.smoother.drives import RIG, ate, drive, gap, member
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.loop import run
from vislam.estimators.smoother import engine
from vislam.estimators.smoother.linearity import neglected
from vislam.estimators.smoother.tracks import Track, View
from vislam.estimators.smoother.tree import IndeterminateError
from vislam.geometry import se3

FAR = np.array([12.0, 3.0, 1.0])
ORIGIN = np.eye(4)


def seen(point, *, linearised, sigma=0.5):
    """Track of a landmark, observed without noise from the origin."""
    z = RIG.project(se3.transform(RIG.cam_T_imu, point[None]))[0]
    return Track(0, [View(0, z, np.full(3, sigma))], point=point, linearised=np.asarray(linearised))


def of(track, pose=ORIGIN):
    return neglected(RIG, [track], points=track.point[None], pose=pose, linearised=ORIGIN)[0][0]


def test_what_is_neglected_is_second_order_in_standard_deviations():
    eye = RIG.imu_T_cam[:3, 3]
    for share in (0.02, 0.1, 0.5):
        track = seen(eye + (FAR - eye) * (1.0 + share), linearised=FAR)
        # Along the ray the disparity d alone is not linear: it is d (1 - s + s^2 / (1 + s)) exactly.
        z = RIG.project(se3.transform(RIG.cam_T_imu, FAR[None]))[0]
        expected = (z[0] - z[1]) * share**2 / (1.0 + share) / 0.5
        assert of(track) == pytest.approx(expected, rel=1e-9)
    turned = se3.exp(np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0]))
    small = se3.exp(np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0]))
    still = seen(FAR, linearised=FAR)
    assert of(still) == pytest.approx(0.0, abs=1e-9)
    assert of(still, pose=turned) == pytest.approx(4.0 * of(still, pose=small), rel=0.1)


def test_a_point_behind_the_camera_and_no_point_at_all_neglect_nothing():
    assert of(replace(seen(FAR, linearised=FAR), point=-FAR)) == 0.0
    assert of(seen(FAR, linearised=-FAR)) == 0.0
    none = neglected(RIG, [], points=np.zeros((0, 3)), pose=ORIGIN, linearised=ORIGIN)
    assert [part.shape for part in none] == [(0,), (0,)]


@pytest.fixture(scope="module")
def loop():
    """Inertial data that predict so poorly that one linearisation is not enough; the filter's error."""
    kept = {"data.landmarks.kept": "while_tracked"}
    config = load(Path(__file__).parents[2] / "configs" / "loop.yaml", overrides=kept)
    dataset = open_dataset(config.data, seed=0)
    assert dataset.reference is not None
    reference = replace(dataset.reference, pose=dataset.reference.pose[:145])
    dataset = replace(dataset, sequence=dataset.sequence.first(145), reference=reference)
    gating = EkfEstimator(make_problem(config, dataset), EkfOptions(error="invariant", gate=False))
    found = run(gating, dataset.sequence, pixel_sigma(config, dataset), name="filter")
    return config, dataset, ate(found.filtered.world_T_imu, dataset)


@pytest.mark.parametrize(
    ("name", "options"), [("fixed_lag", {"lag_s": 2.0, "relinearize_beyond": 1.0}), ("isam2", {})]
)
def test_poor_inertial_data_carry_nobody_off(loop, name, options):
    config, dataset, limit = loop
    found = member(name, config, dataset, **options)
    assert 10 < found.log.counts["steps_relinearised_recent"] < 70
    assert found.log.counts["landmarks_rejected"] == 0
    assert ate(found.filtered.world_T_imu, dataset) < 1.3 * limit


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), [("fixed_lag", {"lag_s": 2.0}), ("isam2", {})])
def test_without_it_they_do(loop, name, options):
    config, dataset, limit = loop
    found = member(name, config, dataset, relinearize_beyond=None, **options)
    assert found.log.counts["steps_relinearised_recent"] == 0
    assert ate(found.filtered.world_T_imu, dataset) > 1.5 * limit


def test_a_lag_that_is_rebuilt_keeps_the_points_of_its_marginals(monkeypatch):
    """Its marginals were quadratics about nothing in the new solver, which relinearised what they tie."""
    config, dataset = drive(seed=0, frames=30, tracks_in_view=10.0, pixel=1.0, gyro=0.05, velocity=0.5)
    least = {"pose_threshold_rad": 1e-9, "pose_threshold_m": 1e-9, "landmark_threshold": 1e-9}
    options = {"lag_s": 1.0, "relinearize_every": 1, **least}
    plain = member("fixed_lag", config, dataset, **options)
    update, failed = engine.FixedLag.update, []

    def fails(self, graph, values, *, stamps, newest, **rest):
        slots = update(self, graph, values, stamps=stamps, newest=newest, **rest)
        if gtsam.symbolIndex(newest[0]) == 20 and not failed:
            failed.append(1)
            raise IndeterminateError("planted")
        return slots

    monkeypatch.setattr(engine.FixedLag, "update", fails)
    rebuilt = member("fixed_lag", config, dataset, **options)
    assert rebuilt.log.counts["cholesky_failures"] == 1
    turned, moved = gap(rebuilt.filtered.world_T_imu, plain.filtered.world_T_imu)
    assert turned < 0.005
    assert moved < 0.05


def of_phone(**options):
    """Filtered positions ``(T, 3)`` of ``isam2`` in a car with the sensor of a phone, and its counts."""
    settings = {"path": "town", "tracks": 40.0, "loss_probability": 0.0784}
    config, dataset = inertial.drive(seed=9, frames=31, pixel=0.5, imu=inertial.PHONE, period=0.2, **settings)
    dataset = replace(dataset, sequence=dataset.sequence.first(9))
    found = inertial.ran("isam2", config, dataset, **options)[1]
    return found.filtered.world_T_imu[:, :3, 3], found.log.counts


def apart(one, other):
    return float(np.sqrt(np.mean(np.sum((one - other) ** 2, axis=1))))


def test_landmarks_that_start_from_a_wrong_prediction_do_not_carry_the_path_away():
    """The first attitude is 0.6 degrees off there, and the first step takes a landmark from 145 m to 45 m."""
    exact, _ = of_phone(relinearize_every=1, window=1000, wildfire_threshold=0.0)
    found, counts = of_phone()
    before, _ = of_phone(relinearize_beyond=None)
    assert 0 < counts["steps_relinearised_recent"] < 5
    assert apart(found, exact) < 0.1 * apart(before, exact)
