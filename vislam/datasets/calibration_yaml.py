"""Cameras out of YAML: the ``sensor.yaml`` of the ASL layout, and the ``camchain`` of Kalibr."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.legible import brief
from vislam.base.types import Array
from vislam.base.yaml_text import MOST_CHARACTERS, parse_yaml
from vislam.geometry import se3, so3
from vislam.models.camera import Camera, Lens
from vislam.models.imu import ImuNoise
from vislam.models.stereo_pair import StereoPair, rectified

_LENSES = {
    "radial-tangential": Lens.RADTAN,
    "radtan": Lens.RADTAN,
    "plumb_bob": Lens.RADTAN,
    "equidistant": Lens.KANNALA_BRANDT,
    "kannala_brandt": Lens.KANNALA_BRANDT,
    "none": Lens.NONE,
    "": Lens.NONE,
}
_ROTATION_TOLERANCE = 1e-3
_LARGEST_IMAGE = 1 << 15
_HEADER = "%YAML"
_NOISE = (
    "gyroscope_noise_density",
    "accelerometer_noise_density",
    "gyroscope_random_walk",
    "accelerometer_random_walk",
)
"""In the order of ImuNoise."""


@dataclass(frozen=True)
class MountedCamera:
    """A camera and its pose in the frame of the inertial sensor."""

    camera: Camera
    imu_T_cam: Array


@dataclass(frozen=True)
class Camchain:
    """Two cameras as Kalibr calibrated them.

    Attributes
    ----------
    left, right : MountedCamera
        ``cam0`` and ``cam1``; without an inertial sensor their poses are in the left camera's axes.
    mounted : bool
        Whether the poses are in the frame of an inertial sensor.
    shift : float
        What is taken off the inertial stamps to have them in the clock of the images [s].
    topics : tuple of str or None
        ``rostopic`` of both.
    """

    left: MountedCamera
    right: MountedCamera
    mounted: bool
    shift: float
    topics: tuple[str, str] | None

    def swapped(self) -> "Camchain":
        """The same with left and right exchanged."""
        topics = None if self.topics is None else (self.topics[1], self.topics[0])
        return replace(self, left=self.right, right=self.left, topics=topics)

    def rectified(self, path: Path) -> StereoPair:
        """The rectified pair; DataError if these cameras are none."""
        return rectified_pair(self.left, self.right, where=path)


def rectified_pair(left: MountedCamera, right: MountedCamera, *, where: Path) -> StereoPair:
    """The rectified pair of two mounted cameras; DataError if they are none."""
    try:
        return rectified(left.camera, right.camera, imu_T_left=left.imu_T_cam, imu_T_right=right.imu_T_cam)
    except ValueError as error:
        raise DataError(f"{where}: {error}; look at the extrinsics of both cameras") from None


def read_mapping(path: Path) -> dict[str, Any]:
    """Read a YAML file that is a mapping; OpenCV's first line is passed over."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(MOST_CHARACTERS + 1)
    except (OSError, UnicodeError) as error:
        raise DataError(f"{path}: cannot be read ({first_line(error)})") from None
    if text.startswith(_HEADER):
        text = text.partition("\n")[2]
    try:
        tree = parse_yaml(text)
    except ValueError as error:
        raise DataError(f"{path}: not YAML that can be read ({error})") from None
    if not isinstance(tree, dict):
        raise DataError(f"{path}: must be a mapping, got {brief(str(tree))}")
    return tree


def read_sensor(path: Path, *, body_T_imu: Array) -> MountedCamera:
    """Read the ``sensor.yaml`` of a camera; ``T_BS`` is its pose in the body."""
    tree = read_mapping(path)
    model = tree.get("camera_model", "pinhole")
    if model != "pinhole":
        raise DataError(f"{path}: camera_model must be pinhole, got {brief(str(model))}")
    camera = _camera(
        path,
        resolution=tree.get("resolution"),
        intrinsics=tree.get("intrinsics"),
        lens=tree.get("distortion_model", "none"),
        coefficients=tree.get("distortion_coefficients", []),
    )
    return MountedCamera(camera, se3.inverse(body_T_imu) @ _body_T_sensor(path, tree))


def imu_in_body(path: Path) -> Array:
    """Pose of the inertial sensor in the body, ``(4, 4)``; the identity if ``sensor.yaml`` has none."""
    tree = read_mapping(path)
    return _body_T_sensor(path, tree) if "T_BS" in tree else np.eye(4)


def imu_noise(path: Path) -> ImuNoise | None:
    """Noise of the inertial sensor by ``sensor.yaml`` or Kalibr's ``imu.yaml``; None without all four.

    Both have the same keys, ``gyroscope_noise_density`` [rad/s/sqrt(Hz)], ``gyroscope_random_walk``
    [rad/s^2/sqrt(Hz)], ``accelerometer_noise_density`` [m/s^2/sqrt(Hz)] and ``accelerometer_random_walk``
    [m/s^3/sqrt(Hz)], Kalibr also in a mapping ``imu0`` of its own.
    """
    tree = read_mapping(path)
    inner = tree.get("imu0")
    tree = inner if isinstance(inner, dict) else tree
    if not all(key in tree for key in _NOISE):
        return None
    values = [_number(tree[key]) for key in _NOISE]
    for key, value in zip(_NOISE, values, strict=True):
        if not 0.0 < value < np.inf:
            raise DataError(f"{path}: {key} must be a number > 0, got {brief(str(tree[key]))}")
    return ImuNoise(*values)


