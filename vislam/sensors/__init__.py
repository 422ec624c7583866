"""The stereo camera: one measurement model for every estimator."""

from vislam.sensors.noise import TrackNoise, independent_sigma
from vislam.sensors.stereo import CAMERA_AXES, StereoRig

__all__ = ["CAMERA_AXES", "StereoRig", "TrackNoise", "independent_sigma"]
