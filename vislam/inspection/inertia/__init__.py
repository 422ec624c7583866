"""What is wrong with an accelerometer and a gyro, by their samples and by the camera's own motion."""

from vislam.inspection.inertia.checks import check_inertia, takes_raw_inertia

__all__ = ["check_inertia", "takes_raw_inertia"]
