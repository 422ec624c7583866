"""The EKF SLAM of the report's section III-D and its family: small at each step, exact for each landmark."""

from vislam.estimators.ekf.family import VARIANTS, build
from vislam.estimators.ekf.filter import EkfEstimator
from vislam.estimators.ekf.options import EkfOptions

__all__ = ["VARIANTS", "EkfEstimator", "EkfOptions", "build"]
