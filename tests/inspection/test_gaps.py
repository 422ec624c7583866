"""Steps of a recording that has gaps count by their own length, not by that of the usual step."""

from dataclasses import replace

import numpy as np

from tests.smoother.drives import drive, thinned
from vislam.inspection import motion
from vislam.inspection.motion import VisionSteps

DENSITY = 0.02
PERIOD = 0.1


def with_gaps(*, noise):
    """A drive of which two of five frames are missing, whose samples have ``noise`` of one of 0.1 s."""
    _, dataset = drive(seed=3, frames=900, period=PERIOD, tracks_in_view=1, gyro=noise, velocity=noise)
    sequence = dataset.sequence
    kept = np.flatnonzero(np.arange(900) % 60 < 36)
    kept = kept[(kept % 60 < 24) | (kept % 3 == 0)]
    return thinned(sequence, kept)


def test_samples_on_both_sides_of_a_gap_are_no_noise():
    sequence = with_gaps(noise=0.002)
    assert np.diff(sequence.stamp).max() > 2.0
    found = motion.sample_noise(sequence)
    assert np.all(np.abs(found / 0.002 - 1.0) < 0.25)
    measured = motion._sample_densities(sequence)
    assert np.allclose([one.value for one in measured], found * np.sqrt(PERIOD), rtol=0.05)


def test_what_a_body_is_off_its_samples_counts_by_the_length_of_the_step():
    sequence = with_gaps(noise=0.0)
    # Steps of 0.1 to 0.6 s in turn, each with the white noise of its own length.
    generator = np.random.default_rng(5)
    dt = np.tile([0.1, 0.6, 0.6], len(sequence) // 3 + 1)[: len(sequence) - 1]
    sequence = replace(sequence, stamp=np.concatenate([[0.0], np.cumsum(dt)]))
    means, _ = sequence.step_means()
    error = DENSITY / np.sqrt(dt)[:, None] * generator.standard_normal((len(dt), 6))
    frame = np.arange(1, len(sequence))
    steps = VisionSteps(frame, means[1:] + error, np.full((len(dt), 6), 1e-6))
    for found in (motion._rates(sequence, steps), motion._across(sequence, steps)):
        assert np.all(np.abs(found / DENSITY - 1.0) < 0.15)
