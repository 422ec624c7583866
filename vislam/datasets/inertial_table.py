"""A table of inertial samples, put in order and into the clock of the images."""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.images import Inertia
from vislam.datasets.calibration_yaml import Camchain
from vislam.datasets.checks import LARGEST_FORCE, LARGEST_TWIST, Checks
from vislam.datasets.image_lists import NANOSECONDS

_FEWEST = 2


def inertia_of(table: Array, chain: Camchain | None, *, where: Path) -> tuple[Inertia | None, dict[str, int]]:
    """Samples in the order of their stamps, one a stamp, and what was counted.

    Parameters
    ----------
    table : (S, 7)
        Stamp [ns], angular velocity [rad/s], specific force [m/s^2].
    chain : Camchain or None
        Calibration, which has the shift of the clock; None: there is no shift.
    where : Path
        For the message.

    Returns
    -------
    inertia : Inertia or None
        None if the calibration does not say how the sensor sits.
    counts : dict

    Raises
    ------
    DataError
        If there are fewer than two samples, or no sensor can measure them.
    """
    stamp, first = np.unique(table[:, 0], return_index=True)
    if len(stamp) < _FEWEST:
        raise DataError(f"{where}: must have {_FEWEST} samples or more, got {len(stamp)}")
    if chain is not None and not chain.mounted:
        return None, {"inertial_samples_without_mounting": len(stamp)}
    counts = {
        "inertial_samples": len(stamp),
        "inertial_duplicates": len(table) - len(stamp),
        "inertial_out_of_order": int(np.sum(np.diff(table[:, 0]) < 0)),
    }
    at = stamp * NANOSECONDS - (0.0 if chain is None else chain.shift)
    gyro, accelerometer = possible(table[first, 1:4], table[first, 4:7], where=where)
    return Inertia(at, gyro, accelerometer=accelerometer), counts


def possible(gyro: Array, accelerometer: Array, *, where: Path) -> tuple[Array, Array]:
    """Samples ``(S, 3)`` each [rad/s, m/s^2] as they are; DataError if no sensor can measure them."""
    checks = Checks(where)
    return (
        checks.numbers("gyro", gyro, largest=LARGEST_TWIST, unit="rad/s"),
        checks.numbers("accelerometer", accelerometer, largest=LARGEST_FORCE, unit="m/s^2"),
    )
