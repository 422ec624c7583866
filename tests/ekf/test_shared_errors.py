"""Errors that all tracks share, as states of the filters: planted, and found as surely as is claimed."""

from dataclasses import replace

import numpy as np
import pytest

from tests.shared_errors import SIGMA, every_shared_error
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import DataConfig, NoiseConfig, SharedWalkConfig
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.models.shared_errors import SIZES, CameraErrors
from vislam.simulation import simulate
from vislam.simulation.drive import stereo_rig

PLANTED = {
    "camera_rotation": (0.003, -0.002, 0.004),
    "disparity_offset_px": -0.3,
    "principal_point_px": (2.5, -1.5),
    "focal_scale": 0.003,
    "clock_offset": 0.02,
    "velocity_direction": (0.004, -0.006),
}
ROOT = np.sqrt(0.1046)


def planted(short_config, *, frames, **more):
    """A drive with all of them, noise as it is taken to be, and its config."""
    simulation = replace(
        short_config.data.simulation,
        **{
            "frames": frames,
            "duplication_probability": 0.0,
            "drift_px": 0.0,
            "matching_bias_px": 0.0,
            **PLANTED,
            **more,
        },
        gyro_sigma=2e-4,
        velocity_sigma=2e-3,
    )
    noise = {
        "drift_px": 0.0,
        "matching_bias_px": 0.0,
        "twist_density": (2e-4 * ROOT,) * 3 + (2e-3 * ROOT,) * 3,
    }
    config = replace(
        short_config,
        data=DataConfig(simulation=simulation, repair=short_config.data.repair),
        noise=replace(short_config.noise, **noise, **every_shared_error()),
    )
    return config, open_dataset(config.data, seed=5)


def estimated(name, config, dataset, **options):
    found = run(
        find(name)(make_problem(config, dataset), {"gate": False, **options}),
        dataset.sequence,
        pixel_sigma(config, dataset),
        name=name,
    )
    assert found.complete, found.log.error
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf_fej", "ekf_invariant", "msckf"])
def test_all_of_them_are_found_at_once(short_config, name):
    config, dataset = planted(short_config, frames=150, tracks_in_view=40)
    found = estimated(name, config, dataset)
    _, truth = simulate(config.data.simulation, seed=5, name="simulation")
    for key, true in truth.shared.items():
        history = found.states[key]
        error, sigma = history.value[-1] - true, history.sigma[-1]
        assert (np.abs(error) < 4.0 * sigma).all(), key
        assert (sigma < SIGMA[key]).all(), key
    # About the axis of travel nothing else looks like it; the other two pass for a direction of the velocity.
    assert found.states["camera_rotation"].sigma[-1][0] < 0.3 * SIGMA["camera_rotation"]


@pytest.mark.slow
def test_the_standard_form_is_sure_of_a_rotation_that_is_not_there(short_config):
    """The information that it gains of where the world is becomes one of how the cameras are mounted."""
    config, dataset = planted(short_config, frames=150, tracks_in_view=40)
    _, truth = simulate(config.data.simulation, seed=5, name="simulation")
    last = {name: estimated(name, config, dataset).states["camera_rotation"] for name in ("ekf", "ekf_fej")}
    off = {name: np.abs(one.value[-1] - truth.shared["camera_rotation"]) for name, one in last.items()}
    assert last["ekf"].sigma[-1][2] < 0.5 * last["ekf_fej"].sigma[-1][2]
    assert off["ekf"][2] > 4.0 * last["ekf"].sigma[-1][2]
    assert off["ekf_fej"][2] < off["ekf"][2]


def test_what_is_known_is_no_state(short, short_config):
    found = estimated("ekf_invariant", short_config, short)
    assert list(found.states) == ["twist_bias"]


def test_each_is_a_state_of_its_own_with_its_prior(short, short_config):
    config = replace(short_config, noise=replace(short_config.noise, **every_shared_error()))
    found = estimated("ekf_invariant", config, short)
    for name, size in SIZES.items():
        assert found.states[name].value.shape == (25, size)
        assert (found.states[name].sigma[-1] <= SIGMA[name]).all()


def test_a_walk_forgets(short, short_config):
    """The slower a shared error may walk, the surer it is in the end."""
    sigma = []
    for walk in (0.0, 0.1, 1.0):
        config = replace(short_config, noise=replace(short_config.noise, **every_shared_error(walk)))
        sigma.append(np.concatenate([s.sigma[-1] for s in estimated("ekf", config, short).states.values()]))
    assert (sigma[0][6:] < sigma[1][6:]).all()
    assert (sigma[1][6:] < sigma[2][6:]).all()


def test_estimators_say_what_they_estimate(short, short_config):
    noise = replace(short_config.noise, camera_rotation_sigma=3e-3, shared_walk=SharedWalkConfig())
    problem = make_problem(replace(short_config, noise=noise), short)
    said = {name: find(name)(problem, {}).information for name in ("eks", "msckf")}
    assert {text["camera rotation"] for text in said.values()} == {"estimated"}
    walking = replace(problem, shared_walk={"camera_rotation": 1e-5})
    assert find("eks")(walking, {}).information["camera rotation"] == "estimated, walking"
    assert "walk of shared errors" in find("msckf")(walking, {}).information


def test_what_is_known_cannot_walk():
    with pytest.raises(ValueError, match=r"shared_walk\.principal_point: principal_point_sigma_px is 0"):
        NoiseConfig(shared_walk=SharedWalkConfig(principal_point=0.1))


def test_observations_mended_are_those_of_the_stated_rig(short_config, rng):
    rig = stereo_rig(short_config.data.simulation)
    errors = CameraErrors(np.zeros(3), 0.4, np.array([2.0, -3.0]), 0.01)
    points = np.column_stack([rng.uniform(-5, 5, (9, 2)), rng.uniform(6, 30, 9)])
    z = errors.rig(rig).project(points) + errors.offset
    assert np.allclose(errors.mended(z, rig), rig.project(points), atol=1e-9)


def test_the_seed_adds_to_what_is_planted_and_changes_nothing_else(short_config):
    settings = short_config.data.simulation
    plain, _ = simulate(settings, seed=3, name="simulation")
    drawn = replace(settings, clock_sigma=1e-9, camera_rotation_sigma=1e-12, disparity_offset_sigma_px=1e-9)
    near, truth = simulate(drawn, seed=3, name="simulation")
    assert np.allclose(near.pixels, plain.pixels, atol=1e-6)
    assert np.allclose(near.twist, plain.twist, atol=1e-6)
    assert truth.shared["camera_rotation"].all()
    assert not truth.shared["focal_scale"].any()
