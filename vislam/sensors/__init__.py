"""The stereo camera: one measurement model for every estimator."""

from vislam.sensors.stereo import CAMERA_AXES, StereoRig, measurement_variances

__all__ = ["CAMERA_AXES", "StereoRig", "measurement_variances"]
