"""Parameters that all observations share, taken for other values than nominal."""

import numpy as np
import pytest

from vislam.core.moved_data import PARAMETERS, component_name, moved
from vislam.geometry import so3
from vislam.models.shared_errors import SIZES
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset

EVERY = [(name, index) for name, kind in PARAMETERS.items() for index in range(len(kind.components))]


@pytest.mark.parametrize(("name", "index"), EVERY)
def test_nothing_but_the_parameter_is_another(short, name, index):
    sequence = short.sequence
    other = moved(sequence, name, index=index, amount=0.01)
    assert np.array_equal(other.track, sequence.track)
    assert np.array_equal(other.offset, sequence.offset)
    assert np.array_equal(other.stamp, sequence.stamp)
    changed = {
        "rig": not np.array_equal(rig_of(other), rig_of(sequence)),
        "pixels": not np.array_equal(other.pixels, sequence.pixels),
        "clock": other.clock_offset != sequence.clock_offset,
        "twist": not np.array_equal(other.twist, sequence.twist),
    }
    known = {
        "disparity_offset": "pixels",
        "tracker_bias": "pixels",
        "clock": "clock",
        "velocity_direction": "twist",
    }
    where = known.get(name, "twist" if name == "rate_direction" else "rig")
    assert [part for part, is_so in changed.items() if is_so] == [where]
    # There and back.
    back = moved(other, name, index=index, amount=-0.01)
    if name != "focal_scale":
        assert np.allclose(rig_of(back), rig_of(sequence), atol=1e-12)
        assert np.allclose(back.pixels, sequence.pixels, atol=1e-10)
        assert np.allclose(back.twist, sequence.twist, atol=1e-12)


def rig_of(sequence):
    rig = sequence.rig
    return np.concatenate([[rig.fx, rig.fy, rig.cx, rig.cy, rig.baseline], rig.imu_T_cam.ravel()])


def test_clock_and_disparities_are_as_the_repairs_take_them(short):
    sequence = short.sequence
    late = moved(sequence, "clock", index=0, amount=0.02)
    assert late.clock_offset == Clock(offset=sequence.clock_offset + 0.02).apply(sequence).clock_offset
    wide = moved(sequence, "disparity_offset", index=0, amount=0.3)
    assert np.array_equal(wide.pixels, DisparityOffset(pixels=0.3).apply(sequence).pixels)


@pytest.mark.parametrize("index", range(3))
def test_the_camera_turns_about_the_axes_of_the_body(short, index):
    before = short.sequence.rig.imu_T_cam
    after = moved(short.sequence, "camera_rotation", index=index, amount=0.01).rig.imu_T_cam
    assert np.allclose(so3.log(after[:3, :3] @ before[:3, :3].T), 0.01 * np.eye(3)[index], atol=1e-12)


def test_parameters_that_can_be_estimated_have_the_sizes_that_they_have_there():
    assert SIZES.items() <= {name: len(kind.components) for name, kind in PARAMETERS.items()}.items()


def test_the_velocity_is_off_in_proportion_to_its_forward_component(short):
    sequence = short.sequence
    for index in range(2):
        other = moved(sequence, "velocity_direction", index=index, amount=0.02)
        off = sequence.twist[:, 4 + index] - other.twist[:, 4 + index]
        assert np.allclose(off, 0.02 * sequence.twist[:, 3])


def test_roll_and_pitch_rate_are_off_in_proportion_to_the_yaw_rate(short):
    sequence = short.sequence
    other = moved(sequence, "rate_direction", index=1, amount=0.02)
    assert np.allclose(sequence.twist[:, 1] - other.twist[:, 1], 0.02 * sequence.twist[:, 2])
    assert np.array_equal(np.delete(other.twist, 1, axis=1), np.delete(sequence.twist, 1, axis=1))


def test_a_bias_of_the_tracker_grows_with_the_age_of_a_track_and_leaves_disparities(short):
    sequence = short.sequence
    for index, (left, right) in enumerate(((0, 2), (1, 3))):
        away = sequence.pixels - moved(sequence, "tracker_bias", index=index, amount=0.1).pixels
        assert np.allclose(away[:, left], 0.1 * sequence.age())
        assert np.allclose(away[:, left], away[:, right])
        assert np.abs(np.delete(away, [left, right], axis=1)).max() == 0.0


def test_components_have_names():
    assert component_name("camera_rotation", 2) == "camera_rotation_z"
    assert component_name("clock", 0) == "clock"


def test_tracks_move_off_alike_and_a_turn_is_that_of_the_camera_about_its_axis(short):
    sequence = short.sequence
    age, rig = sequence.age(), sequence.rig
    center = np.array([rig.cx, rig.cy])
    column = moved(sequence, "tracker_bias", index=0, amount=0.05)
    assert np.allclose(sequence.pixels - column.pixels, 0.05 * age[:, None] * [1, 0, 1, 0])
    turned = moved(sequence, "tracker_bias", index=2, amount=0.05)
    ray = (
        (sequence.pixels[:, :2] - center) / [rig.fx, rig.fy],
        (turned.pixels[:, :2] - center) / [rig.fx, rig.fy],
    )
    angle = np.arctan2(ray[0][:, 1], ray[0][:, 0]) - np.arctan2(ray[1][:, 1], ray[1][:, 0])
    assert np.allclose(np.angle(np.exp(1j * angle)), 0.05 * age / np.sqrt(rig.fx * rig.fy))
    assert np.allclose(np.linalg.norm(ray[0], axis=1), np.linalg.norm(ray[1], axis=1))
