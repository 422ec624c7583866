"""Factor-graph smoothing with GTSAM: poses, twist biases and landmarks in one graph."""

from vislam.smoother.incremental import SmootherEstimator
from vislam.smoother.options import SmootherOptions

__all__ = ["SmootherEstimator", "SmootherOptions"]
