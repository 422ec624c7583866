"""The multi-state constraint Kalman filter: a window of poses, and no landmark in the state."""

from vislam.estimators.msckf.family import build
from vislam.estimators.msckf.filter import MsckfEstimator
from vislam.estimators.msckf.options import MsckfOptions

__all__ = ["MsckfEstimator", "MsckfOptions", "build"]
