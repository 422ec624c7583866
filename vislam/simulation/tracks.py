"""Stereo tracks of a simulated front end: births, losses, noise, wrong matches and duplicated frames."""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.geometry import se3
from vislam.models import StereoRig
from vislam.simulation.field import in_view, landmark_field, pick
from vislam.simulation.settings import SimulationConfig

_OUTLIER_PX = 50.0
_LARGEST_SHARE = 0.9
"""A disparity is not off by a larger share of itself, lest it change its sign."""


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
    landmark : (n,)
        Index in the field of the point, or -1.
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
    landmark: IntArray
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


class _Found(NamedTuple):
    """Points for ``n`` new tracks: index in the field or -1, place ``(n, 3)`` [m], disparity [px]."""

    landmark: IntArray
    point: Array
    disparity: Array


def simulate_tracks(
    config: SimulationConfig, rig: StereoRig, world_T_cam: Array, generator: np.random.Generator
) -> Tracks:
    """Observe a random world along the camera poses ``(T, 4, 4)``."""
    alive = _Alive(
        np.empty(0, np.int64),
        np.empty(0, np.int64),
        np.empty((0, 3)),
        np.empty((0, 3)),
        np.empty(0),
        np.empty((0, 2)),
        np.empty((0, 4)),
    )
    field = landmark_field(config, world_T_cam, generator) if config.landmarks != "births" else None
    born, lengths = 0, []
    written: list[tuple[IntArray, Array, Array]] = []
    redetects, fewest = config.redetect_below is not None, config.redetect_below or 0.0
    dropped = was_duplicated = False
    for k, pose in enumerate(world_T_cam):
        duplicated = k > 0 and len(alive.track) > 0 and generator.random() < config.duplication_probability
        duplicated = duplicated or (redetects and not was_duplicated and 0 < len(alive.track) < fewest)
        before, dropped = dropped, k > 0 and _happens(config.dropped_probability, generator)
        # What is not written is not repeated.
        duplicated = duplicated and not (before or dropped)
        chance = 0.0 if duplicated and redetects else config.loss_probability
        alive.keep(generator.random(len(alive.track)) >= chance)
        alive.point = alive.point + config.period * alive.velocity
        alive.slip = alive.slip + config.drift_px * generator.standard_normal(alive.slip.shape)
        if duplicated:
            alive.landmark = np.full_like(alive.landmark, -1)
            alive.point = se3.transform(pose, rig.back_project(_triples(alive.pixels, alive.match)))
        else:
            alive.keep(in_view(config, rig, se3.transform(se3.inverse(pose), alive.point)))
            _follow(config, rig, pose, alive, generator)
        births = duplicated or not redetects or len(alive.track) == 0
        missing = _missing(config, len(alive.track), generator) if births else 0
        found = _find(config, rig, pose, field, taken=alive.landmark, count=missing, generator=generator)
        alive.add(_births(config, rig, pose, found, first=born, generator=generator))
        born, was_duplicated = born + len(found.point), duplicated
        seen = slice(0 if dropped else None)
        lengths.append(len(alive.track[seen]))
        written.append((alive.track[seen], alive.pixels[seen], alive.point[seen]))
    track, pixels, points = (np.concatenate(part) for part in zip(*written, strict=True))
    offset = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return _without_short(Tracks(offset, track, pixels, points), config.shortest_track)


def _without_short(tracks: Tracks, shortest: int) -> Tracks:
    """Leave out tracks with fewer observations than ``shortest``; the ids of the rest have no gaps."""
    if shortest == 1:
        return tracks
    kept = np.bincount(tracks.track)[tracks.track] >= shortest
    offset = np.concatenate([[0], np.cumsum(kept)])[tracks.offset]
    track = np.unique(tracks.track[kept], return_inverse=True)[1]
    return Tracks(offset, track, tracks.pixels[kept], tracks.points_world[kept])


def _happens(probability: float, generator: np.random.Generator) -> bool:
    """Draw, unless the chance is none: what is switched off takes no number from the generator."""
    return probability > 0.0 and generator.random() < probability


