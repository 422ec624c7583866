"""The stereo camera: one measurement model for every estimator."""

from vislam.models.kernel import Kernel
from vislam.models.shared_errors import CameraErrors, SharedPrior
from vislam.models.stereo import CAMERA_AXES, StereoRig
from vislam.models.track_noise import TrackNoise, independent_sigma

__all__ = [
    "CAMERA_AXES",
    "CameraErrors",
    "Kernel",
    "SharedPrior",
    "StereoRig",
    "TrackNoise",
    "independent_sigma",
]
