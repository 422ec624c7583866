"""Landmarks from given poses: the textbook's joint filter, and least squares."""

import numpy as np
import pytest

from tests.baselines.given import save_run, true_map, true_poses
from tests.records import altered
from tests.smoother.drives import drive, exact
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.open import Dataset
from vislam.core.run import Run
from vislam.estimators import loop
from vislam.geometry import se3
from vislam.models.triangulation import triangulate
from vislam_baselines import dead_reckoning, mapping_only


def mapped(config, dataset, *, usable=None, **options):
    built = mapping_only.build(make_problem(config, dataset), options)
    sigma = pixel_sigma(config, dataset)
    return loop.run(built, dataset.sequence, sigma, name="mapping_only", usable=usable)


def project(calibration, cam_T_world, point):
    """Eq. (16) in four rows (uL, vL, uR, vR)."""
    q = cam_T_world @ np.append(point, 1.0)
    return calibration @ (q / q[2])


def calibration_of(rig):
    """The matrix K_s of a stereo pair."""
    rows = [[rig.fx, 0.0, rig.cx, 0.0], [0.0, rig.fy, rig.cy, 0.0]]
    return np.array([*rows, [rig.fx, 0.0, rig.cx, -rig.fx * rig.baseline], rows[1]])


def projection_derivative(q):
    """Eq. (17), its last row mended."""
    out = np.eye(4) / q[2]
    out[:, 2] = -q / q[2] ** 2
    out[2, 2] = 0.0
    return out


class JointFilter:
    """Eqs. (14) to (20), with all landmarks in one state and four rows an observation."""

    def __init__(self, rig, variance):
        self.rig, self.variance = rig, variance
        self.calibration = calibration_of(rig)
        self.place = {}
        self.mean, self.cov = np.empty(0), np.empty((0, 0))

    def process(self, pose, tracks, pixels):
        cam_T_world = np.linalg.inv(pose @ self.rig.imu_T_cam)
        known = [i for i, track in enumerate(tracks) if track in self.place]
        if known:
            self._update(cam_T_world, [tracks[i] for i in known], pixels[known])
        for i, track in enumerate(tracks):
            if track not in self.place:
                self._append(np.linalg.inv(cam_T_world), track, pixels[i])

    def _update(self, cam_T_world, tracks, pixels):
        H = np.zeros((4 * len(tracks), len(self.mean)))
        predicted = []
        for row, track in enumerate(tracks):
            at = slice(self.place[track], self.place[track] + 3)
            point = self.mean[at]
            q = cam_T_world @ np.append(point, 1.0)
            H[4 * row : 4 * row + 4, at] = self.calibration @ projection_derivative(q) @ cam_T_world[:, :3]
            predicted.append(project(self.calibration, cam_T_world, point))
        S = H @ self.cov @ H.T + self.variance * np.eye(len(H))
        K = self.cov @ H.T @ np.linalg.inv(S)
        self.mean = self.mean + K @ (pixels - predicted).ravel()
        self.cov = (np.eye(len(self.mean)) - K @ H) @ self.cov

    def _append(self, world_T_cam, track, pixels):
        rig = self.rig

        def point(pixel):
            depth = rig.fx * rig.baseline / (pixel[0] - pixel[2])
            row = 0.5 * (pixel[1] + pixel[3])
            ray = [(pixel[0] - rig.cx) / rig.fx, (row - rig.cy) / rig.fy, 1.0]
            return (world_T_cam @ np.append(depth * np.array(ray), 1.0))[:3]

        # A step along the imaginary axis: the derivative to the last digit.
        J = np.column_stack([point(pixels + 1e-20j * axis).imag / 1e-20 for axis in np.eye(4)])
        size = len(self.mean)
        self.place[track] = size
        self.mean = np.append(self.mean, point(pixels))
        cov = np.zeros((size + 3, size + 3))
        cov[:size, :size], cov[size:, size:] = self.cov, self.variance * J @ J.T
        self.cov = cov


def few_tracks(dataset: Dataset) -> np.ndarray:
    """Ids of the longest tracks."""
    return np.argsort(np.bincount(dataset.sequence.track))[-6:]


def test_it_is_the_joint_filter_of_the_report(tmp_path):
    config, dataset = drive(seed=2, pixel=0.5)
    sequence, poses = dataset.sequence, true_poses(dataset)
    run = mapped(config, dataset, poses=save_run(tmp_path / "true.npz", dataset), every=1)
    dense, chosen = JointFilter(sequence.rig, variance=3.0), few_tracks(dataset)
    for k in range(len(sequence)):
        rows = np.arange(sequence.offset[k], sequence.offset[k + 1])
        rows = rows[np.isin(sequence.track[rows], chosen)]
        dense.process(poses[k], sequence.track[rows].tolist(), sequence.pixels[rows])
    for track, at in dense.place.items():
        (own,) = np.flatnonzero(run.landmarks.track == track)
        assert run.landmarks.points_world[own] == pytest.approx(dense.mean[at : at + 3], abs=1e-9)
        assert run.landmarks.points_cov[own] == pytest.approx(dense.cov[at : at + 3, at : at + 3], abs=1e-9)