def _missing(config: SimulationConfig, there: int, generator: np.random.Generator) -> int:
    """Draw how many tracks there are to be, and say how many that lacks."""
    wanted = generator.normal(config.tracks_in_view, config.tracks_spread * config.tracks_in_view)
    return max(0, round(wanted) - there)


def _follow(
    config: SimulationConfig, rig: StereoRig, pose: Array, alive: _Alive, generator: np.random.Generator
) -> None:
    """Write the tracks in their new places; the farther one has gone, the more likely it is lost."""
    before, alive.pixels = alive.pixels, _observe(config, rig, pose, alive, generator)
    if config.loss_flow_px is not None:
        flow = np.linalg.norm(alive.pixels[:, :2] - before[:, :2], axis=1)
        alive.keep(generator.random(len(flow)) < np.exp(-flow / config.loss_flow_px))


def _find(
    config: SimulationConfig,
    rig: StereoRig,
    pose: Array,
    field: Array | None,
    *,
    taken: IntArray,
    count: int,
    generator: np.random.Generator,
) -> _Found:
    """Find points for new tracks: in the field or, without one, anywhere in the image.

    The latter lie at depths spread evenly in their logarithm.
    """
    if field is not None:
        points_cam = se3.transform(se3.inverse(pose), field)
        index = pick(config, rig, points_cam, taken=taken, count=count, generator=generator)
        return _Found(index, field[index], rig.fx * rig.baseline / points_cam[index, 2])
    depth = np.exp(generator.uniform(np.log(config.depth_min), np.log(config.depth_max), count))
    disparity = rig.fx * rig.baseline / depth
    column = generator.uniform(disparity, np.maximum(config.rig.width, disparity + 1.0))
    row = generator.uniform(0.0, config.rig.height, count)
    point = se3.transform(pose, rig.back_project(np.column_stack([column, column - disparity, row])))
    return _Found(np.full(count, -1), point, disparity)


def _births(
    config: SimulationConfig,
    rig: StereoRig,
    pose: Array,
    found: _Found,
    *,
    first: int,
    generator: np.random.Generator,
) -> _Alive:
    """New tracks of the points found."""
    count = len(found.point)
    moving = generator.random(count) < config.moving_share
    speed = config.speed * generator.uniform(-1.0, 1.0, count)
    velocity = np.where(moving, speed, 0.0)[:, None] * pose[:3, 2]
    match = config.matching_bias_px * generator.standard_normal(count) / found.disparity
    if config.matching_bias_share > 0.0:
        share = config.matching_bias_share * generator.standard_t(2.0, count)
        match = match + np.clip(share, -_LARGEST_SHARE, _LARGEST_SHARE)
    ids = found.landmark if config.landmarks == "recognised" else first + np.arange(count)
    new = _Alive(
        ids, found.landmark, found.point, velocity, match, np.zeros((count, 2)), np.empty((count, 4))
    )
    new.pixels = _observe(config, rig, pose, new, generator)
    return new


def _observe(
    config: SimulationConfig, rig: StereoRig, pose: Array, alive: _Alive, generator: np.random.Generator
) -> Array:
    """Pixels (uL, vL, uR, vR) of the tracks, with noise, drift, stereo-matching bias and outliers."""
    z = rig.project(se3.transform(se3.inverse(pose), alive.point))
    column, row = z[:, :2] + alive.slip[:, :1], z[:, 2] + alive.slip[:, 1]
    right = column[:, 1] - alive.match * (z[:, 0] - z[:, 1]) - config.disparity_offset_px
    pixels = np.column_stack([column[:, 0], row, right, row])
    pixels += config.pixel_sigma_px * generator.standard_normal(pixels.shape)
    wrong = generator.random(len(pixels)) < config.outlier_probability
    pixels[wrong] += generator.uniform(-_OUTLIER_PX, _OUTLIER_PX, (int(wrong.sum()), 4))
    return pixels


def _triples(pixels: Array, match: Array) -> Array:
    """Measurements without the stereo-matching bias; a disparity below half a pixel counts as that."""
    left = pixels[:, 0]
    disparity = np.maximum((left - pixels[:, 2]) / (1.0 + match), 0.5)
    return np.column_stack([left, left - disparity, 0.5 * (pixels[:, 1] + pixels[:, 3])])
