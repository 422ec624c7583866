"""A recorded rig with raw inertia: compared from its folder on, and its first state beside the reference."""

import shutil
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest

from tests.conftest import recorded
from vislam.cli.main import main
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.core.run import Run
from vislam.datasets.trajectories import read_poses
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.geometry import so3
from vislam.initialisation import initialise
from vislam.initialisation.found import GYRO
from vislam.models.imu import ImuNoise

PAIRS = 120
STRETCH = 5.0
"""Over which the reference tells the bias [s]."""
STEP = 0.1
"""Over which turns of gyro and reference are compared [s]."""


def first_pairs(folder):
    """The first pairs of MH_01 with all of its inertial samples, as a folder of its own."""
    source = recorded("euroc_mh01/groundtruth.tum").parent
    folder.mkdir()
    shutil.copy(source / "groundtruth.tum", folder)
    for name in ("cam0", "cam1", "imu0"):
        (folder / "mav0" / name).mkdir(parents=True)
        shutil.copy(source / "mav0" / name / "sensor.yaml", folder / "mav0" / name)
        lines = (source / "mav0" / name / "data.csv").read_text().splitlines(keepends=True)
        kept = lines if name == "imu0" else lines[: PAIRS + 1]
        (folder / "mav0" / name / "data.csv").write_text("".join(kept))
        if name != "imu0":
            (folder / "mav0" / name / "data").symlink_to(source / "mav0" / name / "data")
    return folder


def ate_of(run, dataset):
    """Root mean square of the positions after an alignment of heading and position [m]."""
    frame = np.arange(len(dataset.sequence))
    matched = associate(frame, dataset.sequence.stamp, run.final.world_T_imu, dataset.reference)
    placed = find_alignment("yaw_position", matched).transform_points(matched.estimate[:, :3, 3])
    return np.sqrt(np.mean(np.sum((placed - matched.position) ** 2, axis=1)))


def bias_by_reference(imu, stamp, world_R_imu):
    """Mean over short steps of what the gyro turns more than the reference ``(3,)`` [rad/s]."""
    turns = [so3.exp(rate * dt) for rate, dt in zip(imu.gyro[:-1], np.diff(imu.stamp), strict=True)]
    ends = np.arange(stamp[0], stamp[-1], STEP)
    excess = []
    for start, end in pairwise(ends):
        one, two = (int(np.abs(stamp - at).argmin()) for at in (start, end))
        first, last = np.searchsorted(imu.stamp, (stamp[one] - 1e-4, stamp[two] - 1e-4))
        turn = np.eye(3)
        for step in turns[first:last]:
            turn = turn @ step
        seen = world_R_imu[one].T @ world_R_imu[two]
        excess.append(so3.log(seen.T @ turn) / (stamp[two] - stamp[one]))
    return np.mean(excess, axis=0)


@pytest.mark.slow
def test_a_recorded_rig_is_compared_on_raw_inertia(tmp_path, monkeypatch):
    pytest.importorskip("cv2")
    folder = first_pairs(tmp_path / "mh01")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    command = ["compare", "--data", str(folder), "--out", "out", "--estimators", "ekf_invariant,isam2"]
    assert main([*command, "--no-report"]) == 0
    config = load(tmp_path / "out" / "mh01.yaml")
    assert config.motion == "imu"
    dataset = open_dataset(config.data, seed=config.seed)
    ate = {path.stem: ate_of(Run.load(path), dataset) for path in (tmp_path / "out").glob("*/runs/*.npz")}
    assert set(ate) == {"ekf_invariant", "isam2"}
    assert max(ate.values()) < 0.04

    sequence = dataset.sequence
    found = initialise(sequence, ImuNoise(**asdict(config.noise.imu)))
    stamp, pose = read_poses(tmp_path / "mh01" / "groundtruth.tum", "tum")
    near = (stamp >= sequence.stamp[0]) & (stamp <= sequence.stamp[0] + STRETCH)
    bias = bias_by_reference(sequence.imu, stamp[near], pose[near, :3, :3])
    sigma = np.sqrt(found.cov.diagonal()[GYRO])
    assert np.all(np.abs(found.gyro_bias - bias) < np.maximum(3.0 * sigma, 2e-3))
