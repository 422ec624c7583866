"""What an inspection measures, and what it says where the data cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.data.test_plausibility import RIGS, drive
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.geometry import se3
from vislam.inspection import inspect_sequence
from vislam.inspection.lever_arm import check_lever_arm
from vislam.inspection.mounting import Candidate, check_mounting
from vislam.inspection.pixels import check_pixel_noise
from vislam.inspection.stereo import check_match
from vislam.repair import RepairConfig
from vislam.repair.mounting import Extrinsic
from vislam.repair.pixels import Disparity
from vislam.repair.tracks import SingleObservations
from vislam.simulation import SimulationConfig, simulate


def long_drive(*, seed=1, **changes):
    settings = {
        "frames": 160,
        "tracks_in_view": 60,
        "pixel_sigma_px": 0.15,
        "velocity_sigma": 0.03,
        "path": "urban",
        "speed": 8.0,
        **changes,
    }
    sequence = simulate(SimulationConfig(**settings), seed=seed, name="s")[0]
    return SingleObservations().apply(Disparity().apply(sequence))


def fits_of(sequence):
    return rigid_fits(sequence, continuations(sequence))


def inspected(sequence, *, repair=None, noise=None):
    config = Config(
        name="s",
        data=DataConfig(file="s.npz", repair=repair or RepairConfig()),
        noise=noise or NoiseConfig(),
    )
    return inspect_sequence(sequence, config)


@pytest.mark.parametrize(
    ("white", "drift"),
    [
        (0.15, 0.15),
        *(pytest.param(*levels, marks=pytest.mark.statistical) for levels in ((0.3, 0.0), (0.5, 0.1))),
    ],
)
def test_white_noise_is_measured(white, drift):
    sequence = long_drive(pixel_sigma_px=white, drift_px=drift, matching_bias_px=0.4)
    finding, _ = check_pixel_noise(sequence, fits_of(sequence), pixel_sigma_px=1.0, drift_px=0.0)
    measured = finding.measured[0]
    assert abs(measured.value - white) < max(0.15 * white, 4.0 * measured.sigma)
    assert finding.settings["noise.pixel_sigma_px"] == pytest.approx(measured.value, abs=1e-4)


def test_a_pure_drift_is_not_taken_for_white_noise():
    sequence = long_drive(pixel_sigma_px=0.02, drift_px=0.3)
    finding, _ = check_pixel_noise(sequence, fits_of(sequence), pixel_sigma_px=1.0, drift_px=0.0)
    assert finding.measured[0].low < 0.05
    assert finding.measured[1].value == pytest.approx(0.3, rel=0.25)
    assert finding.settings["noise.pixel_sigma_px"] < finding.settings["noise.drift_px"] + 1e-3
    # The whole of a step is written, and nothing less.
    assert np.hypot(*finding.settings.values()) >= 0.29


@pytest.mark.parametrize("match", [0.4, pytest.param(0.8, marks=pytest.mark.statistical)])
def test_the_matching_bias_is_measured(match):
    sequence = long_drive(matching_bias_px=match, frames=250)
    finding = check_match(sequence, fits_of(sequence), matching_bias_px=0.0)
    assert finding.settings["noise.matching_bias_px"] == pytest.approx(match, rel=0.25)


def test_no_matching_bias_is_none():
    sequence = long_drive(matching_bias_px=0.0)
    finding = check_match(sequence, fits_of(sequence), matching_bias_px=0.3)
    measured = finding.measured[0]
    assert measured.low <= 0.0 or measured.value < 0.1


READINGS = [("stored", "stored"), ("stored", "inverse"), ("inverse", "stored"), ("inverse", "inverse")]


@pytest.mark.slow
@pytest.mark.parametrize(("rotation", "translation"), READINGS)
def test_a_mixed_extrinsic_is_read_right(rotation, translation):
    """The file holds what each reading turns into the true mounting."""
    sequence = long_drive(frames=300, pixel_sigma_px=0.1, rig={"pitch_deg": 9.0})
    true = sequence.rig.imu_T_cam
    inverse = se3.inverse(true)
    # Read as `inverse`, a part is that of the inverse of the whole stored matrix.
    turn = inverse[:3, :3] if rotation == "inverse" else true[:3, :3]
    place = -turn @ true[:3, 3] if translation == "inverse" else true[:3, 3]
    stored = se3.from_rotation_translation(turn, place)
    spoilt = replace(sequence, rig=replace(sequence.rig, imu_T_cam=stored))
    read = Extrinsic(rotation=rotation, translation=translation).apply(spoilt)
    assert np.allclose(read.rig.imu_T_cam, true, atol=1e-12)
    mount, reading, _ = check_mounting(spoilt, RepairConfig())
    assert (reading.axes, reading.rotation) == (("x", "y", "z"), rotation), mount.text
    _, reading = check_lever_arm(spoilt, read, fits_of(read), reading)
    assert reading.translation == translation


def test_readings_that_differ_by_a_degree_are_unclear():
    """The inverse of a camera that looks ahead, with axes turned about, is nearly the camera itself."""
    sequence = long_drive(rig={"pitch_deg": 0.5}, gyro_sigma=0.05, velocity_sigma=0.5)
    finding, reading, _ = check_mounting(sequence, RepairConfig())
    assert finding.verdict == "unclear"
    assert "not told from [-y, -z, x] rotation inverse" in finding.text
    assert reading == Candidate(("x", "y", "z"), "stored", "stored")
    assert {"data.repair.axes", "data.repair.extrinsic"} == set(finding.unknown)


@pytest.mark.parametrize("factor", [50.0, 1e3])
def test_no_mounting_is_ok_that_predicts_nothing(factor):
    sequence = long_drive(frames=60)
    wild = replace(sequence, twist=sequence.twist * factor)
    finding, _, _ = check_mounting(wild, RepairConfig())
    assert finding.verdict == "fault"
    assert "no reading of axes and extrinsic predicts the tracks" in finding.text
    assert finding.proposal == {}


def test_a_camera_at_rest_does_not_tell_the_mounting():
    sequence = long_drive(frames=60)
    still = replace(sequence, pixels=sequence.pixels[sequence.first_rows()], twist=0.01 * sequence.twist)
    finding, _, _ = check_mounting(still, RepairConfig())
    assert finding.verdict == "unclear"


@pytest.mark.parametrize("rig", ["car", "hand-held"])
def test_the_mounting_of_any_rig_is_told(rig):
    sequence = SingleObservations().apply(drive(rig, frames=80))
    finding, _, _ = check_mounting(sequence, RepairConfig())
    assert finding.counts["best_px"] < 3.0


# A bias of the third component goes with it where that is read as the vertical velocity.
@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1])
def test_a_velocity_bias_beyond_the_prior_is_a_fault(axis):
    bias = [0.0, 0.0, 0.0]
    bias[axis] = 1.2
    sequence = long_drive(frames=300, velocity_bias=tuple(bias), speed=6.0, pixel_sigma_px=0.1)
    finding = inspected(sequence).finding("biases")
    assert finding.verdict == "fault", finding.text
    assert f"velocity bias {'xyz'[axis]}" in finding.text.split(" beyond")[0]
    assert finding.proposal["noise.bias_mean"][3 + axis] == pytest.approx(1.2, abs=0.4)


@pytest.mark.slow
def test_a_camera_scale_is_no_velocity_bias():
    sequence = long_drive(frames=300)
    scaled = replace(sequence, rig=replace(sequence.rig, baseline=1.03 * sequence.rig.baseline))
    result = inspected(scaled)
    assert result.finding("biases").verdict == "ok"
    assert result.settings["noise.bias_mean"][3] == 0.0


@pytest.mark.slow
def test_what_is_measured_is_what_a_config_gets():
    result = inspected(long_drive(frames=250, matching_bias_px=0.5, gyro_bias=(0.01, -0.008, 0.012)))
    assert {"noise.pixel_sigma_px", "noise.drift_px", "noise.matching_bias_px"} <= set(result.settings)
    merged = {**result.settings, **result.proposal}
    assert len(merged["noise.twist_density"]) == 6
    assert all(value > 0 for value in merged["noise.twist_density"])
    assert np.allclose(merged["noise.bias_mean"][:3], (0.01, -0.008, 0.012), atol=0.003)
    assert max(merged["noise.bias_sigma"][:3]) < 0.02


@pytest.mark.parametrize("tracks", [1.0, 4.0])
def test_few_tracks_are_the_headline_and_the_rest_is_unknown(tracks):
    settings = SimulationConfig(frames=60, tracks_in_view=tracks, navigation_frame_velocity=True)
    result = inspected(simulate(settings, seed=2, name="s")[0])
    assert result.findings[0].check == "tracks"
    assert result.findings[0].verdict in ("fault", "unclear")
    assert result.findings[0].text.startswith("few tracks")
    assert {"data.repair.axes", "data.repair.clock", "noise.bias_sigma", "noise.matching_bias_px"} <= set(
        result.unknown
    )
    assert result.settings["data.repair.navigation_frame_velocity"] is True


def test_a_third_component_as_large_as_the_speed_is_left_alone():
    settings = SimulationConfig(frames=60, tracks_in_view=3, **RIGS["car"])
    sequence = simulate(settings, seed=2, name="s")[0]
    twist = sequence.twist.copy()
    twist[:, 5] = twist[:, 3] * np.sin(sequence.inertial_stamp)
    result = inspected(replace(sequence, twist=twist))
    assert "data.repair.navigation_frame_velocity" not in result.settings
    assert "data.repair.navigation_frame_velocity" in result.unknown
