"""The normal equations of a drive: each step and each covariance against GTSAM's on the same graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import BUILD, drive
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import KernelConfig, VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.loop import run
from vislam.estimators.smoother import batch
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.observations import Observations
from vislam.estimators.smoother.system import Marginals, Others, longest_eliminated

SMOOTH = (0.09, 0.09, 0.05, 0.3, 0.2, 0.2)
CASES = {
    "short": {"loss_probability": 0.4},
    "long": {"loss_probability": 0.0, "depth_min": 20.0, "speed": 2.0},
    "all_that_is_estimated": {"navigation_frame_velocity": True, "hills_m": 10.0},
    "kernel": {"outlier_probability": 0.05},
}
MORE = {
    "vertical_velocity": VerticalVelocityConfig(walk=0.02),
    "acceleration_density": SMOOTH,
    "velocity_direction_sigma": 0.02,
}


@pytest.fixture(params=CASES)
def case(request, monkeypatch):
    """A drive, and an estimate of it that is not relinearised in the end."""
    name, kept = request.param, []
    config, dataset = drive(seed=5, frames=22, tracks_in_view=15, **CASES[name])
    if name == "all_that_is_estimated":
        data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
        config = replace(config, data=data, noise=replace(config.noise, **MORE))
        dataset = open_dataset(data, seed=5)
    if name == "kernel":
        config = replace(config, kernel=KernelConfig())
    monkeypatch.setattr(
        batch.Drive,
        "marginals",
        lambda self, values, shared, *, landmarks: kept.append((self, values)) or none(self),
    )
    estimator = BUILD["isam2"](make_problem(config, dataset), {"marginals": "all", "final": "as_is"})
    assert run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2").complete
    monkeypatch.undo()
    return kept[0]


def none(held):
    frames, tracks = len(held.frames), len(held.tracks)
    sizes = ((frames, 6, 6), (tracks, 3, 3), (frames, 6, 6), (tracks, 3, 6), (6, 6, 6))
    found = Marginals(*(np.broadcast_to(np.eye(*size[1:]), size) for size in sizes))
    return replace(found, shared=np.eye(6))


def test_a_step_is_gtsams_on_the_same_graph(case):
    held, values = case
    wanted = held.graph().linearize(values).optimize()
    states, points = held.system(values).step()
    others = Others.of(held.without_tracks(), values)
    scale = max(np.abs(states).max(), np.abs(points).max())
    for key, start, end in zip(others.keys, others.start, others.start[1:], strict=False):
        assert np.allclose(states[start:end], wanted.at(key), rtol=0.0, atol=1e-7 * scale)
    found = np.array([wanted.at(track.key) for track in held.tracks])
    assert np.allclose(points, found, rtol=0.0, atol=1e-7 * scale)


def test_covariances_are_gtsams_and_so_are_those_with_the_first_pose(case):
    held, values = case
    solver = gtsam.Marginals(held.graph(), values)
    found = held.marginals(values, [X(0)])
    first = np.sqrt(np.diagonal(solver.marginalCovariance(X(0))))
    poses, tracks = [X(k) for k in range(len(held.frames))], [track.key for track in held.tracks]
    for keys, own, mixed in (
        (poses, found.poses, found.poses_shared),
        (tracks, found.points, found.points_shared),
    ):
        assert len(own) == len(keys)
        for index, key in enumerate(keys):
            wanted = solver.marginalCovariance(key)
            sigma = np.sqrt(np.diagonal(wanted))
            assert np.allclose(
                own[index] / np.outer(sigma, sigma), wanted / np.outer(sigma, sigma), atol=1e-7
            )
            if key != X(0):
                cross = solver.jointMarginalCovariance([X(0), key]).at(key, X(0))
                scale = np.outer(sigma, first)
                assert np.allclose(mixed[index] / scale, cross / scale, atol=1e-7)


def test_squares_and_freedom_are_those_of_the_graph(case):
    held, values = case
    if held.stereo.kernel is not None:
        pytest.skip("with a kernel nobody asks for the fit")
    graph = held.graph()
    rows = sum(graph.at(index).dim() for index in range(graph.size()))
    squares, freedom = held.fit(values)
    assert np.isclose(squares, 2.0 * graph.error(values), rtol=1e-12)
    assert freedom == rows - values.dim()


def test_a_point_behind_the_camera_has_gtsams_residual_and_no_jacobian(case):
    held, values = case
    track, moved = held.tracks[0], gtsam.Values(values)
    view = track.views[0]
    cam = held.poses(values)[view.k] @ held.rig.imu_T_cam
    moved.update(track.key, cam[:3, 3] - 5.0 * cam[:3, 2])
    [factor] = held.stereo.stereo(view.k, track.key, z=view.z, sigma=view.sigma)
    linear = factor.linearize(moved)
    points = np.array([moved.atPoint3(other.key) for other in held.tracks])
    seen = Observations.of(held.tracks)
    found = seen.linearise(held.rig, held.poses(moved), points, kernel=held.stereo.kernel)
    row = int(np.flatnonzero((seen.landmark == 0) & (seen.frame == view.k))[0])
    assert np.allclose(found.residual[row], -linear.jacobian()[1], rtol=1e-12)
    assert not found.by_pose[row].any()
    assert not found.by_point[row].any()


def test_a_landmark_that_nothing_determines_is_refused(case):
    held, values = case
    moved = gtsam.Values(values)
    cam = held.poses(values)[0] @ held.rig.imu_T_cam
    for track in held.tracks:
        moved.update(track.key, cam[:3, 3] - 500.0 * cam[:3, 2])
    with pytest.raises(np.linalg.LinAlgError):
        held.system(moved)


@pytest.mark.parametrize(("span", "wanted"), [(3, 3), (200, 1)])
def test_landmarks_of_short_tracks_are_eliminated_first_and_those_of_long_ones_stay(span, wanted):
    first = np.repeat(np.arange(200 - span + 1), 5) if span < 200 else np.zeros(60, int)
    limit = longest_eliminated(first, first + span - 1, 200)
    assert (limit >= span) == (wanted > 1)
