"""What is calibrated: how it is read and written, and what a moved clock or disparity offset does."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.parameters import MATCH, parameters
from vislam.calibration.recordings import first_frames_of, other_recording
from vislam.comparison.config import Config, DataConfig, NoiseConfig, VerticalVelocityConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.sequence import Sequence
from vislam.repair import RepairConfig
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset
from vislam.simulation import SimulationConfig

EVERY = [*parameters(inertial=True, disparity_offset=True), MATCH]
NOISE = NoiseConfig(
    pixel_sigma_px=0.3, drift_px=0.1, matching_bias_px=0.4, twist_density=(1e-3, 1e-3, 1e-3, 0.02, 0.03, 0.04)
)
PLAIN = Config(name="plain", data=DataConfig(simulation=SimulationConfig(frames=12)), noise=NOISE)
SET = replace(
    PLAIN,
    data=replace(
        PLAIN.data,
        repair=RepairConfig(
            consensus=None, clock=Clock(offset=0.01), disparity_offset=DisparityOffset(pixels=0.2)
        ),
    ),
)
"""The same with both offsets set, so that the sequence has them taken out already."""
CHANGED = {
    "noise.pixel_sigma_px": ["noise.pixel_sigma_px"],
    "noise.drift_px": ["noise.drift_px"],
    "noise.matching_bias_px": ["noise.matching_bias_px"],
    "noise.twist_density (gyro)": [f"noise.twist_density.{index}" for index in range(3)],
    "noise.twist_density (forward)": ["noise.twist_density.3"],
    "noise.twist_density (lateral)": ["noise.twist_density.4"],
    "noise.twist_density (vertical)": ["noise.twist_density.5"],
    "data.repair.clock.offset": ["data.repair.clock.offset"],
    "data.repair.disparity_offset.pixels": ["data.repair.disparity_offset.pixels"],
}


def leaves(value, path=""):
    """Every value of a config by its dotted path."""
    if isinstance(value, dict):
        parts = value.items()
    elif isinstance(value, list | tuple):
        parts = enumerate(value)
    else:
        return {path: value}
    return {
        key: leaf for name, part in parts for key, leaf in leaves(part, f"{path}.{name}".strip(".")).items()
    }


def same(one: Sequence, other: Sequence) -> bool:
    """Whether two sequences feed an estimator the same frames."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("stamp", "inertial_stamp", "twist", "offset", "track", "pixels", "row")
    ) and np.array_equal(one.step_means()[0], other.step_means()[0])


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Twelve frames repaired by ``SET``; no track is near enough to the limits to be dropped by an offset."""
    return open_dataset(replace(SET.data, simulation=near()), seed=5)


def near() -> SimulationConfig:
    return SimulationConfig(frames=12, tracks_in_view=15, pixel_sigma_px=0.3, depth_max=40.0)


@pytest.mark.parametrize("item", EVERY, ids=lambda item: item.name)
@pytest.mark.parametrize("config", [PLAIN, SET], ids=["plain", "set"])
def test_what_is_written_is_read_and_nothing_else_changes(item, config):
    value = 0.0123
    written = item.write(config, value)
    assert item.read(written) == pytest.approx(value, rel=1e-12)
    before, after = leaves(asdict(config)), leaves(asdict(written))
    # A step that was switched off becomes a section of one key.
    changed = [key for key in after if key not in before or before[key] != after[key]]
    assert changed == CHANGED[item.name]
    assert set(before) - set(after) <= {CHANGED[item.name][0].rpartition(".")[0]}


@pytest.mark.parametrize("item", EVERY, ids=lambda item: item.name)
def test_writing_what_was_read_changes_nothing(item):
    assert item.write(SET, item.read(SET)) == SET


@pytest.mark.parametrize("item", EVERY, ids=lambda item: item.name)
def test_the_searched_scale_goes_there_and_back(item):
    for value in (0.03, 0.7):
        assert item.value(item.searched(value)) == pytest.approx(value, rel=1e-12)


def test_a_level_is_searched_by_its_logarithm_and_never_below_its_lowest():
    for item in EVERY:
        if item.logarithmic:
            assert item.searched(1.0) == pytest.approx(0.0)
            assert item.value(item.searched(0.0)) == pytest.approx(item.lowest)
        else:
            assert item.searched(-0.3) == -0.3


def test_offsets_that_are_switched_off_are_read_as_zero():
    values = {item.name: item.read(PLAIN) for item in EVERY}
    assert values["data.repair.clock.offset"] == 0.0
    assert values["data.repair.disparity_offset.pixels"] == 0.0


def test_what_is_searched_unless_more_is_asked_for():
    names = [item.name for item in parameters()]
    assert names == [
        "noise.pixel_sigma_px",
        "noise.drift_px",
        "noise.twist_density (lateral)",
        "noise.twist_density (vertical)",
        "data.repair.clock.offset",
    ]
    inertial = ["noise.twist_density (gyro)", "noise.twist_density (forward)"]
    disparity = ["data.repair.disparity_offset.pixels"]
    assert [item.name for item in parameters(inertial=True)] == names + inertial
    assert [item.name for item in parameters(disparity_offset=True)] == names + disparity
    both = [item.name for item in parameters(inertial=True, disparity_offset=True)]
    assert both == names + inertial + disparity


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"clock": Clock(offset=-0.03)},
        {"disparity_offset": DisparityOffset(pixels=-0.1)},
        {"clock": Clock(offset=0.05), "disparity_offset": DisparityOffset(pixels=0.3)},
    ],
    ids=["nothing", "clock", "disparity", "both"],
)
def test_a_moved_sequence_is_the_one_that_the_moved_config_repairs(dataset, changes):
    moved = replace(SET, data=replace(SET.data, repair=replace(SET.data.repair, **changes)))
    repaired = open_dataset(replace(moved.data, simulation=near()), seed=5).sequence
    got = Evaluator(dataset, SET)._moved(moved).sequence
    assert np.allclose(got.pixels, repaired.pixels, rtol=0.0, atol=1e-12)
    assert same(replace(got, pixels=repaired.pixels), repaired)
    assert same(got, dataset.sequence) == (not changes)


def test_offsets_where_the_config_had_none_are_applied_in_full(dataset):
    unrepaired = replace(SET, data=replace(SET.data, repair=RepairConfig(consensus=None)))
    got = Evaluator(dataset, unrepaired)._moved(SET).sequence
    assert got.clock_offset == 0.01
    assert np.allclose(got.pixels - dataset.sequence.pixels, [0.0, 0.0, 0.2, 0.0])


def test_the_likelihood_is_that_of_the_moved_sequence(dataset):
    moved = replace(SET, data=replace(SET.data, repair=replace(SET.data.repair, clock=Clock(offset=0.06))))
    again = open_dataset(replace(moved.data, simulation=near()), seed=5)
    usable = np.ones(dataset.sequence.observations, bool)
    (got,) = Evaluator(dataset, SET).log_likelihoods([moved], usable=usable)
    (wanted,) = Evaluator(again, moved).log_likelihoods([moved], usable=usable)
    assert np.allclose(got, wanted, rtol=1e-9)


def test_the_first_frames_are_those_of_the_whole(dataset):
    whole, part = dataset.sequence, first_frames_of(dataset, 5).sequence
    assert len(part) == 5
    sigma = np.ones((whole.observations, 3))
    for one, other in zip(part.frames(sigma[: part.observations]), whole.frames(sigma), strict=False):
        assert one.k == other.k
        assert one.dt == other.dt
        assert np.array_equal(one.stereo.track, other.stereo.track)
        assert np.array_equal(one.stereo.z, other.stereo.z)
        assert np.allclose(one.odometry.twist, other.odometry.twist, rtol=0.0, atol=1e-12)
    assert np.array_equal(part.row, whole.row[: part.observations])


def test_more_frames_than_there_are_is_all_of_them(dataset):
    assert same(first_frames_of(dataset, 1000).sequence, dataset.sequence)
    assert first_frames_of(dataset, None) is dataset


def test_the_tracks_that_are_held_out_end_with_the_frames(dataset):
    part = first_frames_of(replace(dataset, held_out=dataset.sequence), 5)
    assert len(part.held_out) == 5


def test_another_recording_is_read_with_the_same_repairs():
    data = DataConfig(file="one.npz", repair=RepairConfig(clock=Clock(offset=0.04)))
    other = other_recording(data, "other.npz")
    assert other.file == "other.npz"
    assert other.repair == data.repair


@pytest.mark.parametrize("frames", [1, 0, -3])
def test_fewer_than_two_frames_are_no_drive(dataset, frames):
    with pytest.raises(DataError, match="at least 2 are needed"):
        first_frames_of(dataset, frames)


MOVING = replace(
    PLAIN,
    noise=replace(
        NOISE,
        acceleration_density=(0.05, 0.15, 0.1, 1.0, 0.2, 0.4),
        vertical_velocity=VerticalVelocityConfig(walk=0.1),
    ),
)
OF_MOTION = {
    "noise.acceleration_density (roll and pitch)": range(2),
    "noise.acceleration_density (yaw)": range(2, 3),
    "noise.acceleration_density (forward)": range(3, 4),
    "noise.acceleration_density (lateral and vertical)": range(4, 6),
}


def test_levels_of_the_motion_are_searched_where_the_config_uses_them():
    names = [item.name for item in parameters()]
    assert [item.name for item in parameters(PLAIN)] == names
    assert [item.name for item in parameters(MOVING)] == [*names, *OF_MOTION, "noise.vertical_velocity.walk"]


def test_a_level_of_the_motion_changes_its_own_components_and_keeps_their_ratio():
    before = np.array(MOVING.noise.acceleration_density)
    for item in parameters(MOVING):
        changed = item.write(MOVING, 0.3)
        assert np.isclose(item.read(changed), 0.3)
        after = np.array(changed.noise.acceleration_density)
        own = list(OF_MOTION.get(item.name, ()))
        if own:
            assert np.allclose(after[own] / before[own], after[own][0] / before[own][0])
            assert np.isclose(np.mean(after[own]), 0.3)
        assert np.array_equal(np.delete(after, own), np.delete(before, own))
        assert (changed.noise.vertical_velocity.walk == 0.1) == (item.name != "noise.vertical_velocity.walk")


def test_what_is_measured_of_the_motion_is_in_the_likelihood():
    """Too smooth a body is told by its inertial samples: likelihood falls away on both sides of a level."""
    smooth = replace(MOVING, noise=replace(MOVING.noise, vertical_velocity=None))
    drive = open_dataset(replace(SET.data, simulation=near(), repair=RepairConfig(consensus=None)), seed=5)
    usable = np.ones(drive.sequence.observations, bool)
    forward = next(item for item in parameters(smooth) if item.name.endswith("(forward)"))
    levels = [1e-2, 0.5, 1e3]
    found = Evaluator(drive, smooth).log_likelihoods(
        [forward.write(smooth, level) for level in levels], usable=usable
    )
    low, middle, high = (float(part.sum()) for part in found)
    assert middle > low
    assert middle > high
