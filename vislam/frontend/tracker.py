"""Tracks from frame to frame: predicted, followed, matched to the right image, put to the vote, filled up."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.frontend.consensus import agree
from vislam.frontend.corners import cells, new_corners
from vislam.frontend.flow import follow, within
from vislam.frontend.gyro import Turns
from vislam.frontend.pictures import Picture
from vislam.frontend.settings import FrontEndConfig
from vislam.geometry import se3
from vislam.models.stereo_pair import StereoPair

_NEWEST = 0.3
"""Weight of the newest corners in the yield of their cell."""
_SMALLEST_YIELD = 0.05
_HELD, _MANY = 0.1, 20
"""A pair in which fewer than this share of at least so many tracks are found is held back once."""


@dataclass(frozen=True)
class Tracks:
    """Tracks in view in one frame.

    Attributes
    ----------
    track : (n,)
        Ids; one that is missing once never comes back.
    left, right : (n, 2)
        Pixels in the images as they are [px].
    pixels : (n, 4)
        Rectified (uL, vL, uR, vR) [px].
    distance : (n, 2)
        Forward-backward distance from the frame before (0 for a new track) and to the right image [px].
    """

    track: IntArray
    left: Array
    right: Array
    pixels: Array
    distance: Array

    @classmethod
    def none(cls) -> "Tracks":
        """No track."""
        two = np.empty((0, 2))
        return cls(np.empty(0, np.int64), two, two, np.empty((0, 4)), two)

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.track)

    def of(self, keep: BoolArray) -> "Tracks":
        """The tracks of a mask."""
        return Tracks(
            self.track[keep], self.left[keep], self.right[keep], self.pixels[keep], self.distance[keep]
        )

    def with_more(self, other: "Tracks") -> "Tracks":
        """These and others."""
        return Tracks(
            np.concatenate([self.track, other.track]),
            np.vstack([self.left, other.left]),
            np.vstack([self.right, other.right]),
            np.vstack([self.pixels, other.pixels]),
            np.vstack([self.distance, other.distance]),
        )

    @property
    def z(self) -> Array:
        """Stereo measurements (uL, uR, v), ``(n, 3)`` [px]."""
        return np.column_stack(
            [self.pixels[:, 0], self.pixels[:, 2], 0.5 * (self.pixels[:, 1] + self.pixels[:, 3])]
        )


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
        Why tracks ended, and how many new ones were refused.
    """

    pair: StereoPair
    config: FrontEndConfig
    turns: Turns | None = None
    counts: Counter[str] = field(default_factory=Counter)
    _tracks: Tracks = field(default_factory=Tracks.none)
    _picture: Picture | None = None
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
        if self._picture is not None and len(kept):
            dt = stamp - self._stamp
            guess = se3.exp(self._velocity * dt)
            if self.turns is not None:
                guess[:3, :3] = self.turns.between(self._stamp, stamp).T
            kept, motion = self._followed(self._picture, left, right, guess=guess)
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
        self._picture, self._tracks, self._stamp = left, kept, stamp
        return kept

    def _followed(
        self, before: Picture, left: Picture, right: Picture, *, guess: Array
    ) -> tuple[Tracks, Array | None]:
        """Tracks that go on, and the camera's motion ``next_T_prev`` that they agree on, if there is one."""
        old = self._tracks
        points = se3.transform(guess, self.pair.rig.back_project(old.z))
        supposed = self._seen(points, left)
        start = np.where(np.isnan(supposed), old.left, supposed)
        config = self.config
        end, distance, found = follow(
            before,
            left,
            old.left,
            guess=start,
            levels=config.predicted_levels,
            farthest=config.forward_backward_px,
            config=config,
        )
        self.counts["tracks_lost"] += int(np.sum(~found))
        old, points, end, distance = old.of(found), points[found], end[found], distance[found]
        disparity = (
            self.pair.rig.fx * self.pair.rig.baseline / np.maximum(points[:, 2], self.pair.rig.nearest)
        )
        new, matched = self._matched(
            left, right, end, disparity=disparity, distance=distance, track=old.track
        )
        self.counts["tracks_without_stereo"] += int(np.sum(~matched))
        old, new = old.of(matched), new.of(matched)
        agreed = agree(self.pair.rig, old.z, new.z, guess=guess, config=self.config, rng=self._rng)
        if agreed is None:
            self.counts["frames_without_consensus"] += 1
            return new, None
        self.counts["tracks_off_consensus"] += int(np.sum(~agreed.keeps))
        return new.of(agreed.keeps), agreed.next_T_prev

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
        wanted = self.config.features - len(kept)
        corners = new_corners(left, kept.left, config=self.config, wanted=wanted, yield_of=self._yield)
        disparity = self._usual_disparity(kept, len(corners))
        new, matched = self._matched(
            left, right, corners, disparity=disparity, distance=np.zeros(len(corners)), track=None
        )
        self.counts["corners_found"] += len(corners)
        self.counts["corners_without_stereo"] += int(np.sum(~matched))
        new = new.of(matched)
        track = self._next_id + np.arange(len(new))
        self._next_id += len(new)
        ids = np.full(len(corners), -1)
        ids[matched] = track
        self._tried = (cells(corners, left, self.config), ids)
        return Tracks(track, new.left, new.right, new.pixels, new.distance)

    def _learn_yield(self, kept: Tracks) -> None:
        """Update the yield of each cell by the share of its newest corners that are in view again."""
        cell, ids = self._tried
        tried = np.bincount(cell, minlength=len(self._yield))
        good = np.bincount(cell, weights=np.isin(ids, kept.track), minlength=len(self._yield))
        seen = tried > 0
        share = good[seen] / tried[seen]
        self._yield[seen] = np.maximum((1.0 - _NEWEST) * self._yield[seen] + _NEWEST * share, _SMALLEST_YIELD)
        self._tried = (cell[:0], ids[:0])

    def _usual_disparity(self, kept: Tracks, count: int) -> Array:
        usual = float(np.median(kept.pixels[:, 0] - kept.pixels[:, 2])) if len(kept) else 0.0
        return np.full(count, usual)

    def _matched(
        self,
        left: Picture,
        right: Picture,
        at: Array,
        *,
        disparity: Array,
        distance: Array,
        track: IntArray | None,
    ) -> tuple[Tracks, BoolArray]:
        """Match pixels of the left image to the right one from predicted disparities; which could be."""
        config = self.config
        own = self.pair.rectify_left(at)
        guess = self.pair.raw_right(own - np.column_stack([disparity, np.zeros(len(at))]))
        guess = np.where(np.isnan(guess), at, guess)
        levels, farthest = config.predicted_levels, config.forward_backward_px
        if track is None:
            levels, farthest, track = config.levels, config.first_forward_backward_px, np.arange(len(at))
        end, apart, found = follow(
            left, right, at, guess=guess, levels=levels, farthest=farthest, config=config
        )
        pixels = np.column_stack([own, self.pair.rectify_right(end)])
        with np.errstate(invalid="ignore"):
            fits = (
                (np.abs(pixels[:, 1] - pixels[:, 3]) <= config.row_difference_px)
                & (pixels[:, 0] - pixels[:, 2] >= config.minimum_disparity_px)
                & self._narrow(own)
            )
        return Tracks(track, at, end, pixels, np.column_stack([distance, apart])), found & fits

    def _narrow(self, rectified: Array) -> BoolArray:
        rig = self.pair.rig
        off = (rectified - [rig.cx, rig.cy]) / [rig.fx, rig.fy]
        return np.asarray(np.linalg.norm(off, axis=1) <= np.tan(np.radians(self.config.widest_deg)))
