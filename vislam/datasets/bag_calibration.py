"""Calibration of a stereo pair out of a bag: ``CameraInfo``, and the mounting by ``/tf_static``."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.datasets.bag_topics import CAMERA_INFO, StereoTopics, pairs_by_name
from vislam.datasets.bags import Bag
from vislam.datasets.calibration_yaml import MountedCamera, rectified_pair
from vislam.geometry import se3, so3
from vislam.models import CAMERA_AXES
from vislam.models.camera import Camera, Lens
from vislam.models.stereo import StereoRig
from vislam.models.stereo_pair import StereoPair

TF = "tf2_msgs/msg/TFMessage"
_STATIC = "/tf_static"
_LENSES = {
    "plumb_bob": Lens.RADTAN,
    "radtan": Lens.RADTAN,
    "rational_polynomial": Lens.RADTAN,
    "equidistant": Lens.KANNALA_BRANDT,
    "fisheye": Lens.KANNALA_BRANDT,
}
_RADTAN = 5
_ROTATION_TOLERANCE = 1e-3
_REMEDY = "give a Kalibr camchain file with --calibration"


@dataclass(frozen=True)
class _Info:
    """What a ``CameraInfo`` has; ``rect_R_cam`` turns the camera's axes into the rectified ones."""

    camera: Camera
    plain: Camera
    rect_R_cam: Array
    projection: Array
    frame: str


def calibration_of(bag: Bag, topics: StereoTopics) -> tuple[StereoPair, bool]:
    """Stereo pair by the ``CameraInfo`` of both cameras, and whether its mounting is known.

    Images whose topic says that they are rectified have the projection P for their camera. The baseline is
    that of P (of the right camera), or, where P has none, that of ``/tf_static``, which also has the pose of
    the cameras in the inertial sensor. Without that the body is at the left camera, x forward and z up.

    Raises
    ------
    DataError
        If it is not complete, or cannot be right.
    """
    names = _info_topics(bag, topics)
    left, right = (
        _info(bag, info, image) for info, image in zip(names, (topics.left, topics.right), strict=True)
    )
    static = _static(bag)
    body = None if topics.imu is None else _frame_of(bag, topics.imu)
    imu_T_left = None if body is None else _between(static, body, left.frame)
    mounted = imu_T_left is not None
    base_T_left = (
        se3.from_rotation_translation(CAMERA_AXES, np.zeros(3)) if imu_T_left is None else imu_T_left
    )
    fx, fy, cx, cy = (float(left.projection[row]) for row in ((0, 0), (1, 1), (0, 2), (1, 2)))
    baseline = float(left.projection[0, 3] - right.projection[0, 3]) / fx if fx >= 1.0 else 0.0
    if baseline > 0.0 and fy >= 1.0:
        rig = StereoRig(
            fx,
            fy,
            cx,
            cy,
            baseline,
            base_T_left @ se3.from_rotation_translation(left.rect_R_cam.T, np.zeros(3)),
        )
        return StereoPair(left.camera, right.camera, left.rect_R_cam, right.rect_R_cam, rig), mounted
    if baseline < 0.0:
        raise DataError(
            f"{bag.path}: the right camera must stand to the right of the left one, got {baseline:g} m by "
            f"P of {names[1]}; exchange --left {topics.left} and --right {topics.right}"
        )
    left_T_right = _between(static, left.frame, right.frame)
    if left_T_right is None:
        raise DataError(
            f"{bag.path}: {names[1]} must have a baseline in P, or {_STATIC} relate "
            f"{left.frame or 'the left'} and {right.frame or 'the right camera'}; {_REMEDY}"
        )
    mounts = (
        MountedCamera(left.camera, base_T_left),
        MountedCamera(right.camera, base_T_left @ left_T_right),
    )
    return rectified_pair(*mounts, where=bag.path), mounted


def _info_topics(bag: Bag, topics: StereoTopics) -> tuple[str, str]:
    known = [topic.name for topic in bag.topics.values() if topic.kind == CAMERA_INFO and topic.count]
    found = [_beside(image, known) for image in (topics.left, topics.right)]
    if found[0] is not None and found[1] is not None and found[0] != found[1]:
        return found[0], found[1]
    pairs = pairs_by_name(known)
    if len(pairs) == 1:
        return pairs[0]
    raise DataError(
        f"{bag.path}: has no calibration of {topics.left} and {topics.right} ({CAMERA_INFO} beside them); "
        f"{_REMEDY}"
    )


def _beside(image: str, known: list[str]) -> str | None:
    """Calibration whose topic stands beside that of the images, or below it."""
    above = image.removesuffix("/compressed")
    candidates = (f"{above.rpartition('/')[0]}/camera_info", f"{above}/camera_info")
    return next((name for name in candidates if name in known), None)


