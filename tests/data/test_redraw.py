"""Inertial data re-sampled beside recorded tracks."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.base.errors import ConfigError, DataError
from vislam.base.settings import parse
from vislam.comparison.config import DataConfig, RedrawConfig
from vislam.comparison.redraw import redraw
from vislam.core.reference import truth_reference
from vislam.geometry import se3
from vislam.repair.inertial import NavigationFrameVelocity
from vislam.simulation import SimulationConfig, simulate

FRAMES, PERIOD = 300, 0.1
NONE = RedrawConfig(twist_density=(0.0,) * 6)
NOISY = RedrawConfig(twist_density=(0.01, 0.01, 0.01, 0.1, 0.1, 0.2), bias=(0.01, 0.0, 0.0, 0.0, 0.3, 0.0))


@pytest.fixture(scope="module")
def drive():
    """A sequence whose inertial data are bad, and the poses that it had, of a point off the body's origin."""
    config = SimulationConfig(
        frames=FRAMES, period=PERIOD, tracks_in_view=5.0, gyro_sigma=0.5, clock_offset=0.3
    )
    sequence, truth = simulate(config, seed=3, name="drive")
    point = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 0.5, -0.5]))
    reference = truth_reference(truth.world_T_imu, np.empty(0, np.int64), np.empty((0, 3)))
    return (
        replace(sequence, clock_offset=0.1),
        replace(reference, pose=reference.pose @ point, imu_T_point=point),
        truth,
    )


def test_without_noise_the_motion_is_the_references(drive):
    sequence, reference, truth = drive
    twist, rise = redraw(sequence, reference, NONE, seed=0).step_means()
    found = [truth.world_T_imu[0]]
    for step in twist[1:]:
        found.append(found[-1] @ se3.exp(PERIOD * step))
    assert np.abs(np.array(found) - truth.world_T_imu).max() < 1e-5
    assert np.isnan(rise).all()


def test_the_noise_is_as_stated_and_each_seed_has_its_own(drive):
    sequence, reference, _ = drive
    clean = redraw(sequence, reference, NONE, seed=0).step_means()[0]
    one, again, other = (redraw(sequence, reference, NOISY, seed=seed) for seed in (1, 1, 2))
    error = (one.step_means()[0] - clean)[1:]
    sigma = np.array(NOISY.twist_density) / np.sqrt(PERIOD)
    assert np.allclose(error.std(axis=0), sigma, rtol=0.15)
    assert np.all(np.abs(error.mean(axis=0) - NOISY.bias) < 4.0 * sigma / np.sqrt(FRAMES))
    assert np.array_equal(one.twist, again.twist)
    assert one.digest == again.digest != other.digest
    assert np.array_equal(one.pixels, sequence.pixels)
    assert "redrawn" in one.name


def test_a_vertical_velocity_is_the_references_and_the_bodys_own_stays_0(drive):
    sequence, reference, truth = drive
    found = redraw(NavigationFrameVelocity().apply(sequence), reference, NONE, seed=0)
    twist, rise = found.step_means()
    assert np.array_equal(twist[1:, 5], np.zeros(FRAMES - 1))
    height = (truth.world_T_imu @ reference.imu_T_point @ se3.inverse(reference.imu_T_point))[:, 2, 3]
    assert np.allclose(rise[1:], np.diff(height) / PERIOD, atol=1e-5)


def test_frames_behind_the_reference_are_left_out_and_gaps_are_refused(drive):
    sequence, reference, _ = drive
    few = replace(reference, **{key: getattr(reference, key)[:200] for key in ("frame", "position", "pose")})
    assert len(redraw(sequence, few, NONE, seed=0)) == 200
    gap = replace(few, frame=np.delete(np.arange(201), 50))
    for wrong in (gap, replace(reference, pose=None)):
        with pytest.raises(DataError, match=r"with a pose of every frame .* leave redraw"):
            redraw(sequence, wrong, NONE, seed=0)


def test_there_must_be_a_recording_and_a_reference():
    drawn = {"twist_density": [0.0] * 6}
    for tree in ({"simulation": {}, "redraw_inertial": drawn}, {"file": "a.npz", "redraw_inertial": drawn}):
        with pytest.raises(ConfigError, match="redraw_inertial needs a recording and its reference"):
            parse(DataConfig, tree)
