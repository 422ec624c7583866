"""What stops tell of the bias: nothing without one, the bias itself with one, whatever the camera's rig."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.calibration.standstill import standstill
from vislam.core.sequence import Sequence
from vislam.simulation import SimulationConfig, simulate

BIAS = np.array([0.004, -0.003, 0.005, 0.05, -0.02])


def stopping(first: int, end: int) -> Sequence:
    """A drive that stands still, but for pixel noise, from one frame to another."""
    moving, _ = simulate(SimulationConfig(frames=60, tracks_in_view=30), seed=1, name="stop")
    generator = np.random.default_rng(0)
    rows = slice(moving.offset[first], moving.offset[first + 1])
    many = int(moving.offset[first + 1] - moving.offset[first])
    counts = np.diff(moving.offset)
    track, pixels = [], []
    for k in range(len(moving)):
        own = rows if first <= k < end else slice(moving.offset[k], moving.offset[k + 1])
        track.append(moving.track[own])
        pixels.append(moving.pixels[own] + 0.05 * generator.standard_normal((len(track[-1]), 4)))
    counts[first:end] = many
    twist = moving.twist.copy()
    still = (moving.inertial_stamp >= moving.stamp[first]) & (moving.inertial_stamp < moving.stamp[end])
    twist[still] = np.append(BIAS, 0.0) + 0.001 * generator.standard_normal((int(still.sum()), 6))
    return replace(
        moving,
        offset=np.concatenate([[0], np.cumsum(counts)]),
        track=np.concatenate(track),
        pixels=np.concatenate(pixels),
        row=np.arange(int(counts.sum())),
        twist=twist,
    )


def test_a_stop_tells_the_bias():
    found = standstill(stopping(20, 50))
    assert 25 <= found.frames <= 30
    assert found.bias[:5] == pytest.approx(BIAS, abs=3e-3)
    assert list(found.known) == [True] * 5 + [False]


def test_what_moves_tells_nothing():
    moving, _ = simulate(SimulationConfig(frames=30, tracks_in_view=30), seed=1, name="moving")
    found = standstill(moving)
    assert found.frames == 0
    assert not found.known.any()


def test_a_stop_of_a_moment_tells_nothing():
    assert standstill(stopping(20, 25)).frames == 0
