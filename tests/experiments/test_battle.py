"""The measure of Clement et al. (2015), by hand."""

import numpy as np
import pytest

from experiments.battle import anees, armse, rows
from vislam import compare
from vislam.geometry import se3


@pytest.fixture(scope="module")
def outcome():
    return compare("tiny", estimators=["ekf"], data__simulation__frames=8, common_set_from=())


def test_armse_is_the_mean_of_roots_in_the_camera(outcome):
    run, record = outcome.runs["ekf"], outcome.results.record
    position, rotation = armse(run, record.reference, record.rig.imu_T_cam, estimate="filtered")
    cam, poses, target = record.rig.imu_T_cam, run.filtered.world_T_imu, record.reference.pose
    moved, turned = [], []
    for k in range(8):
        estimate = np.linalg.inv(poses[0] @ cam) @ poses[k] @ cam
        truth = np.linalg.inv(target[0] @ cam) @ target[k] @ cam
        moved.append(np.sqrt(np.sum((estimate[:3, 3] - truth[:3, 3]) ** 2) / 3.0))
        turned.append(np.linalg.norm(se3.log(np.linalg.inv(estimate) @ truth)[:3]) / np.sqrt(3.0))
    assert position == pytest.approx(np.mean(moved))
    assert rotation == pytest.approx(np.mean(turned))


def test_anees_is_the_nees_of_the_pose(outcome):
    run, reference = outcome.runs["ekf"], outcome.results.record.reference
    assert anees(run, reference, estimate="filtered") == pytest.approx(outcome.metric("nees_pose", "ekf"))
    assert len(list(rows(run, reference, outcome.results.record.rig.imu_T_cam))) == 1
