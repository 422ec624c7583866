"""The normal equations of a drive: each step and each covariance against GTSAM's on the same graph."""

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import drive
from tests.smoother.ended import CASES, ended
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.smoother import SmootherOptions, motion
from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X, landmark
from vislam.estimators.smoother.layout import Variables, longest_eliminated
from vislam.estimators.smoother.observations import Observations
from vislam.estimators.smoother.tracks import Track, View
from vislam.estimators.smoother.tree import tree_by_qr
from vislam.estimators.smoother.values import only
from vislam.geometry import se3


@pytest.fixture(params=CASES)
def case(request):
    """A problem and an estimate of it."""
    return ended(request.param)


def test_a_step_is_gtsams_on_the_same_graph(case):
    held, values = case
    wanted = held.graph().linearize(values).optimize(gtsam.EliminateQR)
    states, points = held.system(values).step()
    variables = Variables.of(held.without_tracks(), values)
    scale = max(np.abs(states).max(), np.abs(points).max())
    for key, start, end in zip(variables.keys, variables.start, variables.start[1:], strict=False):
        assert np.allclose(states[start:end], wanted.at(key), rtol=0.0, atol=1e-7 * scale)
    found = np.array([wanted.at(track.key) for track in held.tracks])
    assert np.allclose(points, found, rtol=0.0, atol=1e-7 * scale)


def test_covariances_are_gtsams_and_so_are_those_with_the_first_pose(case):
    held, values = case
    solver = tree_by_qr(held.graph(), values)
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


def test_the_cost_is_that_of_the_graph_behind_a_camera_too(case):
    held, values = case
    cam = held.poses(values)[held.tracks[0].views[0].k] @ held.rig.imu_T_cam
    moved = gtsam.Values(values)
    moved.update(held.tracks[0].key, cam[:3, 3] - 5.0 * cam[:3, 2])
    objective = held.objective(values)
    for each in (values, moved):
        assert np.isclose(objective.cost(objective.estimate(each)), held.graph().error(each), rtol=1e-12)


def test_an_estimate_and_a_step_of_it_are_gtsams_values(case):
    held, values = case
    linear = held.graph().linearize(values)
    step = linear.optimize(gtsam.EliminateQR)
    variables, objective = Variables.of(held.without_tracks(), values), held.objective(values)
    states = np.concatenate([step.at(key) for key in variables.keys])
    points = np.array([step.at(track.key) for track in held.tracks])
    estimate = objective.estimate(values)
    assert objective.values(estimate).equals(only(values, held.graph().keyVector()), 0.0)
    wanted = only(values, held.graph().keyVector()).retract(step)
    assert objective.values(objective.moved(estimate, states, points)).equals(wanted, 1e-12)
    equations = objective.equations(estimate)
    fall = linear.error(values.zeroVectors()) - linear.error(step)
    assert np.isclose(equations.fall(states, points, 0.0), fall, rtol=1e-6)


def test_a_damped_step_is_that_of_the_damped_graph_and_what_it_takes_off_the_cost(case):
    held, values = case
    damping, objective = 3.0, held.objective(values)
    equations = objective.equations(objective.estimate(values))
    states, points = equations.factorised(damping).step()
    linear = held.graph().linearize(values)
    damped, zero = held.graph().linearize(values), values.zeroVectors()
    for key in held.graph().keyVector():
        size = zero.dim(key)
        one, unit = np.sqrt(damping) * np.eye(size), gtsam.noiseModel.Unit.Create(size)
        damped.push_back(gtsam.JacobianFactor(key, one, np.zeros(size), unit))
    wanted = damped.optimize(gtsam.EliminateQR)
    variables = Variables.of(held.without_tracks(), values)
    for key, start, end in zip(variables.keys, variables.start, variables.start[1:], strict=False):
        assert np.allclose(states[start:end], wanted.at(key), rtol=0.0, atol=1e-9)
    assert np.allclose(points, [wanted.at(track.key) for track in held.tracks], rtol=0.0, atol=1e-9)
    fall = linear.error(values.zeroVectors()) - linear.error(wanted)
    assert np.isclose(equations.fall(states, points, damping), fall, rtol=1e-9)


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


@pytest.mark.parametrize("name", ["short", "constant", "walking"])
def test_fronts_are_no_wider_the_longer_the_drive_is(name):
    widths = []
    for frames in (30, 80):
        held, values = ended(name, frames)
        widths.append(held.objective(values).width)
    assert widths[1] <= 1.2 * widths[0]


def true_problem(frames):
    """The problem of a drive of that many frames, linearised at the poses that it was simulated with."""
    config, dataset = drive(seed=5, frames=frames, tracks_in_view=5, loss_probability=0.3, depth_max=30.0)
    sequence, rig, values = dataset.sequence, dataset.sequence.rig, gtsam.Values()
    poses = se3.inverse(dataset.reference.pose[0]) @ dataset.reference.pose
    model = motion.make(make_problem(config, dataset), SmootherOptions())
    given, tracks = list(sequence.frames(pixel_sigma(config, dataset))), {}
    for frame in given:
        model.predict(frame, poses[max(frame.k - 1, 0)])
        model.insert(values, frame, poses[frame.k])
        stereo = frame.stereo
        for row in np.flatnonzero(stereo.usable).tolist():
            track = tracks.setdefault(int(stereo.track[row]), Track(int(stereo.track[row])))
            track.views.append(View(frame.k, stereo.z[row], stereo.sigma[row]))
    seen = [track for track in tracks.values() if len(track.views) > 1]
    for number, track in enumerate(seen):
        point = rig.back_project(track.views[0].z[None])
        track.key = landmark(number, float(point[0, 2]))
        values.insert(track.key, se3.transform(poses[track.views[0].k] @ rig.imu_T_cam, point)[0])
    return Drive(rig, model, StereoFactors(rig), given, seen), values


def test_covariances_hold_however_far_a_drive_goes_from_the_pose_that_fixes_it():
    held, values = true_problem(1200)
    found, tree = held.marginals(values).poses, tree_by_qr(held.graph(), values)
    for k in (1, 20, 600, 1199):
        wanted = tree.marginalCovariance(X(k))
        sigma = np.sqrt(np.diagonal(wanted))
        assert np.abs((found[k] - wanted) / np.outer(sigma, sigma)).max() < 1e-6
