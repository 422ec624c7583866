"""Which tracks end when, and how they are packed."""

import numpy as np

from vislam.core.frame import Frame, OdometryStep, StereoFrame
from vislam.estimators.msckf.pending import Pending


def frame(k, tracks, usable=None):
    n = len(tracks)
    z = np.column_stack([np.full(n, 100.0 * k), np.array(tracks, float), np.zeros(n)])
    usable = np.ones(n, bool) if usable is None else np.array(usable)
    stereo = StereoFrame(np.array(tracks, np.int64), z, np.ones((n, 3)), usable)
    return Frame(k, 0.1 * k, 0.1, stereo, OdometryStep(np.zeros(6), np.zeros(6), np.nan))


def released(pending, in_view, *, longest=100, oldest=-1):
    return pending.release(np.array(in_view, np.int64), longest=longest, oldest=oldest)


def test_a_track_is_given_out_when_it_is_out_of_view_long_or_about_to_leave():
    pending = Pending()
    pending.take(frame(0, [7, 3]))
    pending.take(frame(1, [3, 7, 5], [True, False, True]))
    assert len(released(pending, [3, 5, 7])) == 0
    ended = released(pending, [3, 5])
    assert (ended.track.tolist(), ended.length.tolist()) == ([7], [1])
    pending.take(frame(2, [5, 3]))
    long = released(pending, [3, 5], longest=3)
    assert long.track.tolist() == [3]
    assert long.frame.tolist() == [[0, 1, 2]]
    assert long.z[0, :, 0].tolist() == [0.0, 100.0, 200.0]
    pending.take(frame(3, [3, 5]))
    assert released(pending, [3, 5], oldest=0).track.tolist() == []
    assert released(pending, [3, 5], oldest=1).track.tolist() == [5]
    # The rest of a track that goes on is another one.
    last = released(pending, [])
    assert (last.track.tolist(), last.frame.tolist()) == ([3], [[3]])


def test_each_observation_is_given_out_once(rng):
    pending, given, taken = Pending(), [], []
    for k in range(40):
        tracks = np.flatnonzero(rng.random(30) < 0.6)
        usable = rng.random(len(tracks)) < 0.8
        pending.take(frame(k, tracks, usable))
        taken += [(k, track) for track in tracks[usable]]
        given.append(released(pending, tracks, longest=6, oldest=k - 10))
    given.append(released(pending, []))
    pairs = [pair for part in given for pair in zip(*part.pairs(), strict=True)]
    assert sorted(pairs) == sorted(taken)
    for part in given:
        assert (part.length <= 6).all()
        assert np.array_equal(np.isfinite(part.sigma[:, :, 0]), part.seen)
        assert (
            part.z[:, :, 1][part.seen] == np.broadcast_to(part.track[:, None], part.seen.shape)[part.seen]
        ).all()
