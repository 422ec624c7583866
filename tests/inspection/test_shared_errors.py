"""Each parameter that all tracks share planted in a simulated drive: found within its interval, or none."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.core.shared_fit import pooled
from vislam.core.shared_residuals import SHARED, shared_residuals
from vislam.geometry import se3, so3
from vislam.inspection.shared_errors import check_shared_errors, judge
from vislam.models.odometry import ACROSS
from vislam.repair.pixels import Disparity
from vislam.simulation import SimulationConfig, simulate

CLEAN = SimulationConfig(
    frames=120,
    tracks_in_view=60,
    path="town",
    pixel_sigma_px=0.15,
    drift_px=0.1,
    matching_bias_px=0.3,
    gyro_sigma=0.002,
    velocity_sigma=0.02,
)
DENSITY = (8e-4, 8e-4, 8e-4, 8e-3, 8e-3, 8e-3)
PRIOR = {"bias_mean": (0.0,) * 6, "bias_sigma": (0.02, 0.02, 0.02, 0.05, 0.02, 0.02)}
PLANTED = {
    "camera_rotation": np.array([0.012, -0.015, 0.012]),
    "disparity_offset": np.array([0.4]),
    "principal_point": np.array([8.0, -8.0]),
    "focal_scale": np.array([0.03]),
    "baseline_scale": np.array([0.06]),
    "clock": np.array([0.04]),
    "velocity_direction": np.array([0.02, -0.015]),
}


def planted(sequence, name, value):
    """A sequence whose rig, clock or twist is stated wrongly, so that the parameter has this value."""
    if name == "disparity_offset":
        return replace(sequence, pixels=sequence.pixels - value * np.array([0.0, 0.0, 1.0, 0.0]))
    if name == "clock":
        return replace(sequence, clock_offset=sequence.clock_offset - float(value[0]))
    if name == "velocity_direction":
        return replace(sequence, twist=sequence.twist + sequence.twist[:, 3:4] * (ACROSS @ value))
    return replace(sequence, rig=replace(sequence.rig, **stated(sequence.rig, name, value)))


def stated(rig, name, value):
    """What is wrong in a rig that lacks this value."""
    if name == "camera_rotation":
        turn = se3.from_rotation_translation(so3.exp(-value), np.zeros(3))
        return {"imu_T_cam": turn @ rig.imu_T_cam}
    if name == "principal_point":
        return {"cx": rig.cx - value[0], "cy": rig.cy - value[1]}
    scale = 1.0 + float(value[0])
    if name == "focal_scale":
        return {"fx": rig.fx / scale, "fy": rig.fy / scale}
    return {"baseline": rig.baseline / scale}


@pytest.fixture(scope="module")
def clean():
    return Disparity().apply(simulate(CLEAN, seed=3, name="planted")[0])


@pytest.fixture(scope="module")
def fits(clean):
    return rigid_fits(clean, continuations(clean))


def fitted(sequence, fits):
    """Pooled fit, whose robust weights may start from those of another stated rig."""
    return pooled(
        shared_residuals(sequence, fits),
        dt=np.diff(sequence.stamp, prepend=sequence.stamp[0]),
        density=np.array(DENSITY),
        bias_mean=np.zeros(6),
        bias_sigma=np.array(PRIOR["bias_sigma"]),
    )


def test_where_none_is_planted_none_is_found(clean, fits):
    judged, together = judge(fitted(clean, fits))
    assert [item.name for item in judged if item.verdict == "found"] == []
    assert together.by_found == 0.0
    assert together.explained < 0.02


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_error_is_found_within_its_interval(clean, fits, name):
    assert_found(fitted(planted(clean, name, PLANTED[name]), fits), name)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_an_error_that_spoils_the_frames_own_fits_is_found_too(clean, name):
    sequence = planted(clean, name, PLANTED[name])
    assert_found(fitted(sequence, rigid_fits(sequence, continuations(sequence))), name)


def assert_found(fit, name):
    judged, together = judge(fit)
    item = next(item for item in judged if item.name == name)
    words = {one.name: one.name.replace("_", " ") for one in judged}
    alike = {other for pair in together.alike for other in pair[:2] if words[name] in " ".join(pair[:2])}
    found = [one.name for one in judged if one.verdict == "found"]
    assert found
    assert all(one == name or any(words[one] in other for other in alike) for one in found), (found, alike)
    if item.verdict == "found":
        error = [
            (one.value - true) / one.sigma for one, true in zip(item.measured, PLANTED[name], strict=True)
        ]
        assert np.max(np.abs(error)) < 3.5, error


@pytest.mark.parametrize("name", PLANTED)
def test_derivatives_are_those_of_finite_differences(clean, name):
    short = clean.first(6)
    fits = rigid_fits(short, continuations(short))
    found = shared_residuals(short, fits)
    first = sum(len(SHARED[item]) for item in list(SHARED)[: list(SHARED).index(name)])
    for axis in range(len(PLANTED[name])):
        small = np.zeros(len(PLANTED[name]))
        small[axis] = 1e-4 * PLANTED[name].max()
        # Stated with the parameter at plus and at minus: the residual of a true value differs by twice it.
        above, below = (
            shared_residuals(planted(short, name, sign * small), fits).residual for sign in (1.0, -1.0)
        )
        numeric = (above - below) / (2.0 * small[axis])
        analytic = found.by_shared[:, :, first + axis]
        assert np.allclose(analytic, numeric, rtol=2e-3, atol=2e-3 * np.abs(numeric).max())


def test_the_finding_is_a_fault_until_its_prior_holds_it(clean, fits):
    sequence = planted(clean, "clock", PLANTED["clock"])
    finding, series = check_shared_errors(sequence, fits, density=DENSITY, priors={}, **PRIOR)
    assert finding.verdict == "fault"
    assert finding.proposal == {}
    assert set(finding.unknown) == {"noise.clock_sigma"}
    held, _ = check_shared_errors(sequence, fits, density=DENSITY, priors={"clock_sigma": 0.04}, **PRIOR)
    assert held.verdict == "ok"
    assert "FOUND" in finding.text
    assert series["shared_at"].shape == (6, 8)
    assert np.all(series["shared_recorded"][..., 1] <= series["shared_recorded"][..., 2])


def test_a_recording_of_two_steps_is_no_crash(clean):
    short = clean.first(3)
    fits = rigid_fits(short, continuations(short))
    finding, _ = check_shared_errors(short, fits, density=DENSITY, priors={}, **PRIOR)
    assert finding.verdict == "unclear"
