"""A fixed field of static points along a path: facades on both sides and the ground between them."""

import numpy as np
from scipy.spatial import KDTree

from vislam.base.types import Array, BoolArray, IntArray
from vislam.models import StereoRig
from vislam.simulation.settings import SimulationConfig

NEAREST = 1.5
"""A point nearer than this is out of sight [m]."""
_CAMERA_HEIGHT = 1.65
"""Height of the cameras above the ground, as on KITTI's car [m]."""
_GROUND_SHARE = 0.5
"""Share of the points that lie on the ground."""
_GROUND_HALF_WIDTH = 6.0
"""How far to either side of the way the ground has points [m]."""
_FACADE_NEAR, _FACADE_FAR, _FACADE_HEIGHT = 4.0, 20.0, 10.0
"""How far from the way facades stand at least and at most, and how high they are [m]."""
_NEARNESS = 1.5
"""The chance of a point to be found goes by this power of its disparity; front ends like texture at hand."""
_CLEAR = 3.0
"""Facades keep this distance to every part of the way, also where it turns or comes back [m]."""


def landmark_field(config: SimulationConfig, world_T_cam: Array, generator: np.random.Generator) -> Array:
    """Points ``(n, 3)`` [m] along the camera poses ``(T, 4, 4)`` and straight on beyond the last."""
    place, ahead = world_T_cam[:, :3, 3], world_T_cam[:, :2, 2]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    beyond = np.array([*(config.depth_max * ahead[-1]), 0.0])
    place, ahead = np.vstack([place, place[-1] + beyond]), np.vstack([ahead, ahead[-1]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))])

    count = round(config.field_per_metre * way[-1])
    at = generator.uniform(0.0, way[-1], count)
    ground = generator.random(count) < _GROUND_SHARE
    side = generator.choice([-1.0, 1.0], count)
    aside = np.where(
        ground,
        generator.uniform(0.0, _GROUND_HALF_WIDTH, count),
        generator.uniform(_FACADE_NEAR, _FACADE_FAR, count),
    )
    height = np.where(ground, 0.0, generator.uniform(0.0, _FACADE_HEIGHT, count)) - _CAMERA_HEIGHT
    on_way = np.column_stack([np.interp(at, way, column) for column in place.T])
    heading = np.column_stack([np.interp(at, way, column) for column in ahead.T])
    left = np.column_stack([-heading[:, 1], heading[:, 0]])
    point = on_way + np.column_stack([(side * aside)[:, None] * left, height])
    distance, _ = KDTree(place[:, :2]).query(point[:, :2])
    return point[ground | (distance > _CLEAR)]


def pick(
    config: SimulationConfig,
    rig: StereoRig,
    points_cam: Array,
    *,
    taken: IntArray,
    count: int,
    generator: np.random.Generator,
) -> IntArray:
    """Choose points of the field to follow, as a front end finds them.

    Parameters
    ----------
    config : SimulationConfig
    rig : StereoRig
    points_cam : (n, 3)
        The field in the left camera [m].
    taken : (m,)
        Indices of points that are followed already; -1 is none.
    count : int
        How many are wanted; fewer come if fewer are to be seen.
    generator : numpy.random.Generator

    Returns
    -------
    (k,)
        Indices, each once; near points are likelier.
    """
    depth = points_cam[:, 2]
    free = in_view(config, rig, points_cam) & (depth >= config.depth_min) & (depth <= config.depth_max)
    free[taken[taken >= 0]] = False
    candidates = np.flatnonzero(free)
    if count == 0 or len(candidates) == 0:
        return np.empty(0, np.int64)
    weight = depth[candidates] ** -_NEARNESS
    size = min(count, len(candidates))
    return generator.choice(candidates, size, replace=False, p=weight / weight.sum())


def in_view(config: SimulationConfig, rig: StereoRig, points_cam: Array) -> BoolArray:
    """Which of the points ``(n, 3)`` are ahead of the cameras and in both images."""
    ahead = points_cam[:, 2] > NEAREST
    z = rig.project(np.where(ahead[:, None], points_cam, [0.0, 0.0, 1.0]))
    inside = (z[:, 1] >= 0) & (z[:, 0] <= config.rig.width) & (z[:, 2] >= 0) & (z[:, 2] <= config.rig.height)
    return np.asarray(ahead & inside)
