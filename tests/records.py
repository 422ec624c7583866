"""A record of a drive made by hand, for tests of what is computed from one."""

import numpy as np

from vislam.core.record import Record, Tracks
from vislam.models import CAMERA_AXES, StereoRig


def no_tracks():
    return Tracks(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))


def made_record(reference=None, *, frames=400, **values):
    imu_T_cam = np.eye(4)
    imu_T_cam[:3, :3] = CAMERA_AXES
    plain = {
        "name": "drive",
        "stand_in": True,
        "digest": "",
        "notes": (),
        "counts": {},
        "repairs": (),
        "stamp": 0.1 * np.arange(frames),
        "rig": StereoRig(500.0, 500.0, 640.0, 180.0, 0.5, imu_T_cam),
        "given": no_tracks(),
        "held_out": no_tracks(),
        "reference": reference,
        "frozen": None,
        "provenance": {"date": "", "cpu": ""},
    }
    return Record(**{**plain, **values})
