"""The filters whose consistency is measured, by name."""

from collections.abc import Mapping
from typing import Any

from vislam.estimators.ekf import MEMBERS

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    **MEMBERS,
    "ekf, disparity": {**MEMBERS["ekf"], "landmarks": "disparity"},
    "ekf_fej, point": {**MEMBERS["ekf_fej"], "landmarks": "point"},
    "ekf_invariant, point": {**MEMBERS["ekf_invariant"], "landmarks": "point"},
    "eks, standard, point": {**MEMBERS["eks"], "error": "standard", "landmarks": "point"},
}
"""Options of each: the members as they are, and with the other coordinates of landmarks."""


def of_disparity(name: str) -> bool:
    """Whether a variant's landmarks are disparities."""
    return VARIANTS.get(name, {}).get("landmarks") == "disparity"