def _first(bag: Bag, topic: str) -> Any:
    for _, _, raw in bag.messages({topic}):
        return bag.message(topic, raw)
    raise DataError(f"{bag.path}: must have a message on {topic}, got none")


def _frame_of(bag: Bag, topic: str) -> str:
    return str(_first(bag, topic).header.frame_id).lstrip("/")


def _info(bag: Bag, topic: str, image: str) -> _Info:
    message = _first(bag, topic)
    # ROS 1 has them in capitals.
    matrix, lens, turn, projection = (
        np.array(getattr(message, name, getattr(message, name.upper(), ())), dtype=float) for name in "kdrp"
    )
    where = f"{bag.path}: {topic}"
    sizes = (matrix.size, turn.size, projection.size)
    if sizes != (9, 9, 12) or not all(np.isfinite(part).all() for part in (matrix, lens, turn, projection)):
        raise DataError(f"{where}: K, R and P must be 9, 9 and 12 finite numbers, got {sizes}; {_REMEDY}")
    matrix, turn, projection = matrix.reshape(3, 3), turn.reshape(3, 3), projection.reshape(3, 4)
    width, height = int(message.width), int(message.height)
    if min(matrix[0, 0], matrix[1, 1], width, height) < 1:
        raise DataError(
            f"{where}: is not calibrated (K has fx, fy {matrix[0, 0]:g}, {matrix[1, 1]:g}, images are "
            f"{width} x {height} px); {_REMEDY}"
        )
    turn = _rotation(turn, where)
    plain = Camera(width, height, projection[0, 0], projection[1, 1], projection[0, 2], projection[1, 2])
    if "rect" in image.removesuffix("/compressed").rpartition("/")[2]:
        return _Info(plain, plain, np.eye(3), projection, str(message.header.frame_id).lstrip("/"))
    model, coefficients = _lens(str(message.distortion_model), lens, where)
    fx, fy, cx, cy = (float(matrix[row]) for row in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = Camera(width, height, fx, fy, cx, cy, model, coefficients)
    return _Info(camera, plain, turn, projection, str(message.header.frame_id).lstrip("/"))


def _rotation(matrix: Array, where: str) -> Array:
    """The nearest rotation; the identity for a matrix of zeros, as drivers write it."""
    if not matrix.any():
        return np.eye(3)
    off, determinant = so3.defect(matrix)
    if off > _ROTATION_TOLERANCE or determinant < 0.0:
        raise DataError(
            f"{where}: R must be a rotation, got R^T R off by {off:.2g}, determinant {determinant:.3g}; "
            f"{_REMEDY}"
        )
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)


def _lens(name: str, coefficients: Array, where: str) -> tuple[Lens, tuple[float, ...]]:
    if not coefficients.any():
        return Lens.NONE, ()
    model = _LENSES.get(name.lower())
    if model is None or (model is Lens.RADTAN and coefficients[_RADTAN:].any()):
        raise DataError(
            f"{where}: distortion_model must be plumb_bob (up to k3) or equidistant, got {name or 'none'} "
            f"with {coefficients.size} coefficients; {_REMEDY}"
        )
    values = coefficients[:_RADTAN] if model is Lens.RADTAN else coefficients
    if len(values) not in model.counts:
        wanted = " or ".join(map(str, model.counts))
        raise DataError(f"{where}: D must be {wanted} numbers for {name}, got {len(values)}; {_REMEDY}")
    return model, tuple(float(value) for value in values)


def _static(bag: Bag) -> dict[tuple[str, str], Array]:
    """Pose of each child in its parent, by their frames, and of the parent in the child."""
    found: dict[tuple[str, str], Array] = {}
    topic = bag.topics.get(_STATIC)
    if topic is None or topic.kind != TF:
        return found
    for _, _, raw in bag.messages({_STATIC}):
        for one in bag.message(_STATIC, raw).transforms:
            q, t = one.transform.rotation, one.transform.translation
            quaternion = np.array([q.x, q.y, q.z, q.w])
            if not np.isfinite(quaternion).all() or not quaternion.any():
                continue
            pose = se3.from_rotation_translation(
                Rotation.from_quat(quaternion).as_matrix(), np.array([t.x, t.y, t.z])
            )
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            found[parent, child] = pose
            found[child, parent] = se3.inverse(pose)
    return found


def _between(static: dict[tuple[str, str], Array], parent: str, child: str) -> Array | None:
    """Pose ``(4, 4)`` of one frame in another along the tree; None if nothing connects them."""
    if parent == child:
        # Two sensors of one frame that nobody has told apart are not a calibration, but a default.
        return None
    ways, queue = {parent: np.eye(4)}, deque([parent])
    while queue:
        at = queue.popleft()
        for (one, other), pose in static.items():
            if one == at and other not in ways:
                ways[other] = ways[at] @ pose
                queue.append(other)
    return ways.get(child)
