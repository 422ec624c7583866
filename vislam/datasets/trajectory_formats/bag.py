"""Poses and odometry of ROS bags: rosbag 1, rosbag 2 and MCAP, by the package rosbags."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import DataError
from vislam.datasets.bags import Bag, opened_bag
from vislam.datasets.trajectory_formats import clean
from vislam.datasets.trajectory_formats.options import ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.geometry.pose_covariance import CovarianceConvention

_ROS = CovarianceConvention("position_first", "world")
_KINDS: dict[str, Callable[[Any], tuple[Any, Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation, None),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (
        m.pose.pose.position,
        m.pose.pose.orientation,
        m.pose.covariance,
    ),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation, m.pose.covariance),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation, None),
    "geometry_msgs/msg/PointStamped": lambda m: (m.point, None, None),
}
"""Position, orientation and covariance of each type of message that holds a trajectory."""


def rosbag(path: Path, options: ReadOptions) -> Rows:
    """Messages of one topic; ``topic`` names it, unless the bag has only one that holds poses.

    Raises
    ------
    DataError
        If the package is not installed, the bag cannot be read, or it is not clear which topic is meant.
    """
    with opened_bag(path) as bag:
        topic = _topic(path, {one.name: one.kind for one in bag.topics.values()}, options.topic)
        messages = list(_messages(bag, topic))
    return _rows(path, topic, messages)


def _topic(path: Path, topics: dict[str, str], wanted: str | None) -> str:
    usable = sorted(topic for topic, kind in topics.items() if kind in _KINDS)
    listed = ", ".join(usable) or "none of poses, odometry, transforms or points"
    if wanted is not None:
        if wanted in usable:
            return wanted
        raise DataError(f"{path}: must have the topic {wanted} with poses, got {listed}")
    if len(usable) == 1:
        return usable[0]
    raise DataError(f"{path}: this is a rosbag: give topic=, one of {listed}")


def _messages(bag: Bag, topic: str) -> Iterator[tuple[float, Any, Any, Any]]:
    kind = bag.topics[topic].kind
    for _, _, raw in bag.messages({topic}):
        message = bag.message(topic, raw)
        stamp = message.header.stamp
        yield (stamp.sec + 1e-9 * stamp.nanosec, *_KINDS[kind](message))


def _rows(path: Path, topic: str, messages: list[tuple[float, Any, Any, Any]]) -> Rows:
    if not messages:
        raise DataError(f"{path}: must have messages on {topic}, got none")
    cov = None
    if messages[0][3] is not None:
        cov = np.array([message[3] for message in messages], float).reshape(-1, 6, 6)
        cov = cov if cov.any() else None
    rows = Rows(
        path,
        "rosbag",
        np.arange(1, len(messages) + 1),
        np.array([[m[1].x, m[1].y, m[1].z] for m in messages], float),
        stamp=np.array([message[0] for message in messages]),
        cov=cov,
        convention=None if cov is None else _ROS,
        told=(f"topic {topic}",),
    )
    if messages[0][2] is None:
        return clean.without_lost(rows)
    return clean.with_quaternions(rows, np.array([[m[2].x, m[2].y, m[2].z, m[2].w] for m in messages], float))
