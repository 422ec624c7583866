"""Raw inertia in the config that ``compare --data`` makes: used where it tells the first state."""

from dataclasses import replace

import pytest

from tests.initialisation.standing import NOISE, moving
from vislam.cli.raw_inertia import with_raw_inertia
from vislam.core.imu import ImuSeries

SET = ("gyro_density", "accel_density", "gyro_walk", "accel_walk")


def first(imu, samples, *, accel=1.0):
    return ImuSeries(imu.stamp[:samples], imu.gyro[:samples], accel * imu.accel[:samples])


def test_the_noise_that_is_stated_and_how_much_is_covered():
    sequence, tree = moving(1)[0], {}
    (line,) = with_raw_inertia(tree, sequence, NOISE)
    assert tree["motion"] == "imu"
    assert {name: tree["noise"]["imu"][name] for name in SET} == {name: getattr(NOISE, name) for name in SET}
    assert (
        f"{len(sequence.imu)} samples, 0 gaps, 100% of the recording covered; white noise that of its own"
        in line
    )
    assert "times 1," in line


def test_without_stated_noise_it_is_that_of_a_data_sheet():
    (line,) = with_raw_inertia({}, moving(1)[0], None)
    assert "the default, a data sheet's" in line


def test_samples_that_end_early_are_told():
    sequence = moving(1)[0]
    samples = int(0.6 * len(sequence.imu))
    tree = {}
    (line,) = with_raw_inertia(tree, replace(sequence, imu=first(sequence.imu, samples)), NOISE)
    covered = (sequence.imu.stamp[samples - 1] - sequence.stamp[0]) / (sequence.stamp[-1] - sequence.stamp[0])
    assert f"{covered:.0%} of the recording covered" in line


@pytest.mark.parametrize(
    ("samples", "accel", "said"), [(None, 1.0 / 9.81, "it looks like g"), (100, 1.0, "must cover 50%")]
)
def test_inertia_that_does_not_tell_the_state_is_left_out_in_one_line(samples, accel, said):
    sequence, tree = moving(1)[0], {}
    changed = replace(sequence, imu=first(sequence.imu, samples, accel=accel))
    (line,) = with_raw_inertia(tree, changed, NOISE)
    assert not tree
    assert line.startswith("raw inertia is left out (motion: odometry): ")
    assert said in line
    assert "\n" not in line
