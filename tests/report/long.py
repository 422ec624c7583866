"""Results of a long sequence, made of those of a short one that is driven over and over."""

from dataclasses import replace

import numpy as np

from vislam.core.run import Innovations, StateHistory
from vislam.core.trajectory import Landmarks, Poses
from vislam.geometry import se3


def lengthened(run, record, times):
    """The run over a sequence that is ``times`` as long: each round begins where the one before ended."""
    frames, period = len(record.stamp), np.diff(record.stamp).mean()
    names = _names(record)
    at = _rounds(run.final.world_T_imu, times)

    def long(values):
        return np.concatenate([values] * times)

    def poses(found):
        if found is None:
            return None
        return Poses(_along(at, found.world_T_imu), None if found.cov is None else long(found.cov))

    landmarks = run.map
    if landmarks is not None:
        cov = None if landmarks.points_cov is None else _turned(at, landmarks.points_cov)
        track = _shifted(landmarks.track, times, by=names)
        landmarks = Landmarks(track, _moved(at, landmarks.points_world), cov)
    own = run.innovations
    return replace(
        run,
        frames_expected=frames * times,
        frame=_shifted(run.frame, times, by=frames),
        stamp=_stamps(run.stamp, times, by=frames * period),
        filtered=poses(run.filtered),
        smoothed=poses(run.smoothed),
        states={name: StateHistory(long(one.value), long(one.sigma)) for name, one in run.states.items()},
        innovations=Innovations(*(long(getattr(own, name)) for name in own.__dataclass_fields__)),
        cost=replace(run.cost, step_time=long(run.cost.step_time)),
        map=landmarks,
        used=long(run.used),
        gated=long(run.gated),
    )


def lengthened_record(record, times):
    """The record of that sequence; its reference is one of full poses at all frames."""
    frames, period, names = len(record.stamp), np.diff(record.stamp).mean(), _names(record)

    def tracks(own):
        return replace(
            own,
            frame=_shifted(own.frame, times, by=frames),
            track=_shifted(own.track, times, by=names),
            z=np.concatenate([own.z] * times),
            sigma=np.concatenate([own.sigma] * times),
        )

    reference = record.reference
    at = _rounds(reference.pose, times)
    pose = _along(at, reference.pose)
    common, twist = record.common_set, record.step_twist
    return replace(
        record,
        stamp=_stamps(record.stamp, times, by=frames * period),
        given=tracks(record.given),
        held_out=tracks(record.held_out),
        reference=replace(
            reference,
            frame=_shifted(reference.frame, times, by=frames),
            position=pose[:, :3, 3],
            pose=pose,
            track=_shifted(reference.track, times, by=names),
            points_world=_moved(at, reference.points_world),
        ),
        common_set=None if common is None else replace(common, kept=np.concatenate([common.kept] * times)),
        step_twist=None if twist is None else np.concatenate([twist] * times),
    )


def _names(record):
    return 1 + max(int(record.given.track.max()), int(record.held_out.track.max(initial=0)))


def _rounds(pose, times):
    """Where each round begins, seen from the first, ``(times, 4, 4)``."""
    step = se3.inverse(pose[0]) @ pose[1]
    further = pose[-1] @ step @ se3.inverse(pose[0])
    found = [np.eye(4)]
    for _ in range(times - 1):
        found.append(found[-1] @ further)
    return np.array(found)


def _along(at, pose):
    return (at[:, None] @ pose).reshape(-1, 4, 4)


def _moved(at, points):
    return se3.transform(at[:, None], points).reshape(-1, 3)


def _turned(at, cov):
    turn = at[:, None, :3, :3]
    return (turn @ cov @ turn.swapaxes(-1, -2)).reshape(-1, 3, 3)


def _shifted(values, times, *, by):
    return (values + by * np.arange(times)[:, None]).ravel()


def _stamps(stamp, times, *, by):
    return (stamp + by * np.arange(times)[:, None]).ravel()
