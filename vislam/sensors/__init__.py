"""The stereo camera: one measurement model for every estimator."""

from vislam.sensors.stereo import StereoRig, measurement_variances

__all__ = ["StereoRig", "measurement_variances"]
