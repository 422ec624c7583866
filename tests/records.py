"""A record of a drive made by hand, and runs altered, for tests of what is computed from them."""

from dataclasses import replace

import numpy as np

from vislam.core.record import Record, Tracks
from vislam.core.run import Cost, Innovations, Log
from vislam.core.trajectory import Landmarks, Poses
from vislam.models import CAMERA_AXES, StereoRig


def no_tracks():
    return Tracks(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))


def made_record(reference=None, *, frames=400, **values):
    imu_T_cam = np.eye(4)
    imu_T_cam[:3, :3] = CAMERA_AXES
    plain = {
        "name": "drive",
        "synthetic": True,
        "digest": "",
        "notes": (),
        "counts": {},
        "repairs": (),
        "stamp": 0.1 * np.arange(frames),
        "rig": StereoRig(500.0, 500.0, 640.0, 180.0, 0.5, imu_T_cam),
        "given": no_tracks(),
        "held_out": no_tracks(),
        "reference": reference,
        "common_set": None,
        "provenance": {"date": "", "cpu": ""},
    }
    return Record(**{**plain, **values})


_PARTS = {
    field: part
    for part, kind in {"innovations": Innovations, "cost": Cost, "map": Landmarks, "log": Log}.items()
    for field in kind.__dataclass_fields__
}


def altered(run, **values):
    """The run with other values of some fields, whichever part they are in; ``cov`` is of the final poses."""
    for name, value in values.items():
        part = _PARTS.get(name)
        if name in Poses.__dataclass_fields__:
            part = "filtered" if run.smoothed is None else "smoothed"
        inside = value if part is None else replace(getattr(run, part), **{name: value})
        run = replace(run, **{part or name: inside})
    return run


def on_frames(run, rows):
    """The run with some of its frames only."""

    def of(part):
        """Rows of all arrays of a part."""
        values = {name: getattr(part, name) for name in part.__dataclass_fields__}
        return replace(part, **{name: value[rows] for name, value in values.items() if np.ndim(value)})

    return replace(
        run,
        frame=run.frame[rows],
        stamp=run.stamp[rows],
        filtered=of(run.filtered),
        smoothed=None if run.smoothed is None else of(run.smoothed),
        states={name: of(state) for name, state in run.states.items()},
        innovations=of(run.innovations),
        cost=of(run.cost),
        lagged=None,
    )
