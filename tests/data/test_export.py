"""What is written for other tools is read back, by the readers of references, as it was."""

import numpy as np
import pytest

from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.datasets.export import write_kitti, write_npz, write_tum
from vislam.datasets.settings import ReferenceConfig
from vislam.datasets.trajectories import load_reference
from vislam.estimators.ekf import build
from vislam.estimators.loop import run
from vislam.geometry import se3


def read_back(path, form, stamp):
    config = ReferenceConfig(file=path.name, format=form, name="r", limits="l")
    return load_reference(path, config, imu_T_cam=np.eye(4), stamp=stamp)


@pytest.fixture
def drive(rng):
    """Stamps as in seconds since 1970, and poses of every attitude, far from the origin."""
    pose = se3.exp(np.column_stack([rng.uniform(-3, 3, (60, 3)), rng.uniform(-5e3, 5e3, (60, 3))]))
    return 1.3e9 + 0.1 * np.arange(60), pose


def test_tum_comes_back(tmp_path, drive):
    stamp, pose = drive
    write_tum(tmp_path / "a.tum", stamp, pose)
    reference = read_back(tmp_path / "a.tum", "tum", stamp)
    assert reference.frame.tolist() == list(range(60))
    assert np.allclose(reference.pose, pose, rtol=0, atol=5e-9)


def test_kitti_comes_back(tmp_path, drive):
    stamp, pose = drive
    write_kitti(tmp_path / "a.txt", pose)
    reference = read_back(tmp_path / "a.txt", "kitti", stamp)
    assert reference.frame.tolist() == list(range(60))
    assert np.allclose(reference.pose, pose, rtol=1e-9, atol=1e-9)


def test_npz_holds_what_its_docstring_says(tmp_path, short, short_config):
    solver = build(make_problem(short_config, short), {})
    done = run(solver, short.sequence, pixel_sigma(short_config, short), name="ekf")
    write_npz(tmp_path / "a.npz", done)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        read = dict(archive)
    wanted = {"stamp", "world_T_imu", "world_T_imu_filtered", "pose_cov", "pose_cov_filtered", "up"}
    assert set(read) == wanted | {"track", "points_world", "points_cov"}
    assert all(f"``{key}" in write_npz.__doc__ or f"``, ``{key}" in write_npz.__doc__ for key in read)
    for key, value in {
        "stamp": done.stamp,
        "world_T_imu": done.final.world_T_imu,
        "world_T_imu_filtered": done.filtered.world_T_imu,
        "pose_cov": done.final.cov,
        "pose_cov_filtered": done.filtered.cov,
        "up": done.up,
        "track": done.map.track,
        "points_world": done.map.points_world,
        "points_cov": done.map.points_cov,
    }.items():
        assert np.array_equal(read[key], value)
    assert read["pose_cov"].shape == (25, 6, 6)
    assert np.isfinite(read["pose_cov"]).all()
