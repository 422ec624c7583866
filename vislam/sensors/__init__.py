"""The stereo camera: one measurement model for every estimator."""

from vislam.sensors.stereo import StereoRig

__all__ = ["StereoRig"]
