"""The tracks of a smoother: which wait, which are landmarks of the graph, which have ended."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.estimators.smoother.keys import landmark
from vislam.estimators.smoother.past import Past
from vislam.estimators.smoother.starting import Start, starts
from vislam.models import CameraErrors, StereoRig

_CHUNK = 512
"""Tracks that are triangulated together."""
_PATIENCE = 5
"""Frames on end without any landmark after which tracks start although their residuals are too large."""


@dataclass(frozen=True, slots=True)
class View:
    """One stereo observation of a track: frame, ``z (3,)`` and ``sigma (3,)`` [px]."""

    k: int
    z: Array
    sigma: Array


@dataclass(slots=True)
class Track:
    """A track and, once it is one, its landmark.

    Attributes
    ----------
    id : int
        Its id in the sequence.
    views : list of View
    key : int
        Key of its landmark; 0 while it waits.
    slots : list of int
        Where its factors are in the solver.
    point : (3,)
        Its landmark as estimated when it was last in view [m].
    linearised : (3,)
        Where that was linearised last, to within the threshold of relinearisation [m].
    """

    id: int
    views: list[View] = field(default_factory=list)
    key: int = 0
    slots: list[int] = field(default_factory=list)
    point: Array = field(default_factory=lambda: np.zeros(3))
    linearised: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def frames(self) -> list[int]:
        """Frames of its views."""
        return [view.k for view in self.views]


class Tracks:
    """All tracks of a drive, each in one of four places.

    A track waits until its depth is clear, then it is a landmark in view; with the first frame that does not
    have it, it ends. A track whose landmark became degenerate is rejected for as long as it lasts. Where
    landmarks are seen again, a track that has ended comes back into view, and one that waits goes on waiting.

    Parameters
    ----------
    comes_back : bool
        Whether landmarks are seen again.

    Attributes
    ----------
    waiting, in_view : dict
        By the track's id.
    ended : dict
        Landmarks of the graph that are out of view, by the track's id.
    past : Past
        Landmarks that a lag has marginalised.
    too_weak, rejected, views_dropped : int
        Tracks that ended before their depth was clear, tracks that were rejected, and views of waiting
        tracks that were let go.
    """

    def __init__(self, *, comes_back: bool = False) -> None:
        self._comes_back = comes_back
        self.waiting: dict[int, Track] = {}
        self.in_view: dict[int, Track] = {}
        self.ended: dict[int, Track] = {}
        self.past = Past()
        self.too_weak = self.rejected = self.views_dropped = 0
        self._aside: set[int] = set()
        self._started = self._frames_without = 0

    @property
    def landmarks(self) -> list[Track]:
        """All tracks whose landmarks are in the graph, and some that a lag has marginalised lately."""
        return [*self.ended.values(), *self.in_view.values()]

    def take(self, frame: Frame, *, oldest: int = 0) -> list[Track]:
        """Add a frame's views; returns the landmarks that got one, in the frame's order.

        A landmark that was last seen before the frame ``oldest`` is not in the graph any more: its track
        starts another.
        """
        here = frame.stereo.track.tolist()
        present = set(here)
        self._aside &= present
        for gone in self.waiting.keys() - present if not self._comes_back else ():
            del self.waiting[gone]
            self.too_weak += 1
        for gone in sorted(self.in_view.keys() - present):
            self.ended[gone] = self.in_view.pop(gone)
        # One in view can be older, too: of a track that goes on no observation may have been usable for long.
        stale = [name for name, track in self.in_view.items() if track.views[-1].k < oldest]
        for back in (self.ended.pop(name) for name in self.ended.keys() & present):
            self._bring_back(back, oldest)
        for back in map(self.in_view.pop, stale):
            self._bring_back(back, oldest)
        for name in self.past.come_back(present):
            self.waiting[name] = Track(name)
        self._pass_on(2 * oldest - frame.k)
        seen = []
        for row in np.flatnonzero(frame.stereo.usable).tolist():
            name = here[row]
            if name in self._aside:
                continue
            view = View(frame.k, frame.stereo.z[row], frame.stereo.sigma[row])
            track = self.in_view.get(name)
            if track is not None:
                track.views.append(view)
                seen.append(track)
            else:
                self.waiting.setdefault(name, Track(name)).views.append(view)
        return seen

    def _bring_back(self, track: Track, oldest: int) -> None:
        """Take a landmark into view again, or let its track wait for another."""
        if track.views[-1].k >= oldest:
            self.in_view[track.id] = track
        else:
            self.past.add(track.id, track.frames, track.point, replaced=True)
            self.waiting[track.id] = Track(track.id)

    def _pass_on(self, oldest: int) -> None:
        """Keep of those that ended before a frame what the final estimate needs, the earliest first.

        The frame is a lag before that at which the lag begins: where a step is repeated, what it was to
        marginalise is still held.
        """
        while self.ended:
            name, track = next(iter(self.ended.items()))
            if track.views[-1].k >= oldest:
                break
            self.past.add(name, track.frames, track.point)
            del self.ended[name]

    def start(
        self,
        rig: StereoRig,
        errors: CameraErrors,
        poses: Sequence[Array],
        *,
        clear: float,
        most: int,
        oldest: int,
    ) -> list[Track]:
        """Make landmarks of those waiting tracks whose depth has become clear, and return them.

        What does not fit in the newest frame is not held against a track, for its pose is only predicted: no
        residual in it is looked at, and a track that is not ready with its view there may be without it.

        Parameters
        ----------
        rig : StereoRig
        errors : CameraErrors
            Shared errors of the pixels as known now.
        poses : sequence of (4, 4)
            Poses of all frames so far, the newest a prediction.
        clear : float
            How many standard deviations the disparity must be away from zero.
        most : int
            Views that a waiting track keeps.
        oldest : int
            First frame whose pose can still be tied to.
        """
        candidates = []
        for track in self.waiting.values():
            kept = [view for view in track.views[-most:] if view.k >= oldest]
            self.views_dropped += len(track.views) - len(kept)
            track.views = kept
            if len(kept) > 1:
                candidates.append(track)
        if not candidates:
            return []
        newest = len(poses) - 1
        found = locate(rig, errors, candidates, poses, clear=clear, predicted=newest)
        rest = np.flatnonzero(~found.ready)
        if len(rest):
            waiting = [candidates[index] for index in rest]
            without = locate(rig, errors, waiting, poses, clear=clear, predicted=newest, fitted=False)
            found = found.with_ready(rest, without)
        started = []
        self._frames_without = 0 if self.in_view or found.ready.any() else self._frames_without + 1
        ready = found.ready_alone if self._frames_without > _PATIENCE else found.ready
        for index in np.flatnonzero(ready).tolist():
            track = self.waiting.pop(candidates[index].id)
            track.key = landmark(self._started, float(found.depth[index]))
            self._started += 1
            track.point = track.linearised = found.points_world[index]
            self.in_view[track.id] = track
            started.append(track)
        return started

    def reject(self, tracks: Sequence[Track]) -> None:
        """Fuse these tracks no more."""
        if not tracks:
            # There are none at nearly all frames, and all that have ended are many.
            return
        for track in tracks:
            for place in (self.in_view, self.waiting):
                place.pop(track.id, None)
            self._aside.add(track.id)
        for track in tracks:
            if self.ended.get(track.id) is track:
                del self.ended[track.id]
        self.rejected += len(tracks)


def locate(
    rig: StereoRig,
    errors: CameraErrors,
    tracks: Sequence[Track],
    poses: Sequence[Array],
    *,
    clear: float,
    predicted: int | None = None,
    fitted: bool = True,
) -> Start:
    """Triangulate tracks from their views at given poses.

    Parameters
    ----------
    rig : StereoRig
    errors : CameraErrors
        Shared errors of the pixels.
    tracks : sequence of Track
    poses : sequence of (4, 4)
        ``poses[k]`` is that of frame k.
    clear : float
        How many standard deviations the disparity must be away from zero.
    predicted : int, optional
        Frame whose pose is a prediction: residuals in it are not looked at.
    fitted : bool
        Whether the points are fitted to the views in that frame.
    """
    counts = np.array([len(track.views) for track in tracks])
    order = np.argsort(counts, kind="stable")
    first = min(track.views[0].k for track in tracks)
    last = max(track.views[-1].k for track in tracks)
    near = np.array(poses[first : last + 1])
    parts = []
    for begin in range(0, len(order), _CHUNK):
        chosen = order[begin : begin + _CHUNK]
        views = [view for index in chosen for view in tracks[index].views]
        most = int(counts[chosen[-1]])
        at = np.arange(most) < counts[chosen, None]
        frames = np.repeat([[tracks[index].views[0].k] for index in chosen], most, axis=1)
        z = np.repeat([[tracks[index].views[0].z] for index in chosen], most, axis=1)
        sigma = np.full(z.shape, np.inf)
        frames[at] = [view.k for view in views]
        z[at] = [view.z for view in views]
        sigma[at] = [view.sigma for view in views]
        judged = at & (frames != predicted)
        if not fitted:
            sigma[~judged & (np.arange(most) > 0)] = np.inf
        z = errors.mended(z, rig)
        parts.append(starts(rig, near[frames - first], z, sigma, clear=clear, judged=judged))
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return Start(
        np.concatenate([part.points_world for part in parts])[back],
        np.concatenate([part.depth for part in parts])[back],
        np.concatenate([part.clear for part in parts])[back],
        np.concatenate([part.worst for part in parts])[back],
    )
