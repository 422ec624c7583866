"""Files that the front end writes: the tracks in the open track format, and what it has to say of them."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.files import replace_whole, write_text
from vislam.base.types import Array
from vislam.core.images import ImageRecording, StampedPoses
from vislam.datasets.export import write_tum
from vislam.frontend.settings import FrontEndConfig
from vislam.frontend.track import Tracked, reference_frames

_VERSION = 1


def quality_path(path: Path) -> Path:
    """File beside the tracks with the quality of each observation."""
    return path.with_name(f"{path.stem}_quality.npz")


def summary_path(path: Path) -> Path:
    """File beside the tracks with settings, counts and figures."""
    return path.with_name(f"{path.stem}_front_end.json")


def reference_path(path: Path) -> Path:
    """File beside the tracks with the reference poses that were made of the recording, if it has any."""
    return path.with_name(f"{path.stem}_reference.tum")


def write_tracked(path: Path, recording: ImageRecording, tracked: Tracked, config: FrontEndConfig) -> None:
    """Write the tracks, and what belongs to them in files beside.

    The tracks are in the open track format (``docs/reference/track_format.md``), with the reference poses
    that were made of it; these go into ``*_reference.tum``, too. ``*_quality.npz`` has
    ``forward_backward_px (n, 2)``, in the order of the observations: the distance there and back of each from
    the frame before (0 for the first of a track) and to the right image; and ``life (n,)``, the observations
    of its track. ``*_front_end.json`` has the settings, counts and figures.
    """
    sequence, rig = tracked.sequence, tracked.sequence.rig
    arrays: dict[str, Array | np.ndarray[Any, Any]] = {
        "version": np.array(_VERSION),
        "stamp": sequence.stamp,
        "frame": sequence.frame_of,
        "track": sequence.track,
        "pixels": sequence.pixels,
        "K": np.array([[rig.fx, 0.0, rig.cx], [0.0, rig.fy, rig.cy], [0.0, 0.0, 1.0]]),
        "baseline": np.array(rig.baseline),
        "imu_T_cam": rig.imu_T_cam,
        "inertial_stamp": sequence.inertial_stamp,
        "angular_velocity": sequence.twist[:, :3],
        "linear_velocity": sequence.twist[:, 3:],
    }
    if isinstance(recording.reference, StampedPoses):
        frame, pose = reference_frames(tracked, recording.reference)
        if len(frame):
            arrays |= {"reference_frame": frame, "reference_pose": pose}
    quality = {
        "forward_backward_px": tracked.distance,
        "life": np.bincount(sequence.track)[sequence.track],
    }
    summary = {
        "recording": recording.name,
        "settings": asdict(config),
        "counts": tracked.counts,
        "figures": tracked.figures,
        "velocity": recording.inertia is not None and recording.inertia.velocity is not None,
        "levelled": recording.levelled,
    }
    if isinstance(recording.reference, StampedPoses):
        write_tum(reference_path(path), recording.reference.stamp, recording.reference.world_T_imu)
    _write_arrays(quality_path(path), quality)
    write_text(summary_path(path), json.dumps(summary, indent=2) + "\n")
    _write_arrays(path, arrays)


def _write_arrays(path: Path, arrays: dict[str, Any]) -> None:
    with replace_whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
