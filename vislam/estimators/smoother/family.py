"""The variants of the smoother: one name each, the same smoother with other options."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from vislam.base import settings
from vislam.base.errors import ConfigError
from vislam.core.estimator import Problem
from vislam.estimators.former import current
from vislam.estimators.smoother.incremental import SmootherEstimator
from vislam.estimators.smoother.options import SmootherOptions
from vislam.models import shared_errors

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "isam2": {},
    # The textbook's pose graph: with the bias, which is of the order of the drift, assumed known.
    "isam2_between": {"motion": "between"},
    "isam2_norelin": {"relinearize_every": 0, "final": "as_is"},
    # What is relinearised beside a marginal, which is not, makes the whole window jump, far from the start by
    # metres. And what leaves the lag is read for the last time, so it is solved to the end: a change that is
    # left alone as small would stay.
    "fixed_lag": {"lag_s": 3.0, "relinearize_every": 0, "wildfire_threshold": 0.0},
    "batch": {"final": "batch", "final_iterations": 10},
    "batch_gnc": {"final": "gnc", "final_iterations": 10},
}
"""What each variant sets; its config section may set the rest, or these again."""


_BETWEEN_LACKS: Mapping[str, Callable[[Problem], bool]] = {
    "clock_sigma to 0": lambda problem: problem.clock_sigma > 0.0,
    "velocity_direction_sigma to 0": lambda problem: problem.velocity_direction_sigma > 0.0,
    "acceleration_density to null": lambda problem: problem.noise.acceleration is not None,
}
"""What motion: between has no variables for, each by its remedy."""


def _variant(name: str, problem: Problem, options: Mapping[str, Any]) -> SmootherEstimator:
    """Build a variant from a problem and the options of its config section."""
    at = f"estimators.{name}"
    parsed = settings.parse(SmootherOptions, {**VARIANTS[name], **current(options, at=at)}, at=at)
    lacking = [name for name in shared_errors.OF_CAMERA if name in problem.shared()]
    if lacking:
        raise ConfigError(
            f"estimators.{name}: GTSAM's stereo factor has no {lacking[0].replace('_', ' ')} as a variable; "
            f"set noise.{shared_errors.prior_name(lacking[0])} to 0, or compare filters only"
        )
    if problem.imu is not None and parsed.motion == "between":
        raise ConfigError(
            f"estimators.{name}: motion: between is a step of the recorded twist, and the motion of the "
            "comparison is imu; leave the run out"
        )
    asked = [name for name, wanted in _BETWEEN_LACKS.items() if wanted(problem)]
    if parsed.motion == "between" and asked:
        raise ConfigError(
            f"estimators.{name}: motion: between has no variables but poses, landmarks and heights; "
            f"set noise.{asked[0]}, or motion to bias"
        )
    return SmootherEstimator(problem, parsed)


build_isam2 = partial(_variant, "isam2")
build_between = partial(_variant, "isam2_between")
build_norelin = partial(_variant, "isam2_norelin")
build_fixed_lag = partial(_variant, "fixed_lag")
build_batch = partial(_variant, "batch")
build_gnc = partial(_variant, "batch_gnc")
