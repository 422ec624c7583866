"""The covariance of a first state is that of its errors, over many short drives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.initialisation.standing import CAR, NOISE, ROOM, error_of, moving, standing
from vislam.initialisation import InitialisationSettings, NotFoundError, initialise
from vislam.initialisation.found import ACCEL, GYRO, SPEED, TILT

DRIVES = 20
CHANCE = 1e-3
TOO_MUCH = 10.0
"""A covariance that is too large, or too small, by this factor is told."""
SETTINGS = InitialisationSettings()


def with_drawn_biases(config):
    """Biases that are drawn from the prior which the initialisation has of them."""
    drawn = {name: getattr(SETTINGS, name) for name in ("gyro_bias_sigma", "accel_bias_sigma")}
    return replace(config, imu=replace(config.imu, **drawn))


def at_rest(seed):
    return standing(seed, rest=1.5, config=with_drawn_biases(ROOM))


def in_a_room(seed):
    return moving(seed, with_drawn_biases(ROOM))


def in_a_car(seed):
    return moving(seed, with_drawn_biases(CAR))


def first_states(drive):
    """Errors ``(n, 11)`` and covariances ``(n, 11, 11)``, and methods, where the data tell the state."""
    errors, covariances, methods = [], [], set()
    for seed in range(DRIVES):
        sequence, truth = drive(seed)
        try:
            found = initialise(sequence, NOISE)
        except NotFoundError:
            continue
        errors.append(error_of(found, truth))
        covariances.append(found.cov)
        methods.add(found.method)
    return np.array(errors), np.array(covariances), methods


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("drive", "method", "parts"),
    [
        # The velocity of a body at rest is zero: its sigma is a limit of what the tracks could tell.
        (at_rest, "static", {"tilt": TILT, "gyro": GYRO, "accel": ACCEL}),
        (in_a_room, "dynamic", {"tilt": TILT, "velocity": SPEED, "gyro": GYRO, "accel": ACCEL}),
        (in_a_car, "dynamic", {"tilt": TILT, "velocity": SPEED, "gyro": GYRO, "accel": ACCEL}),
    ],
)
def test_errors_are_as_large_as_they_are_said_to_be(drive, method, parts):
    errors, covariances, methods = first_states(drive)
    assert methods == {method}
    assert len(errors) >= 0.9 * DRIVES
    for name, part in parts.items():
        error, cov = errors[:, part], covariances[:, part, part]
        nees = float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error)) / error.shape[1])
        most = chi2.ppf(1.0 - CHANCE, error.size) / error.size
        # What an honest covariance, TOO_MUCH times as large, has at most.
        least = most / TOO_MUCH
        assert least < nees < most, name
        assert nees / TOO_MUCH < least, name
        assert nees * TOO_MUCH > most, name
