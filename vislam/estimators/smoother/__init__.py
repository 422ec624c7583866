"""Factor-graph smoothing with GTSAM: poses, twist biases and landmarks in one graph."""

from vislam.estimators.smoother.incremental import SmootherEstimator
from vislam.estimators.smoother.options import SmootherOptions

__all__ = ["SmootherEstimator", "SmootherOptions"]
