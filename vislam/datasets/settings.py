"""What can be set of a reference."""

from typing import Literal

from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive
from vislam.base.settings import Remark, Title

STAMPED = ("tum", "euroc")
"""Formats of a reference that name stamps, not frames."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReferenceConfig:
    """What a recorded run is scored against."""

    file: str
    """File name, searched for where the recording is."""
    format: Literal["planar_xy", "kitti", "kitti360", "tum", "euroc"]
    """``planar_xy``: lines of frame, x, y. ``kitti``: 12 numbers a line (3 x 4, row by row), one a frame.
    ``kitti360``: the frame before the 12 numbers. ``tum``: stamp, x, y, z, qx, qy, qz, qw. ``euroc``: EuRoC's
    ground truth, with commas: stamp [ns], x, y, z, qw, qx, qy, qz, then anything."""
    name: Title
    """Its name, as the report prints it."""
    limits: Remark
    """What it does not tell."""
    pose_of: Literal["imu", "left_camera"] = "imu"
    """What its positions and poses are those of."""
    up: Literal["z", "-y"] = "z"
    """Axis of its world that points up; "-y" where the world has a camera's axes, as in KITTI odometry."""
    sigma_m: NonNegative = 0.0
    """Standard deviation of its own positions [m]; the first poses of a run are surer than any survey."""
    max_time_difference: Positive = 0.02
    """Farthest that a stamp may be from the camera stamp it is taken for (``tum``, ``euroc``) [s]."""

    def __post_init__(self) -> None:
        """Refuse a plane whose normal is not up."""
        if self.format == "planar_xy" and self.up != "z":
            raise ValueError("a planar_xy reference lies in the plane across z: up must be z")
