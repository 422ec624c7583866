"""The variants of the filter: one name each, the same filter with other options."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from vislam.base import settings
from vislam.core.estimator import Problem
from vislam.estimators.ekf.filter import EkfEstimator
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.former import current

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "ekf": {},
    "ekf_track_states": {"track_errors": "states"},
    "ekf_iterated": {"iterations": 5},
    "ekf_fej": {"error": "fej", "landmarks": "anchored_uvd"},
    "ekf_invariant": {"error": "invariant", "landmarks": "anchored_uvd"},
    "eks": {"error": "invariant", "landmarks": "anchored_uvd", "smoothed": True},
}
"""What each variant sets; its config section may set the rest, or these again."""


def _variant(name: str, problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build a variant from a problem and the options of its config section."""
    at = f"estimators.{name}"
    return EkfEstimator(
        problem, settings.parse(EkfOptions, {**VARIANTS[name], **current(options, at=at)}, at=at)
    )


build = partial(_variant, "ekf")
build_track_states = partial(_variant, "ekf_track_states")
build_iterated = partial(_variant, "ekf_iterated")
build_fej = partial(_variant, "ekf_fej")
build_invariant = partial(_variant, "ekf_invariant")
build_smoother = partial(_variant, "eks")
