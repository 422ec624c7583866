"""Smoothers know no length of their own: a scene a quarter as large is estimated a quarter as large."""

from dataclasses import replace

import numpy as np
import pytest

from tests.smoother.drives import BUILD, drive, gap
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.loop import run
from vislam.geometry import se3

QUARTER = np.repeat([1.0, 0.25], 3)
BEYOND = {"relinearize_beyond": 1.0}


def smaller(problem):
    noise = problem.noise
    return replace(
        problem,
        rig=rig_of(problem.rig),
        noise=replace(noise, twist=noise.twist * QUARTER, bias_walk=noise.bias_walk * QUARTER),
        first_pose_sigma=problem.first_pose_sigma * QUARTER,
        bias_mean=problem.bias_mean * QUARTER,
        bias_sigma=problem.bias_sigma * QUARTER,
    )


def rig_of(rig):
    rotation, position = rig.imu_T_cam[:3, :3], rig.imu_T_cam[:3, 3]
    extrinsic = se3.from_rotation_translation(rotation, 0.25 * position)
    return replace(rig, baseline=0.25 * rig.baseline, imu_T_cam=extrinsic)


@pytest.mark.parametrize("name", ["isam2", "fixed_lag"])
def test_a_scene_a_quarter_as_large_is_estimated_a_quarter_as_large(name):
    config, dataset = drive(seed=3, frames=30, tracks_in_view=12, gyro=0.05, velocity=0.5, pixel=1.0)
    problem, sigma, sequence = make_problem(config, dataset), pixel_sigma(config, dataset), dataset.sequence
    less = replace(sequence, twist=sequence.twist * QUARTER, rig=rig_of(sequence.rig))
    large = run(BUILD[name](problem, BEYOND), sequence, sigma, name=name)
    small = run(BUILD[name](smaller(problem), BEYOND), less, sigma, name=name)
    found = small.filtered.world_T_imu.copy()
    found[:, :3, 3] *= 4.0
    assert large.log.counts["steps_relinearised_recent"] == small.log.counts["steps_relinearised_recent"] > 0
    turned, moved = gap(found, large.filtered.world_T_imu)
    assert turned < 1e-6
    assert moved < 1e-5
