"""The smoother: where landmarks start, what it fuses and says it has, and its options."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.conftest import from_first
from tests.smoother.drives import BUILD, RIG, ate, drive, gap, member, smoother
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, KernelConfig, VerticalVelocityConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.loop import run
from vislam.estimators.smoother import engine
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.starting import Start, starts
from vislam.geometry import se3


@pytest.fixture(scope="module")
def simulated():
    return drive(seed=9, frames=40, tracks_in_view=25)


@pytest.fixture(scope="module")
def plain(simulated):
    """The run of isam2 with its defaults over it."""
    return member("isam2", *simulated)


def views_of(points, poses):
    return np.stack(
        [RIG.project(se3.transform(RIG.cam_T_imu @ se3.inverse(pose), points)) for pose in poses], axis=1
    )


def test_triangulation_finds_the_point_and_waits_for_the_far_one():
    points = np.array([[12.0, -1.0, -0.5], [400.0, -20.0, 3.0], [9.0, 2.0, 1.0]])
    poses = se3.exp(np.array([[0, 0, 0, 0.4 * k, 0, 0] for k in range(4)], dtype=float))
    z = views_of(points, poses)
    z[2, 3] += [40.0, 40.0, 0.0]
    found = starts(
        RIG,
        np.broadcast_to(poses, (3, 4, 4, 4)),
        z,
        np.full((3, 4, 3), 0.5),
        clear=5.0,
        judged=np.ones((3, 4), bool),
    )
    assert found.ready.tolist() == [True, False, False]
    assert np.allclose(found.points_world[0], points[0], atol=1e-6)


def test_triangulation_refuses_what_is_no_point():
    points, poses = np.array([[12.0, -1.0, -0.5]] * 4), np.array([np.eye(4)] * 3)
    z = views_of(points, poses)
    z[0, 0] = z[0, 0, [1, 0, 2]]
    z[1, 0, 1] = z[1, 0, 0] - 1e6
    far = np.broadcast_to(poses, (4, 3, 4, 4)).copy()
    far[2, 1:, :3, 3] = [1e9, 0.0, 0.0]
    found = starts(RIG, far, z, np.full((4, 3, 3), 0.5), clear=5.0, judged=np.ones((4, 3), bool))
    assert found.ready.tolist() == [False, False, False, True]
    assert np.allclose(found.points_world[3], points[3], atol=1e-6)


@pytest.mark.slow
def test_smoothing_beats_filtering_on_the_past():
    config, dataset = drive(seed=9, frames=120)
    smoothed = member("isam2", config, dataset)

    def error(poses):
        return np.sqrt(np.mean((poses - from_first(dataset.reference.pose))[:, :3, 3] ** 2))

    assert smoothed.complete
    assert error(smoothed.final.world_T_imu) < 0.05
    assert error(smoothed.final.world_T_imu) <= 1.2 * error(smoothed.filtered.world_T_imu)


@pytest.mark.parametrize("name", BUILD)
def test_refused_observations_are_not_fused(name, short: Dataset, short_config: Config):
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    refused = np.arange(short.sequence.observations) % 7 == 0
    for estimator in (EkfEstimator(problem, EkfOptions()), BUILD[name](problem, {})):
        result = run(estimator, short.sequence, sigma, name="any", usable=~refused)
        assert result.complete
        assert result.used.any()
        assert not np.any(result.used & refused)


@pytest.mark.parametrize("name", BUILD)
def test_fused_is_used_and_has_a_factor(name, simulated):
    config, dataset = simulated
    estimator = BUILD[name](make_problem(config, dataset), {})
    kept = []
    finalize = estimator.finalize
    estimator.finalize = lambda: kept.append(finalize()) or kept[0]
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name=name)
    assert np.array_equal(result.used, dataset.sequence.mask_of(*kept[0].fused))
    assert len(kept[0].fused[0]) == result.used.sum()
    assert set(dataset.sequence.track[result.used]) == set(result.landmarks.track)
    assert not result.gated.any()
    if name in ("isam2", "isam2_norelin", "batch"):
        held = estimator._solver.engine.factors().values()
        stereo = [factor for factor in held if isinstance(factor, gtsam.GenericStereoFactor3D)]
        # The factors of what has just degenerate are taken out with the next frame.
        assert len(stereo) == result.used.sum() + len(estimator._solver._remove)


def test_a_track_that_waited_is_fused_with_all_its_views(simulated, plain):
    config, dataset = simulated
    late = member("isam2", config, dataset, initialisation_snr=60.0)
    assert late.log.counts["observations_used_late"] > plain.log.counts["observations_used_late"]
    sequence = dataset.sequence
    for track in late.landmarks.track:
        of_track = sequence.track == track
        assert late.used[of_track].all()


@pytest.mark.parametrize("name", ["isam2_norelin", "isam2"])
def test_without_relinearisation_nothing_is_ever_relinearised(name, simulated, monkeypatch):
    first = gtsam.Values()
    update = engine.WholeGraph.update

    def noted(self, graph, values, **rest):
        first.insert(values)
        return update(self, graph, values, **rest)

    monkeypatch.setattr(engine.WholeGraph, "update", noted)
    config, dataset = simulated
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)

    def moved(**options):
        first.clear()
        estimator = BUILD[name](problem, options)
        assert run(estimator, dataset.sequence, sigma, name=name).complete
        now = estimator._solver.engine.linearization_point()
        poses = [
            np.array([values.atPose3(X(k)).matrix() for k in range(len(dataset.sequence))])
            for values in (first, now)
        ]
        return max(gap(*poses))

    small = {"pose_threshold_rad": 1e-6, "pose_threshold_m": 1e-6}
    assert moved(relinearize_every=0, relinearize_beyond=None, **small) < 1e-12
    assert moved(relinearize_every=1, **small) > 1e-4


def test_without_relinearisation_a_lag_is_not_relinearised_either(simulated):
    config, dataset = simulated
    small = {"pose_threshold_rad": 1e-6, "pose_threshold_m": 1e-6, "landmark_threshold": 1e-6}
    small |= {"relinearize_beyond": None}
    never = member("fixed_lag", config, dataset, relinearize_every=0, lag_s=1e3, **small)
    once = member("isam2_norelin", config, dataset, factorization="qr", wildfire_threshold=0.0)
    often = member("fixed_lag", config, dataset, relinearize_every=1, lag_s=1e3, **small)
    assert max(gap(never.filtered.world_T_imu, once.filtered.world_T_imu)) < 1e-2
    assert max(gap(never.filtered.world_T_imu, often.filtered.world_T_imu)) > 1e-3


REFUSED = [
    ("isam2", {"lag_s": 1.0, "final": "batch"}, "final: batch needs the whole sequence"),
    ("batch", {"lag_s": 1.0}, "final: batch needs the whole sequence"),
    ("batch_gnc", {"lag_s": 1.0}, "final: gnc needs the whole sequence"),
    ("isam2", {"factors": "smart"}, "factors: smart"),
    ("batch_gnc", {"factors": "smart"}, "factors: smart"),
    ("isam2", {"optimiser": "schur"}, "optimiser: schur is for final: batch or gnc, not relinearised"),
    ("batch_schur", {"factors": "smart"}, "optimiser: schur eliminates the landmarks itself"),
    ("isam2", {"robust_threshold": 2.0}, "isam2.robust_threshold: the robust kernel is one setting"),
    ("isam2", {"huber": 1.0}, "huber"),
    ("isam2", {"window": 0}, "window"),
    ("isam2", {"wildfire_threshold": -1.0}, "wildfire_threshold"),
    ("fixed_lag", {"lag_s": 0.0}, "lag_s"),
    ("isam2", {"robust": "student"}, "write kernel: {degrees_of_freedom: 4}"),
]


@pytest.mark.parametrize(("name", "options", "names"), REFUSED)
def test_options_without_a_meaning_are_refused_by_name(name, options, names, short, short_config):
    with pytest.raises(ConfigError) as refused:
        BUILD[name](make_problem(short_config, short), options)
    assert f"estimators.{name}" in str(refused.value)
    assert names in str(refused.value)


def test_the_kernel_changes_little_on_good_data(simulated, plain):
    config, dataset = simulated
    robust = member("isam2", replace(config, kernel=KernelConfig()), dataset)
    assert robust.complete
    assert robust.fit is None
    angle, distance = gap(plain.final.world_T_imu, robust.final.world_T_imu)
    assert angle < 0.01
    assert distance < 0.1


@pytest.mark.slow
def test_the_clock_is_found_from_a_drive_that_changes_its_speed():
    config, dataset = drive(seed=3, frames=120, clock_offset=0.04, gyro=1e-3, velocity=0.01)
    config = replace(config, noise=replace(config.noise, clock_sigma=0.05))
    estimator = smoother(make_problem(config, dataset))
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2")
    assert result.complete
    assert abs(estimator._motion._shared.values["clock"][0] - 0.04) < 0.01


@pytest.mark.slow
def test_the_vertical_velocity_holds_the_height():
    config, _ = drive(seed=8, frames=100, navigation_frame_velocity=True, hills_m=10.0, gyro=0.01)
    data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
    dataset = open_dataset(data, seed=8)
    climbing = replace(config, noise=replace(config.noise, vertical_velocity=VerticalVelocityConfig()))
    height = dataset.reference.pose[:, 2, 3] - dataset.reference.pose[0, 2, 3]
    # A lag keeps the tilt as it was linearised first, unless it relinearises. Without the vertical velocity:
    # 1.5 m.
    for name, options, limit in (
        ("isam2", {}, 0.1),
        ("batch", {}, 0.1),
        ("fixed_lag", {}, 0.3),
        ("fixed_lag", {"relinearize_every": 5}, 0.1),
    ):
        run = member(name, climbing, dataset, **options)
        assert run.complete
        off = np.abs(run.levelled().final.world_T_imu[:, 2, 3] - height).max()
        assert off < limit


def test_where_all_residuals_are_too_large_it_is_not_the_tracks_that_are_wrong():
    """A predicted pose that is off spoils all residuals alike; one track still stands out from them."""
    clear = np.ones(9, bool)
    worst = np.array([6.0, 7.0, 5.0, 6.5, 5.5, 7.5, 60.0, 6.0, 5.8])
    start = Start(np.zeros((9, 3)), np.ones(9), clear, worst)
    assert not start.ready.any()
    assert start.ready_alone.tolist() == [True] * 6 + [False, True, True]
    few = Start(np.zeros((5, 3)), np.ones(5), clear[:5], worst[:5])
    assert not few.ready_alone.any()
    one = Start(np.zeros((9, 3)), np.ones(9), clear, np.where(worst == 5.0, 3.0, worst))
    assert one.ready_alone.tolist() == one.ready.tolist() == [False, False, True] + [False] * 6
    assert not Start(np.zeros((9, 3)), np.ones(9), ~clear, worst).ready_alone.any()


def test_a_bias_of_many_pixels_does_not_starve_the_smoother():
    """A bias within its prior puts the predicted pose many pixels off: by residuals alone nothing starts."""
    config, dataset = drive(seed=6, pixel=0.15, gyro=0.01, gyro_bias=(0.06, -0.05, 0.06))
    config = replace(config, noise=replace(config.noise, bias_sigma=(0.06, 0.06, 0.06, 0.1, 0.05, 0.02)))
    estimator = BUILD["isam2"](make_problem(config, dataset), {})
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2")
    assert found.complete
    assert found.used.mean() > 0.6
    assert ate(found.final.world_T_imu, dataset) < 0.1


def test_a_track_in_view_may_be_unusable_for_longer_than_the_lag():
    """Its landmark has gone into a marginal by then; what comes after is another one."""
    config, dataset = drive(seed=5, frames=30, tracks_in_view=20)
    frame, track = dataset.sequence.frame_of, dataset.sequence.track
    long = np.isin(track, np.intersect1d(track[frame < 9], track[frame > 22]))
    assert long.any()
    hidden = long & (frame >= 12) & (frame < 20)
    estimator = BUILD["fixed_lag"](make_problem(config, dataset), {"lag_s": 0.4})
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="lag", usable=~hidden)
    assert found.complete, found.log.error
    assert np.array_equal(found.used[long], ~hidden[long])
