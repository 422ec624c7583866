"""The factor by which inertia is noisier than stated, and what estimators are given of a first state."""

from dataclasses import replace

import numpy as np
import pytest

from tests.initialisation.standing import NOISE, ROOM, moving, standing
from vislam.core.imu import ImuSeries
from vislam.initialisation import InitialisationSettings, NotFoundError, initialise, noise_factor, scaled

LONG = replace(ROOM, frames=52)


def noisier(factor):
    """A drive with so many times the white noise that is stated."""
    imu = ROOM.imu
    densities = {name: factor * getattr(imu, name) for name in ("gyro_density", "accel_density")}
    return moving(100, replace(LONG, imu=replace(imu, **densities)))[0]


def test_noise_as_stated_stays():
    assert noise_factor(noisier(1.0), NOISE) == 1.0


@pytest.mark.parametrize("planted", [4.0, pytest.param(16.0, marks=pytest.mark.statistical)])
def test_a_planted_inflation_is_found(planted):
    found = noise_factor(noisier(planted), NOISE)
    assert planted / 1.5 < found < planted * 1.5


def test_the_walks_of_the_biases_are_not_scaled():
    found = scaled(NOISE, 3.0)
    assert (found.gyro_density, found.accel_density) == (3 * NOISE.gyro_density, 3 * NOISE.accel_density)
    assert (found.gyro_walk, found.accel_walk, found.gravity) == (
        NOISE.gyro_walk,
        NOISE.accel_walk,
        NOISE.gravity,
    )


def test_estimators_are_given_less_than_the_data_say():
    settings = InitialisationSettings()
    found = initialise(moving(1)[0], NOISE)
    cov = found.as_prior(settings).cov[6:, 6:]
    eigenvalues = np.linalg.eigvals(np.linalg.solve(found.cov[2:, 2:], cov)).real
    assert eigenvalues.min() > 1.0
    assert eigenvalues.max() < settings.widened**2 * (1.0 + 1e-9)


UNITS = {
    "g, divide by 0.102": 1.0 / 9.80665,
    "cm/s^2 or mg, divide by 100 or 102": 100.0,
    "mm/s^2, divide by 1000": 1000.0,
}
"""What is told, by what 1 m/s^2 is."""


def changed(sequence, *, accel=1.0, gyro=1.0):
    imu = sequence.imu
    return replace(sequence, imu=ImuSeries(imu.stamp, gyro * imu.gyro, accel * imu.accel))


@pytest.mark.parametrize("said", list(UNITS))
@pytest.mark.parametrize("rest", [0.0, 1.5])
def test_units_of_the_force_are_named(rest, said):
    sequence, _ = standing(2, rest=rest) if rest else moving(2)
    with pytest.raises(NotFoundError) as caught:
        initialise(changed(sequence, accel=UNITS[said]), NOISE)
    assert f"it looks like {said}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rest", [0.0, 1.5])
def test_rates_in_degrees_are_named(rest):
    sequence, _ = standing(2, rest=rest, config=LONG) if rest else moving(2, LONG)
    assert initialise(sequence, NOISE).method == ("static" if rest else "dynamic")
    with pytest.raises(NotFoundError, match="it looks like deg/s"):
        initialise(changed(sequence, gyro=180.0 / np.pi), NOISE)
