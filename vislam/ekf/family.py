"""The members of the filter family: one name each, all the same filter with other options."""

from collections.abc import Mapping
from typing import Any

from vislam import config
from vislam.ekf.filter import EkfEstimator
from vislam.ekf.options import EkfOptions
from vislam.estimator import Problem

MEMBERS: Mapping[str, Mapping[str, Any]] = {
    "ekf": {},
    "ekf_iterated": {"iterations": 5},
    "ekf_fej": {"error": "first_estimates", "landmarks": "disparity"},
    "ekf_invariant": {"error": "invariant", "landmarks": "disparity"},
    "eks": {"error": "invariant", "landmarks": "disparity", "smoothed": True},
}
"""What each member sets; its config section may set the rest, or these again."""


def _member(name: str, problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    return EkfEstimator(
        problem, config.parse(EkfOptions, {**MEMBERS[name], **options}, at=f"estimators.{name}")
    )


def build(problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build the standard filter from a problem and the options of its config section."""
    return _member("ekf", problem, options)


def build_iterated(problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build the filter whose updates are Gauss-Newton iterations."""
    return _member("ekf_iterated", problem, options)


def build_fej(problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build the filter with Jacobians at first estimates."""
    return _member("ekf_fej", problem, options)


def build_invariant(problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build the filter with the right-invariant error."""
    return _member("ekf_invariant", problem, options)


def build_smoother(problem: Problem, options: Mapping[str, Any]) -> EkfEstimator:
    """Build the invariant filter whose poses are smoothed in the end."""
    return _member("eks", problem, options)
