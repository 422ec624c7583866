"""Tracks from frame to frame: predicted, followed, matched to the right image, put to the vote, filled up."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from vislam.base.types import Array
from vislam.core.images import ImageRecording
from vislam.frontend.consensus import agree
from vislam.frontend.corners import cells, new_corners
from vislam.frontend.decoding import Picture
from vislam.frontend.flow import follow, within
from vislam.frontend.gyro import Turns
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.stereo import Matches, carried, matched
from vislam.frontend.tracks import Tracks
from vislam.geometry import se3
from vislam.models.stereo_pair import StereoPair

_NEWEST = 0.3
"""Weight of the newest corners in the yield of their cell."""
_SMALLEST_YIELD = 0.05
_HELD, _MANY = 0.1, 20
"""A pair in which fewer than this share of at least so many tracks are found is held back once."""


@dataclass(frozen=True)
class _Pair:
    left: Picture
    right: Picture


@dataclass
class Tracker:
    """Follows corners through pairs of images.

    Attributes
    ----------
    pair : StereoPair
    config : FrontEndConfig
    turns : Turns or None
        Turns of the camera by a gyro; without them its motion is taken to go on as it was.
    counts : Counter
        Why tracks ended, and how many new ones were rejected.
    """

    pair: StereoPair
    config: FrontEndConfig
    turns: Turns | None = None
    counts: Counter[str] = field(default_factory=Counter)
    _tracks: Tracks = field(default_factory=Tracks.none)
    _before: _Pair | None = None
    _stamp: float = 0.0
    _velocity: Array = field(default_factory=lambda: np.zeros(6))
    _next_id: int = 0
    _held: bool = False

    def __post_init__(self) -> None:
        """Seed the draws."""
        self._rng = np.random.default_rng(self.config.seed)
        self._yield = np.ones(self.config.grid[0] * self.config.grid[1])
        self._tried = (np.empty(0, np.int64), np.empty(0, np.int64))

    def process(self, left: Picture, right: Picture, *, stamp: float) -> Tracks | None:
        """Take one pair of images and return the tracks in view.

        None if next to none of many tracks was found in it, while the next pair may be as good as the one
        before; two such pairs on end are taken for what the camera sees.

        Parameters
        ----------
        left, right : Picture
        stamp : float
            Increasing [s].
        """
        kept = self._tracks
        if self._before is not None and len(kept):
            dt = stamp - self._stamp
            guess = se3.exp(self._velocity * dt)
            if self.turns is not None:
                guess[:3, :3] = self.turns.between(self._stamp, stamp).T
            kept, motion = self._followed(self._before, left, right, guess=guess)
            if len(kept) < _HELD * len(self._tracks) and len(self._tracks) >= _MANY and not self._held:
                self._held = True
                self.counts["frames_held"] += 1
                return None
            if motion is not None:
                self._velocity = se3.log(motion) / dt
                if self.turns is not None:
                    self.turns.learn(self._stamp, stamp, motion[:3, :3].T)
        self._held = False
        self._learn_yield(kept)
        if len(kept) < self.config.redetect_below * self.config.features:
            kept = kept.with_more(self._found(left, right, kept))
        self._before, self._tracks, self._stamp = _Pair(left, right), kept, stamp
        return kept

    def _followed(
        self, before: _Pair, left: Picture, right: Picture, *, guess: Array
    ) -> tuple[Tracks, Array | None]:
        """Tracks that go on, and the camera's motion ``next_T_prev`` that they agree on, if there is one."""
        old, config, rig = self._tracks, self.config, self.pair.rig
        points = se3.transform(guess, rig.back_project(old.z))
        supposed = self._seen(points, left)
        end, distance, found = follow(
            before.left,
            left,
            old.left,
            guess=np.where(np.isnan(supposed), old.left, supposed),
            levels=config.predicted_levels,
            farthest=config.forward_backward_px,
            config=config,
        )
        self.counts["tracks_lost"] += int(np.sum(~found))
        old, points, end, distance = old.of(found), points[found], end[found], distance[found]
        disparity = rig.fx * rig.baseline / np.maximum(points[:, 2], rig.nearest)
        new = self._stereo(before, _Pair(left, right), old, end=end, disparity=disparity)
        self.counts["tracks_without_stereo"] += int(np.sum(~new.valid))
        kept = Tracks(old.track, end, new.right, new.pixels, np.column_stack([distance, new.distance])).of(
            new.valid
        )
        old = old.of(new.valid)
        agreed = agree(rig, old.z, kept.z, guess=guess, config=config, rng=self._rng)
        if agreed is None:
            self.counts["frames_without_consensus"] += 1
            return kept, None
        self.counts["tracks_off_consensus"] += int(np.sum(~agreed.keeps))
        return kept.of(agreed.keeps), agreed.next_T_prev

    def _stereo(self, before: _Pair, now: _Pair, old: Tracks, *, end: Array, disparity: Array) -> Matches:
        """Right pixels of tracks by a match of both images, and, where that fails, carried on."""
        config, pair = self.config, self.pair
        new = matched(pair, now.left, now.right, end, disparity=disparity, known=True, config=config)
        rest = ~new.valid
        again = carried(
            pair,
            before.right,
            now.right,
            end[rest],
            start=old.right[rest],
            disparity=disparity[rest],
            config=config,
        )
        self.counts["matches_carried"] += int(np.sum(again.valid))
        return new.completed(rest, again)

    def _seen(self, points: Array, left: Picture) -> Array:
        """Pixels ``(n, 2)`` in the left image of points in the rectified left camera, NaN outside of it."""
        rig = self.pair.rig
        depth = np.where(points[:, 2] > rig.nearest, points[:, 2], np.nan)
        rectified = np.column_stack(
            [rig.fx * points[:, 0] / depth + rig.cx, rig.fy * points[:, 1] / depth + rig.cy]
        )
        pixels = self.pair.raw_left(rectified)
        return np.where(within(pixels, left, margin=0.0)[:, None], pixels, np.nan)

    def _found(self, left: Picture, right: Picture, kept: Tracks) -> Tracks:
        """New tracks, matched."""
        config = self.config
        wanted = config.features - len(kept)
        corners = new_corners(left, kept.left, config=config, wanted=wanted, yield_of=self._yield)
        usual = float(np.median(kept.pixels[:, 0] - kept.pixels[:, 2])) if len(kept) else 0.0
        disparity = np.full(len(corners), usual)
        new = matched(self.pair, left, right, corners, disparity=disparity, known=False, config=config)
        self.counts["corners_found"] += len(corners)
        self.counts["corners_without_stereo"] += int(np.sum(~new.valid))
        ids = np.full(len(corners), -1)
        ids[new.valid] = self._next_id + np.arange(np.sum(new.valid))
        self._next_id += int(np.sum(new.valid))
        self._tried = (cells(corners, left, config), ids)
        distance = np.column_stack([np.zeros(len(corners)), new.distance])
        return Tracks(ids, corners, new.right, new.pixels, distance).of(new.valid)

    def _learn_yield(self, kept: Tracks) -> None:
        """Update the yield of each cell by the share of its newest corners that are in view again."""
        cell, ids = self._tried
        tried = np.bincount(cell, minlength=len(self._yield))
        good = np.bincount(cell, weights=np.isin(ids, kept.track), minlength=len(self._yield))
        seen = tried > 0
        share = good[seen] / tried[seen]
        self._yield[seen] = np.maximum((1.0 - _NEWEST) * self._yield[seen] + _NEWEST * share, _SMALLEST_YIELD)
        self._tried = (cell[:0], ids[:0])


def build(recording: ImageRecording, options: FrontEndConfig) -> Tracker:
    """Our front end for a recording, with the turns by its gyro if it has one."""
    inertia = recording.inertia
    turns = None if inertia is None else Turns(inertia, imu_R_cam=recording.pair.rig.imu_T_cam[:3, :3])
    return Tracker(recording.pair, options, turns)
