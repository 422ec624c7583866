"""Faults of raw inertia, each planted in a simulated drive and found, and none found where there is none."""

import json
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import recorded
from vislam.cli.main import main
from vislam.cli.raw_inertia import with_raw_inertia, with_repairs
from vislam.comparison import config as configuration
from vislam.comparison.open import open_dataset
from vislam.core.imu import ImuSeries
from vislam.geometry import se3, so3
from vislam.inspection import inspect_sequence
from vislam.inspection.checks import unrepaired
from vislam.inspection.inertia import check_inertia, noise
from vislam.models.imu import ImuNoise
from vislam.repair.inertial import ImuUnits
from vislam.repair.pixels import Disparity
from vislam.repair.tracks import Interruptions

CONFIGS = Path(__file__).parents[2] / "configs"
CYCLE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Samples as a driver writes that puts the second axis first."""


def changed(sequence, **parts):
    return replace(sequence, imu=replace(sequence.imu, **parts))


def both(sequence, matrix):
    imu = sequence.imu
    return changed(sequence, gyro=imu.gyro @ matrix.T, accel=imu.accel @ matrix.T)


def dropped(sequence, share=0.05):
    imu = sequence.imu
    kept = np.random.default_rng(5).random(len(imu)) > share
    return replace(sequence, imu=ImuSeries(imu.stamp[kept], imu.gyro[kept], imu.accel[kept]))


def saturated(sequence):
    limit = np.quantile(np.abs(sequence.imu.gyro), 0.95)
    return changed(sequence, gyro=np.clip(sequence.imu.gyro, -limit, limit))


FAULTS = {
    "g": ("imu units", lambda one: changed(one, accel=one.imu.accel / 9.80665)),
    "degrees": ("imu units", lambda one: changed(one, gyro=np.degrees(one.imu.gyro))),
    "permuted axes": ("imu axes", lambda one: both(one, CYCLE)),
    "turned axes": ("imu axes", lambda one: both(one, np.diag([1.0, -1.0, -1.0]))),
    "reflected axes": ("imu axes", lambda one: both(one, np.diag([1.0, 1.0, -1.0]))),
    "flipped gyro": ("imu axes", lambda one: changed(one, gyro=one.imu.gyro * [1.0, 1.0, -1.0])),
    "permuted accelerometer": ("imu axes", lambda one: changed(one, accel=one.imu.accel @ CYCLE.T)),
    "late": ("imu clock", lambda one: changed(one, stamp=one.imu.stamp + 0.03)),
    "early": ("imu clock", lambda one: changed(one, stamp=one.imu.stamp - 0.03)),
    "saturated": ("imu saturation", saturated),
    "dropped": ("imu samples", dropped),
}
FOLLOWS = {"saturated": {"imu noise"}}
"""What else may be found: samples at the end of a range are off the tracks, and no noise makes them right."""
QUICK = ("degrees", "turned axes", "late")
"""Tried in the fast suite."""
ANSWERS = {
    "permuted axes": lambda found: found.proposal["data.repair.axes"] == {"body": ["y", "z", "x"]},
    "turned axes": lambda found: found.proposal["data.repair.axes"] == {"body": ["x", "-y", "-z"]},
    "late": lambda found: abs(found.proposal["data.repair.clock"]["offset"] - 0.03) < 0.01,
    "degrees": lambda found: (
        abs(found.measured[0].value * np.pi / 180.0 - 1.0) < 0.03
        and found.proposal == {"data.repair.imu_units": {"gyro": "deg/s", "accel": "m/s^2"}}
    ),
    "g": lambda found: found.proposal == {"data.repair.imu_units": {"gyro": "rad/s", "accel": "g"}},
}


@cache
def drive(name, seed, frames):
    """Config of a preset, and its sequence as the checks of raw inertia are given it."""
    config = configuration.load(CONFIGS / f"{name}.yaml")
    sequence = open_dataset(unrepaired(config).data, seed=seed).sequence.first(frames)
    return config, Disparity().apply(Interruptions().apply(sequence))


def checked(name, *, seed=1, frames=90, plant=lambda one: one, gravity=None, units=None):
    """Findings by their check."""
    config, sequence = drive(name, seed, frames)
    repair = replace(config.data.repair, imu_units=units)
    config = replace(config, data=replace(config.data, repair=repair))
    if gravity is not None:
        imu = replace(config.noise.imu, gravity=gravity)
        config = replace(config, noise=replace(config.noise, imu=imu))
    return {finding.check: finding for finding, _ in check_inertia(plant(sequence), config)}


def faults(found):
    return {check for check, finding in found.items() if finding.verdict == "fault"}


@pytest.mark.parametrize("fault", QUICK)
def test_a_planted_fault_is_found_and_no_other(fault):
    check, plant = FAULTS[fault]
    found = checked("euroc_like", plant=plant)
    assert faults(found) == {check}, {name: one.text for name, one in found.items()}
    assert ANSWERS.get(fault, lambda finding: True)(found[check]), found[check]


def test_a_clean_drive_has_no_fault():
    found = checked("euroc_like")
    assert not faults(found)
    assert {found[name].verdict for name in ("imu units", "imu clock", "imu axes", "imu first state")} == {
        "ok"
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize("name", ["euroc_like", "car_like"])
def test_a_clean_drive_of_either_kind_has_no_fault(name, seed):
    assert not faults(checked(name, seed=seed, frames=200))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "frames"), [("euroc_like", 120), ("car_like", 200)])
def test_all_planted_faults_are_found_on_drives_of_either_kind(name, frames):
    for fault, (check, plant) in FAULTS.items():
        found = checked(name, seed=1, frames=frames, plant=plant)
        assert faults(found) - FOLLOWS.get(fault, set()) == {check}, fault
        assert ANSWERS.get(fault, lambda finding: True)(found[check]), found[check]
    assert faults(checked(name, seed=1, frames=frames, gravity=8.7)) == {"imu gravity"}


def test_a_camera_that_is_turned_by_some_degrees_is_found():
    def turned(sequence):
        off = se3.from_rotation_translation(so3.exp(np.array([0.0, 0.0, np.deg2rad(5.0)])), np.zeros(3))
        return replace(sequence, rig=replace(sequence.rig, imu_T_cam=off @ sequence.rig.imu_T_cam))

    found = checked("euroc_like", plant=turned)["imu axes"]
    assert found.verdict == "fault"
    turn = np.linalg.norm([one.value for one in found.measured])
    assert turn == pytest.approx(5.0, abs=0.5)


def test_without_a_camera_that_shows_its_motion_nothing_is_told():
    def blind(sequence):
        return sequence.select(np.zeros(sequence.observations, bool))

    found = checked("euroc_like", plant=blind)
    assert {found[name].verdict for name in ("imu clock", "imu axes", "imu gravity", "imu noise")} == {
        "unclear"
    }


def test_the_written_config_has_the_densities_and_the_motion_of_a_recording_without_velocity():
    config, sequence = drive("euroc_like", 1, 90)
    bare = replace(sequence, twist=np.zeros_like(sequence.twist))
    quiet = replace(config.noise, imu=replace(config.noise.imu, gyro_density=1e-5, accel_density=1e-4))
    result = inspect_sequence(bare, replace(config, noise=quiet, motion="odometry"))
    assert result.finding("imu noise").verdict == "fault"
    assert result.proposal["noise.imu.gyro_density"] > 5e-5
    assert result.settings["motion"] == "imu"
    assert "third velocity component" not in {finding.check for finding in result.findings}


def in_other_units(sequence, *, matrix=None):
    """A recording without velocity, in g and degrees, its axes turned if that is asked for."""
    turn = np.eye(3) if matrix is None else matrix
    imu = sequence.imu
    gyro = np.degrees(imu.gyro @ turn.T)
    return replace(
        sequence,
        imu=replace(imu, gyro=gyro, accel=imu.accel @ turn.T / 9.80665),
        inertial_stamp=imu.stamp,
        twist=np.hstack([gyro, np.zeros_like(gyro)]),
        vertical_velocity=np.full(len(imu), np.nan),
        start=None,
    )


@pytest.mark.slow
def test_a_recording_in_other_units_and_axes_is_sound_once_it_is_repaired_as_proposed():
    config, sequence = drive("euroc_like", 1, 90)
    spoilt = in_other_units(sequence, matrix=CYCLE)
    result = inspect_sequence(spoilt, replace(config, motion="odometry"))
    assert result.proposal["data.repair.imu_units"] == {"gyro": "deg/s", "accel": "g"}
    assert result.proposal["data.repair.axes"] == {"body": ["y", "z", "x"]}
    assert "data.file" not in result.unknown, result.unknown
    assert {result.finding(f"imu {name}").verdict for name in ("gravity", "noise", "first state")} == {"ok"}
    tree = {"name": "a", "data": {"file": "a.npz"}}
    mended = with_repairs(tree, spoilt, result)
    assert np.allclose(mended.imu.accel, sequence.imu.accel @ CYCLE.T)
    assert np.allclose(mended.twist[:, :3], mended.imu.gyro)
    (line,) = with_raw_inertia(tree, mended, None)
    assert tree["motion"] == "imu", line
    written = configuration.parse(configuration.Config, tree)
    again = inspect_sequence(spoilt, written)
    units, axes = again.finding("imu units"), again.finding("imu axes")
    assert (units.verdict, axes.verdict) == ("ok", "ok")


def test_a_unit_that_is_configured_wrongly_is_found_and_taken_back():
    wrong = ImuUnits(gyro="deg/s", accel="g")
    found = checked("euroc_like", plant=wrong.apply, units=wrong)["imu units"]
    assert found.proposal == {"data.repair.imu_units": None}


@pytest.mark.parametrize(("factors", "verdict"), [([1.0, 16.0, 32.0], "fault"), ([1.0, 1.0, 32.0], "ok")])
def test_noise_that_most_parts_refute_is_too_small(factors, verdict, monkeypatch):
    monkeypatch.setattr(noise, "_factors", lambda *_: factors)
    config, sequence = drive("euroc_like", 1, 30)
    stated = ImuNoise(**asdict(config.noise.imu))
    assert noise.check_noise(sequence, stated).verdict == verdict


def test_what_no_magnitude_tells_apart_is_not_decided():
    found = checked("euroc_like", plant=lambda one: changed(one, accel=one.imu.accel * 100.0))["imu units"]
    assert found.verdict == "fault"
    assert "cm/s^2 or mg" in found.text
    assert not found.proposal
    assert "data.file" in found.unknown


@pytest.mark.slow
def test_a_recorded_rig_is_told_as_its_calibration_has_it(tmp_path, monkeypatch):
    pytest.importorskip("cv2")
    folder = recorded("euroc_mh01/groundtruth.tum").parent
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert main(["inspect", "--data", str(folder), "--out", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out" / "inspection.json").read_text())
    found = {one["check"]: one for one in document["findings"]}
    right = ("samples", "saturation", "units", "clock", "axes", "gravity", "biases", "first state")
    assert {name: found[f"imu {name}"]["verdict"] for name in right} == dict.fromkeys(right, "ok")
    assert found["imu gravity"]["measured"][0]["value"] == pytest.approx(9.81, rel=0.01)
    # A rig that is shaken is off the tracks by more than its data sheet has.
    assert found["imu noise"]["verdict"] == "fault"
    assert 3e-4 < document["proposal"]["noise.imu.gyro_density"] < 1.2e-3
    assert document["settings"]["motion"] == "imu"
