"""The bound: against the inverse of the whole information matrix, and what estimators make of it."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.core.record import Tracks
from vislam.evaluation.bound import BiasPrior, TrueDrive, bound
from vislam.geometry import se3
from vislam.models import CAMERA_AXES, StereoRig
from vislam.models.odometry import MotionNoise

NOISE = MotionNoise(np.repeat([4e-3, 0.06], 3), np.repeat([1e-3, 5e-3], 3))
PRIOR = BiasPrior(np.zeros(6), np.array([0.02, 0.02, 0.02, 0.01, 0.05, 0.02]))
FRAMES, POINTS, DT = 5, 9, 0.1


@pytest.fixture
def drive(rng) -> TrueDrive:
    """Tracks that begin and end, one seen once, two of them lost for a while."""
    imu_T_cam = se3.from_rotation_translation(CAMERA_AXES, np.array([1.5, 0.0, 0.6]))
    rig = StereoRig(550.0, 550.0, 680.0, 240.0, 0.6, imu_T_cam)
    twist = np.array([0.02, -0.01, 0.2, 8.0, 0.1, 0.0])
    pose = [np.eye(4)]
    for _ in range(FRAMES - 1):
        pose.append(pose[-1] @ se3.exp(DT * twist))
    pose = np.array(pose)
    bias = np.cumsum(
        np.vstack([PRIOR.sigma, np.full((FRAMES - 1, 6), 3e-4)]) * rng.standard_normal((FRAMES, 6)), 0
    )
    step = (
        twist
        + np.vstack([bias[:1], bias[:-1]])
        + NOISE.twist / np.sqrt(DT) * rng.standard_normal((FRAMES, 6))
    )
    points = np.column_stack(
        [rng.uniform(10, 40, POINTS), rng.uniform(-8, 8, (POINTS, 1)), rng.uniform(-2, 4, POINTS)]
    )
    seen = [(k, j) for k in range(FRAMES) for j in range(POINTS) if j // 3 <= k < j // 3 + 4]
    seen = [(k, j) for k, j in seen if not (j in (2, 7) and k == j // 3 + 1) and not (j == 4 and k > 1)]
    frame, track = np.array(seen).T
    sigma = np.broadcast_to([0.5, 0.5, 0.4], (len(frame), 3))
    cam = np.concatenate(
        [se3.transform(rig.cam_T_imu @ se3.inverse(pose[k]), points[j, None]) for k, j in seen]
    )
    z = rig.project(cam) + sigma * rng.standard_normal((len(frame), 3))
    tracks = Tracks(frame, track, z, sigma)
    return TrueDrive(DT * np.arange(FRAMES), pose, bias, step, tracks, points[track], rig)


def residuals(drive: TrueDrive, x: np.ndarray, *, until: int) -> np.ndarray:
    """All residuals, in standard deviations, at an error of poses, biases and points, by plain formulas."""
    size = 12 * FRAMES
    poses = [drive.world_T_imu[k] @ se3.exp(x[6 * k : 6 * k + 6]) for k in range(FRAMES)]
    biases = drive.bias + x[6 * FRAMES : size].reshape(FRAMES, 6)
    shift = x[size:].reshape(POINTS, 3)
    found = [x[:6] / 1e-9, (PRIOR.mean - biases[0]) / PRIOR.sigma]
    for k in range(1, FRAMES):
        if k > until:
            # What is not measured yet has to be somewhere.
            found += [1e-3 * x[6 * k : 6 * k + 6], 1e-3 * (biases[k] - biases[k - 1])]
            continue
        xi = se3.local(poses[k - 1], poses[k])
        found.append((drive.step_twist[k] - xi / DT - biases[k - 1]) / (NOISE.twist / np.sqrt(DT)))
        found.append((biases[k - 1] - biases[k]) / (np.sqrt(DT) * NOISE.bias_walk))
    tracks = drive.tracks
    for row in np.flatnonzero(tracks.frame <= until):
        point = drive.point[row] + shift[tracks.track[row]]
        camera = drive.rig.cam_T_imu @ se3.inverse(poses[tracks.frame[row]])
        found.append(
            (tracks.z[row] - drive.rig.project(se3.transform(camera, point[None])[0])) / tracks.sigma[row]
        )
    return np.concatenate(found)


def whole(drive: TrueDrive, until: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariance and error of all variables by the data up to a frame, from numerical derivatives."""
    size = 12 * FRAMES + 3 * POINTS
    step = 1e-5 * np.eye(size)
    columns = [residuals(drive, d, until=until) - residuals(drive, -d, until=until) for d in step]
    jacobian = np.array(columns).T / 2e-5
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(jacobian / scale, rcond=1e-13)
    cov = (inverse @ inverse.T) / np.outer(scale, scale)
    return cov, -(inverse @ residuals(drive, np.zeros(size), until=until)) / scale


def test_it_is_the_inverse_of_the_whole_information(drive):
    found = bound(drive, NOISE, PRIOR)
    cov, error = whole(drive, FRAMES - 1)
    for k in range(1, FRAMES):
        own = slice(6 * k, 6 * k + 6)
        assert np.allclose(found.smoothed[k], cov[own, own], rtol=1e-5, atol=1e-12), k
        assert np.allclose(found.smoothed_error[k], error[own], rtol=1e-4, atol=1e-8), k


@pytest.mark.parametrize("k", [1, 3])
def test_cut_at_a_frame_it_is_that_of_filtering(drive, k):
    found = bound(drive, NOISE, PRIOR)
    cov, error = whole(drive, k)
    own = slice(6 * k, 6 * k + 6)
    assert np.allclose(found.filtered[k], cov[own, own], rtol=1e-5, atol=1e-12)
    assert np.allclose(found.filtered_error[k], error[own], rtol=1e-4, atol=1e-8)


def test_later_data_lower_it_and_the_last_frame_has_none(drive):
    found = bound(drive, NOISE, PRIOR)
    assert np.allclose(found.filtered[-1], found.smoothed[-1], rtol=1e-9)
    gained = found.filtered[1:] - found.smoothed[1:]
    assert (np.linalg.eigvalsh(gained)[:, 0] > -1e-12).all()
    assert np.trace(gained[1]) > 0.01 * np.trace(found.filtered[2])


def test_less_data_raise_it(drive):
    fewer = drive.tracks.track % 2 == 0
    tracks = Tracks(*(getattr(drive.tracks, name)[fewer] for name in ("frame", "track", "z", "sigma")))
    found = bound(replace(drive, tracks=tracks, point=drive.point[fewer]), NOISE, PRIOR)
    more = bound(drive, NOISE, PRIOR)
    assert (
        np.trace(found.smoothed[1:], axis1=1, axis2=2) > np.trace(more.smoothed[1:], axis1=1, axis2=2)
    ).all()
