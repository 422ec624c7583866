"""The stereo camera: one measurement model for every estimator."""

from vislam.sensors.noise import TrackNoise, independent_sigma
from vislam.sensors.stereo import StereoRig

__all__ = ["StereoRig", "TrackNoise", "independent_sigma"]
