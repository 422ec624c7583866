"""Drives that trajectory errors are measured on: a recorded one where it is, a simulated one always."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import recorded
from vislam.comparison import config
from vislam.comparison.open import open_dataset
from vislam.core.reference import Reference
from vislam.evaluation.association import Matched, associate
from vislam.geometry import se3
from vislam.simulation import SimulationConfig
from vislam.simulation.path import DrivePath

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Drive:
    """Dead reckoning, and what it is held against."""

    stamp: np.ndarray
    world_T_imu: np.ndarray
    reference: Reference

    def matched(self, keep=slice(None)) -> Matched:
        """All frames of the estimate, or some."""
        frame = np.arange(len(self.stamp))[keep]
        return associate(frame, self.stamp[keep], self.world_T_imu[keep], self.reference)


@pytest.fixture(scope="session", params=["recorded", "simulated"])
def drive(request) -> Drive:
    return recorded_drive() if request.param == "recorded" else simulated_drive()


def recorded_drive():
    for name in ("0027_poses.txt", "0027.npz"):
        recorded(name)
    data = config.load(ROOT / "configs" / "kitti07.yaml").data
    dataset = open_dataset(
        replace(data, repair=replace(data.repair, consensus=None)),
        seed=0,
        data_dir=recorded("0027.npz").parent,
    )
    sequence = dataset.sequence
    return Drive(sequence.stamp, dead_reckoned(sequence.stamp, sequence.step_means()[0]), dataset.reference)


def simulated_drive(frames=900):
    generator = np.random.default_rng(7)
    settings = SimulationConfig(frames=frames)
    path = DrivePath(settings, generator)
    stamp = settings.period * np.arange(frames)
    truth = path.pose(stamp)
    twist = path.twist(stamp - 0.5 * settings.period)
    twist += np.array([0.0, 0.001, 0.002, 0.05, 0.0, 0.02])
    twist += generator.normal(size=(frames, 6)) * [0.01, 0.01, 0.01, 0.2, 0.2, 0.2]
    imu_T_point = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 0.2, -0.5]))
    pose = se3.exp(np.array([0.1, 0.0, 1.0, 300.0, -200.0, 50.0])) @ truth @ imu_T_point
    reference = Reference("truth", "exact", np.arange(frames), pose[:, :3, 3], pose, imu_T_point)
    return Drive(stamp, dead_reckoned(stamp, twist), reference)


def dead_reckoned(stamp, twist):
    """Poses from the mean twist over the step that ends at each frame."""
    poses = [np.eye(4)]
    for motion in se3.exp(np.diff(stamp)[:, None] * twist[1:]):
        poses.append(poses[-1] @ motion)
    return np.array(poses)


def positions_of(reference, keep):
    """The reference as a planar one of some of its frames."""
    return replace(reference, frame=reference.frame[keep], position=reference.position[keep, :2], pose=None)
