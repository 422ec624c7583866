"""The members of the filter family: one name each, all the same filter with other options."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from vislam.base import settings
from vislam.core.estimator import Problem
from vislam.estimators.ekf.filter import EkfEstimator
from vislam.estimators.ekf.options import EkfOptions
from vislam.estimators.former import refuse_former

MEMBERS: Mapping[str, Mapping[str, Any]] = {
    "ekf": {},
    "ekf_track_states": {"track_errors": "states"},
    "ekf_iterated": {"iterations": 5},
    "ekf_fej": {"error": "first_estimates", "landmarks": "disparity"},
    "ekf_invariant": {"error": "invariant", "landmarks": "disparity"},
    "eks": {"error": "invariant", "landmarks": "disparity", "smoothed": True},
}
"""What each member sets; its config section may set the rest, or these again."""


def _member(name: str, problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build a member from a problem and the options of its config section."""
    refuse_former(options, at=f"estimators.{name}")
    return EkfEstimator(
        problem, settings.parse(EkfOptions, {**MEMBERS[name], **options}, at=f"estimators.{name}")
    )


build = partial(_member, "ekf")
build_track_states = partial(_member, "ekf_track_states")
build_iterated = partial(_member, "ekf_iterated")
build_fej = partial(_member, "ekf_fej")
build_invariant = partial(_member, "ekf_invariant")
build_smoother = partial(_member, "eks")