def test_with_little_noise_it_is_weighted_least_squares(tmp_path):
    # A thousandth of a pixel: what is not linear is smaller than that by as much again.
    config, dataset = drive(seed=3, pixel=1e-3)
    sequence, poses = dataset.sequence, true_poses(dataset)
    run = mapped(
        config,
        dataset,
        poses=save_run(tmp_path / "true.npz", dataset),
        every=1,
        pixel_variance=None,
    )
    for track in few_tracks(dataset):
        rows = np.flatnonzero(sequence.track == track)
        world_T_cam = poses[sequence.frame_of[rows]] @ sequence.rig.imu_T_cam
        sigma = pixel_sigma(config, dataset)[rows]
        best = triangulate(sequence.rig, world_T_cam[None], sequence.z[rows][None], sigma[None])
        point = se3.transform(world_T_cam[0], sequence.rig.back_project(best.mean))[0]
        by_z = world_T_cam[0, :3, :3] @ sequence.rig.back_projection_jacobian(best.mean)[0]
        cov = by_z @ best.cov[0] @ by_z.T
        (own,) = np.flatnonzero(run.landmarks.track == track)
        off = run.landmarks.points_world[own] - point
        assert np.sqrt(off @ np.linalg.solve(cov, off)) < 0.05
        assert run.landmarks.points_cov[own] == pytest.approx(cov, abs=0.01 * np.abs(cov).max())


def test_from_true_poses_and_exact_pixels_comes_the_true_map(tmp_path):
    config, dataset = exact(seed=4)
    run = mapped(config, dataset, poses=save_run(tmp_path / "true.npz", dataset), every=1)
    track, points = true_map(dataset)
    assert np.array_equal(run.landmarks.track, np.unique(dataset.sequence.track))
    assert run.landmarks.points_world == pytest.approx(
        points[np.searchsorted(track, run.landmarks.track)], abs=1e-6
    )
    assert np.array_equal(run.final.world_T_imu, true_poses(dataset))
    assert np.isnan(run.final.covariances).all()
    assert run.used.all()


def test_by_default_the_poses_are_those_of_dead_reckoning_and_one_track_in_twenty_is_mapped(
    short, short_config
):
    run = mapped(short_config, short)
    problem = make_problem(short_config, short)
    reckoned = dead_reckoning.build(problem, {"integration": "first"})
    sigma = pixel_sigma(short_config, short)
    alone = loop.run(reckoned, short.sequence, sigma, name="dead_reckoning")
    assert np.array_equal(run.final.world_T_imu, alone.final.world_T_imu)
    assert np.array_equal(run.final.covariances, alone.final.covariances)
    assert np.array_equal(run.used | run.gated, short.sequence.track % 20 == 0)
    assert np.array_equal(run.landmarks.track, np.unique(short.sequence.track[run.used]))


def test_a_landmark_outlives_observations_that_are_refused(short, short_config):
    refused = short.sequence.frame_of % 2 == 1
    run = mapped(short_config, short, every=1, usable=~refused)
    assert not run.used[refused].any()
    assert len(np.unique(run.landmarks.track)) == len(run.landmarks.track)
    # All but the first observation of each is an update.
    assert run.innovations.dof.sum() == 3 * (np.count_nonzero(run.used) - len(run.landmarks.track))


def test_poses_of_another_drive_are_refused(tmp_path, short, short_config):
    _, other = drive(seed=1, frames=40, period=0.2)
    run = mapped(short_config, short, poses=save_run(tmp_path / "other.npz", other))
    assert "estimators.mapping_only.poses" in run.log.error
    assert "has no pose of frame 1 at 0.105 s" in run.log.error


def test_what_holds_no_complete_run_is_refused_before_anything_runs(tmp_path, short, short_config):
    problem = make_problem(short_config, short)
    with pytest.raises(ConfigError, match=r"estimators\.mapping_only\.poses: nowhere\.npz"):
        mapping_only.build(problem, {"poses": "nowhere.npz"})
    path = tmp_path / "lost.npz"
    save_run(path, short)
    altered(Run.load(path), error="frame 3: lost").save(path)
    with pytest.raises(ConfigError, match=r"lost\.npz is incomplete: frame 3: lost"):
        mapping_only.build(problem, {"poses": str(path)})
