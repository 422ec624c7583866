"""Each trap planted and removed: the inspection finds it, and finds nothing where nothing is.

The rates are those of short simulated drives (160 frames); a recording is six times as long.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.clement import converted
from tests.conftest import recorded
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import open_dataset
from vislam.datasets.course_npz import load_course_npz
from vislam.inspection import inspect_sequence
from vislam.inspection.checks import unrepaired
from vislam.inspection.figures import figures
from vislam.inspection.mounting import candidates
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

CLEAN = SimulationConfig(
    frames=160,
    tracks_in_view=60,
    pixel_sigma_px=0.15,
    drift_px=0.15,
    matching_bias_px=0.4,
    gyro_bias=(0.004, -0.003, 0.005),
    gyro_sigma=0.003,
    velocity_sigma=0.03,
)
NOISE = NoiseConfig(twist_density=(1e-3, 1e-3, 1e-3, 0.01, 0.02, 0.02))
TRAPS = {
    "axes": ("axes and extrinsic", {"extrinsic_axes": ("x", "-y", "-z")}),
    "inverted extrinsic": (
        "axes and extrinsic",
        {"extrinsic_rotation": "inverse", "extrinsic_translation": "inverse"},
    ),
    "duplicated tracks": ("duplicated tracks", {"duplication_probability": 0.1}),
    "clock": ("clock", {"clock_offset": 0.08}),
    "levelled velocity": ("third velocity component", {"navigation_frame_velocity": True, "hills_m": 15.0}),
    "baseline": ("stereo scale", {"stated_baseline": 0.62}),
    "disparity offset": ("disparity offset", {"disparity_offset_px": -0.5}),
    "moving objects": ("moving objects", {"moving_share": 0.2}),
    "gyro bias": ("biases", {"gyro_bias": (0.06, -0.05, 0.06)}),
    "gyro noise": ("inertial noise", {"gyro_sigma": 0.1}),
    "negative disparities": ("observations", {"outlier_probability": 0.02}),
}
QUICK = ("axes", "duplicated tracks")
"""Tried in the fast suite; the others in the slow one."""
SWITCHED_OFF = {
    "duplicated tracks": "duplicated_tracks",
    "moving objects": "consensus",
    "negative disparities": "disparity",
}


def inspected(simulation, *, seed, repair=None):
    steps = RepairConfig() if repair is None else repair
    config = Config(name="s", data=DataConfig(simulation=simulation, repair=steps), noise=NOISE)
    return inspect_sequence(open_dataset(unrepaired(config).data, seed=seed).sequence, config)


def planted(trap, *, seed, frames=CLEAN.frames):
    check, faults = TRAPS[trap]
    steps = RepairConfig()
    if trap in SWITCHED_OFF:
        steps = replace(steps, **{SWITCHED_OFF[trap]: None})
    return inspected(replace(CLEAN, frames=frames, **faults), seed=seed, repair=steps).finding(check)


@pytest.mark.parametrize(
    "trap",
    [trap if trap in QUICK else pytest.param(trap, marks=pytest.mark.slow) for trap in sorted(TRAPS)],
)
def test_a_planted_trap_is_found_and_answered(trap):
    finding = planted(trap, seed=2, frames=50 if trap in QUICK else CLEAN.frames)
    assert finding.verdict == "fault", finding.text
    assert finding.proposal


@pytest.mark.slow
def test_a_clean_drive_has_no_fault():
    faults = [item.text for item in inspected(CLEAN, seed=1).findings if item.verdict == "fault"]
    assert faults == []


@pytest.mark.slow
def test_what_is_proposed_answers_what_was_found():
    spoilt = replace(
        CLEAN,
        frames=250,
        extrinsic_axes=("x", "-y", "-z"),
        clock_offset=0.07,
        duplication_probability=0.1,
        disparity_offset_px=-0.5,
    )
    first = inspected(spoilt, seed=4)
    offset = first.finding("disparity offset").proposal["data.repair.disparity_offset"]["pixels"]
    clock = first.finding("clock").proposal["data.repair.clock"]["offset"]
    assert first.finding("axes and extrinsic").proposal["data.repair.axes"] == {"body": ["x", "-y", "-z"]}
    assert abs(offset + 0.5) < 0.2
    assert abs(clock - 0.07) < 0.015


@pytest.mark.slow
def test_intervals_hold_what_was_planted():
    result = inspected(replace(CLEAN, frames=300, clock_offset=0.04), seed=7)
    for check, planted_value in (("clock", 0.04), ("stereo scale", 1.0), ("disparity offset", 0.0)):
        measured = result.finding(check).measured[0]
        assert abs(measured.value - planted_value) < 4.0 * measured.sigma, str(measured)
    for measured, value in zip(result.finding("biases").measured, CLEAN.gyro_bias, strict=False):
        assert abs(measured.value - value) < 4.0 * measured.sigma, str(measured)


@pytest.mark.slow
def test_gaps_are_counted():
    raw = open_dataset(DataConfig(simulation=replace(CLEAN, frames=60)), seed=1).sequence
    late = np.where(np.arange(len(raw)) >= 30, 2 * CLEAN.period, 0.0)
    config = Config(name="s", data=DataConfig(simulation=CLEAN))
    result = inspect_sequence(replace(raw, stamp=raw.stamp + late, inertial_stamp=raw.stamp + late), config)
    assert result.finding("stamps").counts["frames_missing"] == 2


def test_there_are_24_turns_under_four_readings():
    everyone = candidates()
    assert len(everyone) == 96
    assert len({item.axes for item in everyone}) == 24


def test_a_drive_without_tracks_is_unclear_not_a_crash():
    blind = replace(CLEAN, frames=30, tracks_in_view=2)
    assert inspected(blind, seed=1).finding("motion").verdict == "unclear"


@pytest.mark.statistical
def test_rates_of_false_alarms_and_of_misses():
    # Measured: no false alarm in 130 checks of clean drives, no miss in 44 planted traps. An inspection that
    # misses one trap in four would miss three of 33 or fewer twice in a hundred times.
    clean = [inspected(CLEAN, seed=seed) for seed in range(10, 20)]
    checks = [item for result in clean for item in result.findings]
    alarms = [item.check for item in checks if item.verdict == "fault"]
    misses = {
        trap: sum(planted(trap, seed=seed).verdict != "fault" for seed in range(20, 23)) for trap in TRAPS
    }
    print(f"\nfalse alarms {len(alarms)} of {len(checks)} {alarms}; misses of 3 {misses}")
    assert len(alarms) <= 0.03 * len(checks)
    assert sum(misses.values()) <= 0.1 * 3 * len(TRAPS)


@pytest.mark.parametrize(
    ("name", "faults"),
    [
        (
            "03.npz",
            {
                "observations",
                "duplicated tracks",
                "clock",
                "axes and extrinsic",
                "third velocity component",
                "axes of the rates",
                "disparity offset",
                "moving objects",
            },
        ),
        # The extrinsic is mixed: its translation is that of the inverse, which the turns show.
        (
            "0027.npz",
            {"observations", "duplicated tracks", "clock", "lever arm", "moving objects", "shared errors"},
        ),
    ],
)
@pytest.mark.slow
def test_recorded_traps_are_found_with_nothing_configured(name, faults):
    raw = load_course_npz(recorded(name))
    nothing = RepairConfig(duplicated_tracks=None, disparity=None, consensus=None)
    density = (2e-3,) * 3 + (5e-3, 0.02, 0.02) if name == "03.npz" else (0.016,) * 3 + (0.16,) * 3
    config = Config(
        name="bare",
        data=DataConfig(file=name, repair=nothing),
        noise=NoiseConfig(twist_density=density),
    )
    result = inspect_sequence(raw, config)
    assert {item.check for item in result.findings if item.verdict == "fault"} == faults
    assert len(result.series["duplicated_frames"]) == {"03.npz": 153, "0027.npz": 91}[name]
    assert_the_rest_is_right(name, result)


def assert_the_rest_is_right(name, result):
    """Measured by other means: the clock against references, the bias and the noise by calibration."""
    clock = result.finding("clock").measured[0]
    assert 0.02 < clock.value < 0.09
    gyro = [item.value for item in result.finding("biases").measured[:3]]
    noise = result.settings
    if name == "03.npz":
        assert np.allclose(gyro, -0.010, atol=0.003)
        assert result.proposal["data.repair.axes"] == {"body": ["x", "-y", "-z"]}
        assert 0.5 < noise["noise.matching_bias_px"] < 0.9
        return
    assert np.allclose(gyro, 0.0045, atol=0.003)
    # The rotation is told from its mirror image to a degree only, the third component is mostly noise.
    assert result.finding("axes and extrinsic").verdict == "unclear"
    assert result.proposal["data.repair.extrinsic"] == {"rotation": "stored", "translation": "inverse"}
    assert result.finding("third velocity component").verdict == "unclear"
    assert noise["data.repair.navigation_frame_velocity"] is True
    assert 0.7 < noise["noise.matching_bias_px"] < 0.95
    assert not np.any(noise["noise.bias_mean"][3:])


@pytest.mark.parametrize("name", ["0001", "0036"])
@pytest.mark.slow
def test_another_front_end_has_no_fault_of_axes_or_stale_frames(name, tmp_path):
    raw = load_course_npz(converted(f"2011_09_26_drive_{name}_sync_KLT", tmp_path))
    result = inspect_sequence(raw, Config(name="bare", data=DataConfig(file="kitti.npz")))
    verdicts = {item.check: item.verdict for item in result.findings}
    assert verdicts["duplicated tracks"] == verdicts["units"] == "ok"
    assert verdicts["axes and extrinsic"] == "unclear"
    assert verdicts["clock"] == "fault"
    assert abs(result.finding("clock").measured[0].value - 0.0525) < 0.012


@pytest.mark.slow
def test_hand_held_with_few_tracks_says_so_first(tmp_path):
    raw = load_course_npz(converted("dataset3", tmp_path))
    result = inspect_sequence(raw, Config(name="bare", data=DataConfig(file="starry.npz")))
    assert result.findings[0].check == "tracks"
    assert result.findings[0].verdict == "unclear"
    assert "few tracks" in result.findings[0].text
    # Landmarks half a metre away are no points behind the camera.
    assert result.finding("axes and extrinsic").counts["best_px"] < 5.0
    assert result.finding("third velocity component").verdict == "ok"
    assert result.finding("lever arm").verdict == "ok"
    assert {"data.repair.baseline", "data.repair.disparity_offset"} <= set(result.unknown)
    assert set(figures(result, title="t")) == {"tracks", "motion", "checks", "shared"}
