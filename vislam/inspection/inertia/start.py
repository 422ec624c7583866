"""The first state of raw inertia: whether the data tell it, and how it is found."""

from typing import Any

from vislam.core.sequence import Sequence
from vislam.initialisation import NotFoundError, initialise
from vislam.inspection.finding import Finding
from vislam.models.imu import ImuNoise


def check_start(sequence: Sequence, noise: ImuNoise, *, alone: bool) -> Finding:
    """Search the first state, as a comparison does.

    Parameters
    ----------
    sequence : Sequence
        Mended as the checks before propose.
    noise : ImuNoise
    alone : bool
        Whether no velocity is recorded beside the samples, which are then what predicts the motion.
    """
    try:
        found = initialise(sequence, noise)
    except NotFoundError as why:
        text = f"attitude, velocity and biases of the first frame are not told: {why}"
        return Finding("imu first state", "unclear", text, unknown={"motion": text} if alone else {})
    settings: dict[str, Any] = {"motion": "imu"} if alone else {}
    return Finding("imu first state", "ok", found.account, settings=settings)
