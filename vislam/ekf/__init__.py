"""The EKF SLAM of the report's section III-D, with a bias state and landmarks only while tracked."""

from vislam.ekf.filter import EkfEstimator, EkfOptions, build

__all__ = ["EkfEstimator", "EkfOptions", "build"]
