"""The pose on a given map: it stays on the true path, which a wrong sign does not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.baselines.given import save_run, true_map, true_poses
from tests.smoother.drives import drive, exact, gap
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.step import TWIST_BIAS
from vislam.estimators import loop
from vislam.geometry import se3
from vislam_baselines import dead_reckoning, known_map

BIAS = np.array([0.01, -0.008, 0.012, 0.05, -0.03, 0.04])


def localised(config, dataset, *, usable=None, **options):
    built = known_map.build(make_problem(config, dataset), options)
    sigma = pixel_sigma(config, dataset)
    return loop.run(built, dataset.sequence, sigma, name="known_map", usable=usable)


def biased(dataset):
    """The same drive with a bias on its twist."""
    sequence = dataset.sequence
    return replace(dataset, sequence=replace(sequence, twist=sequence.twist + BIAS))


@pytest.fixture
def clean():
    return exact(seed=7)


@pytest.fixture
def true(clean, tmp_path):
    """File of the true map."""
    return save_run(tmp_path / "true.npz", clean[1])


def test_with_the_true_map_and_exact_data_it_stays_on_the_true_path(clean, true):
    config, dataset = clean
    run = localised(config, dataset, map=true)
    angle, distance = gap(run.final.world_T_imu, true_poses(dataset))
    assert angle < 1e-9
    assert distance < 1e-7
    assert run.used.all()
    assert run.innovations.nis.max() < 1e-9


def test_the_map_holds_the_pose_where_the_twist_is_wrong(clean, true):
    config, dataset = clean[0], biased(clean[1])
    reckoned = dead_reckoning.build(make_problem(config, dataset), {})
    sigma = pixel_sigma(config, dataset)
    drifted = loop.run(reckoned, dataset.sequence, sigma, name="dead_reckoning")
    lost = gap(drifted.final.world_T_imu, true_poses(dataset))
    held = gap(localised(config, dataset, map=true, gate=False).final.world_T_imu, true_poses(dataset))
    assert held[0] < 0.1 * lost[0]
    assert held[1] < 0.1 * lost[1]


def test_the_derivative_of_the_report_loses_the_pose(clean, true, monkeypatch):
    config, dataset = clean[0], biased(clean[1])
    right = gap(localised(config, dataset, map=true, gate=False).final.world_T_imu, true_poses(dataset))

    def look_as_printed(rig, pose, points, *, look=known_map.look):
        seen = look(rig, pose, points)
        return replace(seen, by_pose=-seen.by_pose)

    monkeypatch.setattr(known_map, "look", look_as_printed)
    printed = gap(localised(config, dataset, map=true, gate=False).final.world_T_imu, true_poses(dataset))
    assert printed[1] > 10.0 * right[1]


def test_a_bias_is_found_if_it_is_looked_for(clean, true):
    config, dataset = clean[0], biased(clean[1])
    run = localised(config, dataset, map=true, bias=True, pixel_variance=0.01)
    bias = run.states[TWIST_BIAS]
    assert np.abs(bias.value[-1] - BIAS).max() < 0.2 * np.abs(BIAS).min()
    assert np.abs(bias.value[-1] - BIAS).max() < 4.0 * bias.sigma[-1].max()
    fixed = localised(config, dataset, map=true)
    assert not fixed.states[TWIST_BIAS].value.any()
    assert np.isnan(fixed.states[TWIST_BIAS].sigma).all()


def test_one_update_is_the_textbook_s(true, clean, rng):
    """Eq. (14) with all matrices formed, from the pose that the first frame predicts."""
    config, dataset = clean
    problem, sequence = make_problem(config, dataset), dataset.sequence
    rows = slice(0, sequence.offset[1])
    frame = next(sequence.frames(pixel_sigma(config, dataset)))
    z = frame.stereo.z + rng.normal(size=frame.stereo.z.shape)
    built = known_map.build(problem, {"map": true, "gate": False})
    step = built.process(replace(frame, stereo=replace(frame.stereo, z=z)))
    track, points = true_map(dataset)
    points = points[np.searchsorted(track, sequence.track[rows])]

    def predict(xi):
        cam_T_world = se3.inverse(se3.exp(xi) @ problem.rig.imu_T_cam)
        return problem.rig.project(se3.transform(cam_T_world, points)).ravel()

    H = np.column_stack([(predict(h) - predict(-h)) / 2e-6 for h in 1e-6 * np.eye(6)])
    P, R = np.diag(problem.first_pose_sigma**2), np.diag(np.tile([5.0, 5.0, 2.5], len(z)))
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    innovation = z.ravel() - predict(np.zeros(6))
    assert step.pose == pytest.approx(se3.exp(K @ innovation), abs=1e-9)
    assert step.pose_cov == pytest.approx((np.eye(6) - K @ H) @ P, abs=1e-14)
    assert step.nis == pytest.approx(innovation @ np.linalg.solve(S, innovation), rel=1e-9)
    log_density = -0.5 * (step.nis + np.linalg.slogdet(2.0 * np.pi * S)[1])
    assert step.log_likelihood == pytest.approx(log_density, rel=1e-9)


def test_a_map_that_is_unsure_of_itself_counts_for_less(clean, tmp_path):
    config, dataset = clean
    track, _ = true_map(dataset)
    unsure = save_run(tmp_path / "unsure.npz", dataset, points_cov=np.tile(np.eye(3), (len(track), 1, 1)))
    with_it = localised(config, dataset, map=unsure)
    without = localised(config, dataset, map=unsure, map_uncertainty=False)
    assert np.all(with_it.final.covariances[-1].diagonal() > without.final.covariances[-1].diagonal())
    assert np.allclose(with_it.final.world_T_imu, without.final.world_T_imu, atol=1e-6)


def test_what_the_map_lacks_is_not_used_and_what_does_not_fit_is_gated(clean, tmp_path):
    config, dataset = clean
    track, points = true_map(dataset)
    seen = np.unique(dataset.sequence.track[: dataset.sequence.offset[1]])
    wrong = np.where(np.isin(track, seen[::5])[:, None], [0.0, 3.0, 0.0], 0.0)
    kept = track % 3 != 0
    path = save_run(tmp_path / "part.npz", dataset, track=track[kept], points=(points + wrong)[kept])
    run = localised(config, dataset, map=path)
    of_map = dataset.sequence.track % 3 != 0
    assert np.array_equal(run.used | run.gated, of_map)
    is_wrong = np.isin(dataset.sequence.track, seen[::5])
    assert run.gated[is_wrong & of_map].mean() > 0.8
    assert not run.gated[~is_wrong].any()


def test_what_others_refuse_is_not_used(tmp_path):
    config, dataset = drive(seed=8)
    refused = dataset.sequence.track % 2 == 0
    run = localised(config, dataset, map=save_run(tmp_path / "true.npz", dataset), usable=~refused)
    assert not (run.used | run.gated)[refused].any()
    assert run.used[~refused].mean() > 0.9


def test_without_a_map_there_is_nothing_to_build(short, short_config):
    with pytest.raises(ConfigError, match=r"estimators\.known_map\.map"):
        known_map.build(make_problem(short_config, short), {})


@pytest.mark.parametrize(
    ("shift", "says"),
    [(7, "is not where frame 0 sees its tracks"), (10**6, "has none of the tracks")],
)
def test_a_map_of_other_tracks_is_refused(clean, tmp_path, shift, says):
    config, dataset = clean
    track, _ = true_map(dataset)
    run = localised(config, dataset, map=save_run(tmp_path / "other.npz", dataset, track=track + shift))
    assert says in run.log.error
    assert "name a run of the same data with the same repairs" in run.log.error
