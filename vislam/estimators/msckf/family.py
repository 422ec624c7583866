"""How the multi-state constraint Kalman filter is built from a config's section."""

from collections.abc import Mapping
from typing import Any

from vislam.base import settings
from vislam.core.estimator import Problem
from vislam.estimators.former import current
from vislam.estimators.msckf.filter import MsckfEstimator
from vislam.estimators.msckf.options import MsckfOptions


def build(problem: Problem, options: Mapping[str, Any]) -> MsckfEstimator:
    """Build it from a problem and the options of its config section."""
    at = "estimators.msckf"
    return MsckfEstimator(problem, settings.parse(MsckfOptions, current(options, at=at), at=at))
