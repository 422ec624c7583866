"""Factor-graph smoothing with GTSAM: poses, twist biases and landmarks in one graph."""

from vislam.smoother.isam2 import Isam2Estimator, Isam2Options, build

__all__ = ["Isam2Estimator", "Isam2Options", "build"]
