"""Priors of the errors that all tracks share, for tests of those who estimate them."""

from typing import Any

from vislam.comparison.config import SharedWalkConfig
from vislam.models.shared_errors import SIZES, prior_name

SIGMA = {
    "camera_rotation": 3e-3,
    "disparity_offset": 0.3,
    "principal_point": 2.0,
    "focal_scale": 2e-3,
    "clock": 0.02,
    "velocity_direction": 5e-3,
}
"""Prior standard deviations."""


def every_shared_error(walk: float = 0.0) -> dict[str, Any]:
    """Settings of the noise with all of them, which walk by a share of their prior [1/sqrt(s)]."""
    densities = {name: walk * sigma for name, sigma in SIGMA.items()}
    priors = {prior_name(name): SIGMA[name] for name in SIZES}
    return {**priors, "shared_walk": SharedWalkConfig(**densities)}
