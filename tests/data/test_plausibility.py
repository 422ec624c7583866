"""Units that are off are told from the data alone; rigs of all kinds pass as they are."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.test_compare import course_file
from vislam.base.errors import DataError
from vislam.base.progress import Silent
from vislam.calibration import calibrate
from vislam.compare import main
from vislam.comparison.compare import run_comparison
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.open import Dataset, open_dataset, require_usable
from vislam.comparison.plausibility import implausible, motion_ratios
from vislam.datasets.course_export import write_course_npz
from vislam.geometry import se3
from vislam.repair import RepairConfig, apply
from vislam.repair.mounting import Baseline
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.settings import RigConfig

HAND = RigConfig(
    fx=485.0,
    fy=485.0,
    cx=320.0,
    cy=240.0,
    width=640.0,
    height=480.0,
    baseline=0.24,
    position_imu=(0.02, 0.1, 0.03),
    pitch_deg=0.0,
)
RIGS = {
    "car": {"period": 0.1046, "speed": 12.7},
    "slow car": {"period": 0.1, "speed": 2.0},
    "motorway": {"period": 0.1, "speed": 33.0, "path": "highway"},
    "hand-held": {"period": 0.07, "speed": 0.5, "rig": HAND, "depth_min": 0.7, "depth_max": 4.0},
    "drone": {"period": 0.005, "speed": 8.0, "rig": HAND, "depth_min": 2.0, "depth_max": 30.0},
    "time lapse": {"period": 2.0, "speed": 0.3},
}


def drive(rig="car", *, seed=3, frames=40, **changes):
    settings = SimulationConfig(
        frames=frames, **{"tracks_in_view": 40, "hills_m": 0.0, "pixel_sigma_px": 0.2, **RIGS[rig], **changes}
    )
    return simulate(settings, seed=seed, name="drive")[0]


def with_stamps(sequence, factor, *, start=0.0):
    stamp = factor * sequence.stamp + start
    return replace(sequence, stamp=stamp, inertial_stamp=stamp)


def with_twist(sequence, *, turn=1.0, velocity=1.0):
    return replace(sequence, twist=sequence.twist * np.repeat([turn, velocity], 3))


def with_baseline(sequence, factor):
    return replace(sequence, rig=replace(sequence.rig, baseline=factor * sequence.rig.baseline))


def with_lever_arm(sequence, factor):
    pose = sequence.rig.imu_T_cam
    moved = se3.from_rotation_translation(pose[:3, :3], factor * pose[:3, 3])
    return replace(sequence, rig=replace(sequence.rig, imu_T_cam=moved))


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("seed", [1, 2])
def test_what_people_record_passes(rig, seed):
    assert implausible(drive(rig, seed=seed)) == []


@pytest.mark.slow
@settings(derandomize=True, deadline=None, max_examples=12)
@given(
    period=st.floats(0.004, 3.0),
    seed=st.integers(0, 50),
    gyro_sigma=st.sampled_from([0.0, 0.002, 0.05]),
    velocity_sigma=st.sampled_from([0.0, 0.05, 0.5]),
)
def test_noise_and_frame_rate_do_not_make_units_wrong(period, seed, gyro_sigma, velocity_sigma):
    # A metre a frame at most, whatever the rate: what a stereo pair can follow.
    speed = float(np.clip(1.0 / period, 0.5, 15.0))
    noisy = drive(seed=seed, period=period, speed=speed, gyro_sigma=gyro_sigma, velocity_sigma=velocity_sigma)
    assert implausible(noisy) == []


UNITS = {
    "milliseconds": (lambda item: with_stamps(item, 1e3), "time_stamps look like milliseconds"),
    "microseconds": (lambda item: with_stamps(item, 1e6), "time_stamps look like microseconds"),
    "nanoseconds": (lambda item: with_stamps(item, 1e9), "time_stamps look like nanoseconds"),
    "since 1970": (lambda item: with_stamps(item, 1e9, start=1.4e18), "time_stamps look like nanoseconds"),
    "hours": (lambda item: with_stamps(item, 1 / 3600), "time_stamps look like hours"),
    "baseline in mm": (lambda item: with_baseline(item, 1e3), "b looks like millimetres"),
    "baseline in cm": (lambda item: with_baseline(item, 1e2), "b looks like centimetres"),
    "lever arm in mm": (lambda item: with_lever_arm(item, 1e3), "extrinsic looks like millimetres"),
    "velocity in cm/s": (lambda item: with_twist(item, velocity=100.0), "linear_velocity looks like cm/s"),
    "velocity in km/s": (lambda item: with_twist(item, velocity=1e-3), "linear_velocity is not in m/s"),
    "turn in degrees": (
        lambda item: with_twist(item, turn=np.degrees(1)),
        "angular_velocity looks like deg/s",
    ),
}


@pytest.mark.parametrize("unit", UNITS)
def test_a_wrong_unit_is_told_with_its_likely_name(unit):
    spoil, guess = UNITS[unit]
    found = implausible(spoil(drive(path="loop")))
    assert guess in str(found[0])
    assert "\n" not in str(found[0])


def test_stamps_in_minutes_are_one_factor_of_both_motions():
    found = implausible(with_stamps(drive(path="loop"), 1 / 60))
    assert "both by one factor: the unit of time_stamps" in str(found[0])


def test_degrees_are_told_where_the_camera_hardly_turns():
    straight = drive(frames=60, pixel_sigma_px=0.5, path="straight")
    assert np.isnan(motion_ratios(straight).turn)
    noisy = replace(straight, twist=straight.twist + np.array([0.02, 0.03, -0.03, 0, 0, 0]))
    assert implausible(noisy) == []
    assert "deg/s" in str(implausible(with_twist(noisy, turn=np.degrees(1.0)))[0])


def test_a_camera_at_rest_or_without_tracks_says_nothing_of_units():
    sequence = drive()
    first = sequence.first_rows()
    assert implausible(replace(sequence, pixels=sequence.pixels[first])) == []
    assert implausible(sequence.select(np.zeros(sequence.observations, bool))) == []


def test_every_program_refuses_with_the_same_line(tmp_path, capsys):
    write_course_npz(tmp_path / "drive.npz", with_stamps(drive(), 1e3))
    (tmp_path / "c.yaml").write_text("name: c\ndata: {file: drive.npz}\n")
    assert main(["--config", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("vislam: drive: a frame every 104.6 s; expected 0.0001 to 10 s; time_stamps look")
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
    config = Config(name="c", data=DataConfig(file="drive.npz"))
    dataset = open_dataset(config.data, seed=0, data_dir=tmp_path)
    for run in (
        lambda: run_comparison(config, dataset, Silent()),
        lambda: calibrate(config, dataset, []),
    ):
        with pytest.raises(DataError, match="time_stamps look like milliseconds"):
            run()


def test_a_configured_baseline_mends_the_units(tmp_path):
    write_course_npz(tmp_path / "drive.npz", with_baseline(drive(), 1e3))
    wrong = open_dataset(DataConfig(file="drive.npz"), seed=0, data_dir=tmp_path)
    assert len(wrong.implausible) == 1
    mended = RepairConfig(baseline=Baseline(metres=0.594))
    require_usable(open_dataset(DataConfig(file="drive.npz", repair=mended), seed=0, data_dir=tmp_path))


def taken(sequence, **steps):
    dataset = Dataset(apply(sequence, RepairConfig(**steps)), None, ())
    with pytest.raises(DataError) as caught:
        require_usable(dataset)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_step_that_took_all_is_named_with_its_counts():
    sequence = drive()
    n = sequence.observations
    swapped = replace(sequence, pixels=sequence.pixels[:, [2, 3, 0, 1]])
    assert f"disparity dropped {n} of {n} ({n} disparity not positive)" in taken(swapped)
    apart = replace(sequence, pixels=sequence.pixels + np.array([0, 15.0, 0, 0]))
    assert f"disparity dropped {n} of {n} ({n} row difference)" in taken(apart)
    assert "data.repair.disparity switches it" in taken(apart)
    once = replace(sequence, track=np.arange(n))
    assert f"single_observations dropped {n} of {n}" in taken(once, disparity=None)
    assert "none was in the recording" in taken(sequence.select(np.zeros(n, bool)))


def test_each_step_records_what_it_was_given_and_left():
    repaired = apply(drive(), RepairConfig())
    for before, after in zip(repaired.repairs, repaired.repairs[1:], strict=False):
        assert before.after == after.before
    assert repaired.repairs[-1].after == repaired.observations
    dropped = sum(step.before - step.after for step in repaired.repairs)
    counted = sum(
        n for step in repaired.repairs for key, n in step.counts.items() if key.startswith("dropped")
    )
    assert dropped == counted > 0


@pytest.mark.parametrize(("key", "unit"), [("linear_velocity", "m/s"), ("angular_velocity", "rad/s")])
def test_a_reader_names_the_unit_of_what_no_camera_can_do(tmp_path, key, unit):
    course_file(tmp_path / "fast.npz", **{key: np.full((3, 6), 900.0)})
    with pytest.raises(DataError, match=f"up to 200 {unit}, got 900: is it in another unit"):
        open_dataset(DataConfig(file="fast.npz"), seed=0, data_dir=tmp_path)