def read_camchain(path: Path) -> Camchain:
    """Read the first two cameras of a Kalibr ``camchain`` file.

    ``T_cam_imu`` is the inertial sensor's pose in the camera, ``T_cn_cnm1`` the camera before in it. Without
    the former, as in a camchain of cameras alone, the left camera's axes are taken for the body's.
    ``timeshift_cam_imu`` is what has to be added to a stamp of the camera to have it in the clock of the
    inertial sensor.
    """
    tree = read_mapping(path)
    found, poses = [], []
    for name in ("cam0", "cam1"):
        one = tree.get(name)
        if not isinstance(one, dict):
            raise DataError(f"{path}: must have cam0 and cam1, {name} is missing")
        if one.get("camera_model", "pinhole") != "pinhole":
            raise DataError(
                f"{path}: {name}.camera_model must be pinhole, got {brief(str(one['camera_model']))}"
            )
        found.append(
            _camera(
                path,
                resolution=one.get("resolution"),
                intrinsics=one.get("intrinsics"),
                lens=one.get("distortion_model", "none"),
                coefficients=one.get("distortion_coeffs", []),
            )
        )
        if "T_cam_imu" in one:
            poses.append(se3.inverse(_matrix(path, f"{name}.T_cam_imu", one["T_cam_imu"])))
        elif not poses:
            poses.append(np.eye(4))
        elif "T_cn_cnm1" in one:
            poses.append(poses[-1] @ se3.inverse(_matrix(path, f"{name}.T_cn_cnm1", one["T_cn_cnm1"])))
        else:
            raise DataError(f"{path}: {name} must have T_cam_imu or T_cn_cnm1")
    topics = tuple(str(tree[name].get("rostopic", "")) for name in ("cam0", "cam1"))
    (shift,) = _numbers(path, "timeshift_cam_imu", [tree["cam0"].get("timeshift_cam_imu", 0.0)], (1,))
    return Camchain(
        left=MountedCamera(found[0], poses[0]),
        right=MountedCamera(found[1], poses[1]),
        mounted="T_cam_imu" in tree["cam0"],
        shift=shift,
        topics=(topics[0], topics[1]) if all(topics) else None,
    )


def _camera(path: Path, *, resolution: Any, intrinsics: Any, lens: Any, coefficients: Any) -> Camera:
    width, height = _numbers(path, "resolution", resolution, (2,))
    fx, fy, cx, cy = _numbers(path, "intrinsics", intrinsics, (4,))
    if not (1 <= width <= _LARGEST_IMAGE and 1 <= height <= _LARGEST_IMAGE and min(fx, fy) >= 1.0):
        raise DataError(
            f"{path}: resolution must be two sizes and intrinsics fx, fy >= 1 [px], "
            f"got {width:g} x {height:g}, fx {fx:g}, fy {fy:g}"
        )
    model = _LENSES.get(str(lens).lower())
    if model is None:
        raise DataError(
            f"{path}: distortion_model must be radial-tangential or equidistant, got {brief(str(lens))}"
        )
    values = _numbers(path, "distortion coefficients", coefficients, (0, 4, 5))
    if model is Lens.NONE or not any(values):
        return Camera(int(width), int(height), fx, fy, cx, cy)
    if len(values) not in model.counts:
        wanted = " or ".join(map(str, model.counts))
        raise DataError(f"{path}: distortion coefficients must be {wanted} numbers, got {len(values)}")
    return Camera(int(width), int(height), fx, fy, cx, cy, model, tuple(values))


def _numbers(path: Path, name: str, value: Any, counts: tuple[int, ...]) -> list[float]:
    numbers = [_number(one) for one in value] if isinstance(value, list) else []
    if not isinstance(value, list) or len(value) not in counts or not np.all(np.isfinite(numbers)):
        wanted = " or ".join(map(str, counts))
        raise DataError(f"{path}: {name} must be a list of {wanted} numbers, got {brief(str(value))}")
    return numbers


def _number(value: Any) -> float:
    """Number of a scalar, NaN if it is none; YAML takes 2e-05, which has no dot, for text."""
    try:
        return float("nan") if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _body_T_sensor(path: Path, tree: dict[str, Any]) -> Array:
    value = tree.get("T_BS")
    return _matrix(path, "T_BS", value.get("data") if isinstance(value, dict) else value)


def _matrix(path: Path, name: str, value: Any) -> Array:
    """Rigid transform out of 16 numbers in a row, or four rows of four."""
    if isinstance(value, list) and len(value) == 4 and all(isinstance(row, list) for row in value):
        value = [one for row in value for one in row]
    pose = np.array(_numbers(path, name, value, (16,))).reshape(4, 4)
    if not bool(se3.is_rigid(pose, tolerance=_ROTATION_TOLERANCE)):
        off, determinant = so3.defect(pose[:3, :3])
        raise DataError(
            f"{path}: {name} must be a rigid transform, got R^T R off by {off:.2g}, determinant "
            f"{determinant:.3g}"
        )
    u, _, vt = np.linalg.svd(pose[:3, :3])
    return se3.from_rotation_translation(u @ vt, pose[:3, 3])
