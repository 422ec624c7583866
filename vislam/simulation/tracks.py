"""Stereo tracks of a simulated front end: births, losses, noise, wrong matches and stale frames."""

from dataclasses import dataclass, fields

import numpy as np

from vislam.geometry import se3
from vislam.sensors import StereoRig
from vislam.simulation.settings import SimulationConfig
from vislam.types import Array, BoolArray, IntArray

_NEAREST = 1.5
"""A point nearer than this is out of sight [m]."""
_OUTLIER_PX = 50.0


@dataclass(frozen=True)
class Tracks:
    """Observations frame after frame, as in ``Sequence``, with the point behind each."""

    offset: IntArray
    track: IntArray
    pixels: Array
    points_world: Array


@dataclass
class _Alive:
    """The tracks in view, one row each.

    Attributes
    ----------
    track : (n,)
    point, velocity : (n, 3)
        The point that is followed [m] and how it moves [m/s].
    match : (n,)
        Share by which the disparity is too large.
    slip : (n, 2)
        Where the tracker has drifted to, column and row [px].
    pixels : (n, 4)
        Last written.
    """

    track: IntArray
    point: Array
    velocity: Array
    match: Array
    slip: Array
    pixels: Array

    def keep(self, mask: BoolArray) -> None:
        for item in fields(self):
            setattr(self, item.name, getattr(self, item.name)[mask])

    def add(self, other: "_Alive") -> None:
        for item in fields(self):
            both = getattr(self, item.name), getattr(other, item.name)
            setattr(self, item.name, np.concatenate(both))


def simulate_tracks(
    config: SimulationConfig, rig: StereoRig, world_T_cam: Array, generator: np.random.Generator
) -> Tracks:
    """Observe a random world along the camera poses ``(T, 4, 4)``."""
    alive = _Alive(
        np.empty(0, np.int64),
        np.empty((0, 3)),
        np.empty((0, 3)),
        np.empty(0),
        np.empty((0, 2)),
        np.empty((0, 4)),
    )
    born, lengths = 0, []
    written: list[tuple[IntArray, Array, Array]] = []
    dropped = False
    for k, pose in enumerate(world_T_cam):
        stale = k > 0 and len(alive.track) > 0 and generator.random() < config.stale_probability
        before, dropped = dropped, k > 0 and _happens(config.dropped_probability, generator)
        # What is not written is not repeated.
        stale = stale and not (before or dropped)
        alive.keep(generator.random(len(alive.track)) >= config.loss_probability)
        alive.point = alive.point + config.period * alive.velocity
        alive.slip = alive.slip + config.drift_px * generator.standard_normal(alive.slip.shape)
        if stale:
            alive.point = se3.transform(pose, rig.back_project(_triples(alive.pixels, alive.match)))
        else:
            alive.keep(_in_view(config, rig, se3.transform(se3.inverse(pose), alive.point)))
            alive.pixels = _observe(config, rig, pose, alive, generator)
        missing = max(
            0, round(generator.normal(config.tracks_in_view, 0.08 * config.tracks_in_view)) - len(alive.track)
        )
        alive.add(_births(config, rig, pose, first=born, count=missing, generator=generator))
        born += missing
        seen = slice(0 if dropped else None)
        lengths.append(len(alive.track[seen]))
        written.append((alive.track[seen], alive.pixels[seen], alive.point[seen]))
    track, pixels, points = (np.concatenate(part) for part in zip(*written, strict=True))
    offset = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return Tracks(offset, track, pixels, points)


def _happens(probability: float, generator: np.random.Generator) -> bool:
    """Draw, unless the chance is none: what is switched off takes no number from the generator."""
    return probability > 0.0 and generator.random() < probability


def _births(
    config: SimulationConfig,
    rig: StereoRig,
    pose: Array,
    *,
    first: int,
    count: int,
    generator: np.random.Generator,
) -> _Alive:
    """New tracks anywhere in the image, at depths spread evenly in their logarithm."""
    depth = np.exp(generator.uniform(np.log(config.depth_min), np.log(config.depth_max), count))
    disparity = rig.fx * rig.baseline / depth
    column = generator.uniform(disparity, np.maximum(config.rig.width, disparity + 1.0))
    row = generator.uniform(0.0, config.rig.height, count)
    point = se3.transform(pose, rig.back_project(np.column_stack([column, column - disparity, row])))
    moving = generator.random(count) < config.moving_share
    speed = config.speed * generator.uniform(-1.0, 1.0, count)
    velocity = np.where(moving, speed, 0.0)[:, None] * pose[:3, 2]
    match = config.match_px * generator.standard_normal(count) / disparity
    ids = first + np.arange(count)
    new = _Alive(ids, point, velocity, match, np.zeros((count, 2)), np.empty((count, 4)))
    new.pixels = _observe(config, rig, pose, new, generator)
    return new


def _observe(
    config: SimulationConfig, rig: StereoRig, pose: Array, alive: _Alive, generator: np.random.Generator
) -> Array:
    """Pixels (uL, vL, uR, vR) of the tracks, with noise, drift, match error and outliers."""
    z = rig.project(se3.transform(se3.inverse(pose), alive.point))
    column, row = z[:, :2] + alive.slip[:, :1], z[:, 2] + alive.slip[:, 1]
    right = column[:, 1] - alive.match * (z[:, 0] - z[:, 1]) - config.disparity_offset_px
    pixels = np.column_stack([column[:, 0], row, right, row])
    pixels += config.pixel_sigma_px * generator.standard_normal(pixels.shape)
    wrong = generator.random(len(pixels)) < config.outlier_probability
    pixels[wrong] += generator.uniform(-_OUTLIER_PX, _OUTLIER_PX, (int(wrong.sum()), 4))
    return pixels


def _in_view(config: SimulationConfig, rig: StereoRig, points_cam: Array) -> BoolArray:
    ahead = points_cam[:, 2] > _NEAREST
    z = rig.project(np.where(ahead[:, None], points_cam, [0.0, 0.0, 1.0]))
    inside = (z[:, 1] >= 0) & (z[:, 0] <= config.rig.width) & (z[:, 2] >= 0) & (z[:, 2] <= config.rig.height)
    return np.asarray(ahead & inside)


def _triples(pixels: Array, match: Array) -> Array:
    """Measurements without the error of the match; a disparity below half a pixel counts as that."""
    left = pixels[:, 0]
    disparity = np.maximum((left - pixels[:, 2]) / (1.0 + match), 0.5)
    return np.column_stack([left, left - disparity, 0.5 * (pixels[:, 1] + pixels[:, 3])])
