"""Files that the front end writes: the tracks in the open track format, and what it has to say of them."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from vislam.base.files import replace_whole, write_text
from vislam.core.images import ImageRecording, StampedPoses
from vislam.core.reference import Reference
from vislam.core.strip import strip_path
from vislam.datasets.export import write_tum
from vislam.datasets.recording import Recording
from vislam.datasets.tracks_npz import write_tracks_npz
from vislam.frontend.registry import Chosen
from vislam.frontend.track import Tracked, reference_frames


def quality_path(path: Path) -> Path:
    """File beside the tracks with the quality of each observation."""
    return path.with_name(f"{path.stem}_quality.npz")


def summary_path(path: Path) -> Path:
    """File beside the tracks with settings, counts and figures."""
    return path.with_name(f"{path.stem}_front_end.json")


def reference_path(path: Path) -> Path:
    """File beside the tracks with the reference poses that were made of the recording, if it has any."""
    return path.with_name(f"{path.stem}_reference.tum")


def write_tracked(path: Path, recording: ImageRecording, tracked: Tracked, chosen: Chosen) -> None:
    """Write the tracks, and what belongs to them in files beside.

    The tracks are in the open track format (``docs/reference/track_format.md``), with the reference poses
    that were made of it; these go into ``*_reference.tum``, too. ``*_quality.npz`` has ``forward_backward_px
    (n, 2)``, in the order of the observations: the forward-backward error of each from the frame before (0
    for the first of a track) and to the right image; and ``life (n,)``, the observations of its track.
    ``*_strip.npz`` has a few small pictures for the report. ``*_front_end.json`` has the settings, counts
    and figures.
    """
    sequence, reference = tracked.sequence, None
    if isinstance(recording.reference, StampedPoses):
        reference = _reference(tracked, recording.reference)
        write_tum(reference_path(path), recording.reference.stamp, recording.reference.world_T_imu)
    quality = {
        "forward_backward_px": tracked.distance,
        "life": np.bincount(sequence.track)[sequence.track],
    }
    noise = None if recording.inertia is None else recording.inertia.noise
    summary = {
        "recording": recording.name,
        "front_end": chosen.name,
        "settings": chosen.settings,
        "counts": tracked.counts,
        "figures": tracked.figures,
        "velocity": recording.inertia is not None and recording.inertia.velocity is not None,
        "gyro": recording.inertia is not None,
        "levelled": recording.levelled,
        "accelerometer": sequence.imu is not None,
        "imu_noise": None if noise is None else asdict(noise),
    }
    tracked.strip.save(strip_path(path))
    with replace_whole(quality_path(path)) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **quality)
    write_text(summary_path(path), json.dumps(summary, indent=2) + "\n")
    write_tracks_npz(path, Recording(sequence, reference))


def _reference(tracked: Tracked, poses: StampedPoses) -> Reference | None:
    """The poses as a reference by frames; None if no frame has one."""
    frame, pose = reference_frames(tracked, poses)
    if not len(frame):
        return None
    return Reference(
        name="poses of the recording",
        limits=poses.origin,
        frame=frame,
        position=pose[:, :3, 3],
        pose=pose,
        imu_T_point=np.eye(4),
    )
