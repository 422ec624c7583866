"""From a recording of images to a sequence of tracks."""

import hashlib
import time
from dataclasses import dataclass

import cv2
import numpy as np

from vislam.base.errors import DataError
from vislam.base.progress import Progress
from vislam.base.types import Array, IntArray
from vislam.core.images import ImageRecording, Inertia, StampedPoses
from vislam.core.sequence import Sequence
from vislam.core.strip import Strip
from vislam.frontend.pictures import Pictures
from vislam.frontend.protocol import Build, checked, counts_of
from vislam.frontend.rows import row_rotation
from vislam.frontend.settings import ReadingConfig
from vislam.frontend.strip_taker import StripTaker, rows_by_frame
from vislam.frontend.tracker import build
from vislam.frontend.tracks import Tracks
from vislam.models.stereo_pair import StereoPair

_FEWEST = 2
"""Pairs that make a sequence."""


@dataclass(frozen=True)
class Tracked:
    """What the front end made of a recording.

    Attributes
    ----------
    sequence : Sequence
        The tracks; where the recording has no velocity, the twist's is 0.
    distance : (n, 2)
        Forward-backward distance of each observation from the frame before and to the right image [px].
    counts : dict
        What was read, left out and lost, and why.
    figures : dict
        Lives, rows and speed.
    strip : Strip
        Small pictures with observations.
    """

    sequence: Sequence
    distance: Array
    counts: dict[str, int]
    figures: dict[str, float]
    strip: Strip


def track(
    recording: ImageRecording, config: ReadingConfig, *, progress: Progress, build: Build = build
) -> Tracked:
    """Run a front end over a recording, one pair of images in memory at a time.

    Parameters
    ----------
    recording : ImageRecording
    config : ReadingConfig
        Settings of the reading, and, for our front end, a FrontEndConfig.
    progress : Progress
    build : callable
        Makes the front end of the recording and of ``config``; ours, if it is not named.

    Raises
    ------
    DataError
        If fewer than two pairs can be used, or no track is left.
    ContractError
        If what the front end returned is not what it may return.
    """
    # Others may have set it: what is measured here is one core, and the result is the same on any number.
    cv2.setNumThreads(1)
    started = time.perf_counter(), time.process_time()
    pictures = Pictures(recording, equalise=config.equalise)
    front_end = build(recording, config)
    kept: list[tuple[int, Tracks]] = []
    taker = StripTaker(len(recording))
    with progress.bar("tracking", len(recording)) as bar:
        for pictured in pictures:
            stamp = float(recording.stamp[pictured.index])
            found = front_end.process(pictured.left, pictured.right, stamp=stamp)
            if found is not None:
                found = checked(found, index=pictured.index).by_id()
                taker.offer(pictured.index, pictured.left, found, frame=len(kept))
                kept.append((pictured.index, found))
            bar.done(pictured.index + 1)
    seconds = time.perf_counter() - started[0], time.process_time() - started[1]
    counts = {**recording.counts, **pictures.counts, **counts_of(front_end), "frames": len(kept)}
    if len(kept) < _FEWEST:
        told = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
        raise DataError(f"{recording.left.place}: must have {_FEWEST} pairs that can be used ({told})")
    return _assembled(recording, config, kept, counts, taker=taker, seconds=seconds)


def _assembled(
    recording: ImageRecording,
    config: ReadingConfig,
    kept: list[tuple[int, Tracks]],
    counts: dict[str, int],
    *,
    taker: StripTaker,
    seconds: tuple[float, float],
) -> Tracked:
    """Put the frames together, without short tracks, and with rows that agree."""
    ids = np.concatenate([tracks.track for _, tracks in kept])
    _, ids = np.unique(ids, return_inverse=True)
    frame = np.repeat(np.arange(len(kept)), [len(tracks) for _, tracks in kept])
    life = np.bincount(ids)
    long_enough = life[ids] >= config.fewest_observations
    if not long_enough.any():
        told = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
        raise DataError(
            f"{recording.left.place}: no track of {config.fewest_observations} observations was "
            f"found ({told}); "
            "are left and right in order, and is the calibration of these images?"
        )
    pixels = np.concatenate([tracks.pixels for _, tracks in kept])[long_enough]
    right = np.concatenate([tracks.right for _, tracks in kept])[long_enough]
    pixels, figures = _rows_corrected(recording.pair, pixels, right, config)
    _, number = np.unique(ids[long_enough], return_inverse=True)
    stamp = recording.stamp[[index for index, _ in kept]]
    imu = None if recording.inertia is None else recording.inertia.series
    inertia = _with_velocity(recording.inertia, stamp)
    assert inertia.velocity is not None
    sequence = Sequence(
        name=recording.name,
        stamp=stamp,
        inertial_stamp=inertia.stamp.copy(),
        twist=np.hstack([inertia.gyro, inertia.velocity]),
        vertical_velocity=np.full(len(inertia.stamp), np.nan),
        rig=recording.pair.rig,
        offset=_offsets(frame[long_enough], len(kept)),
        track=number.astype(np.int64),
        pixels=pixels,
        row=np.arange(len(number)),
        digest=hashlib.sha256(pixels.tobytes() + stamp.tobytes()).hexdigest(),
        imu=imu,
    )
    lives = life[life >= config.fewest_observations]
    counts = {
        **counts,
        **({} if imu is None else {"imu_samples": len(imu), "imu_gaps": imu.counts["imu_gaps"]}),
        "tracks": len(lives),
        "observations": len(number),
        "tracks_too_short": len(life) - len(lives),
    }
    figures = {
        **figures,
        "life_median": float(np.median(lives)),
        "life_median_of_observations": float(np.median(np.repeat(lives, lives))),
        "in_view_median": float(np.median(np.diff(sequence.offset))),
        "frames_per_second": len(kept) / max(seconds[0], 1e-9),
        "frames_per_second_of_cpu": len(kept) / max(seconds[1], 1e-9),
    }
    distance = np.concatenate([tracks.distance for _, tracks in kept])[long_enough]
    strip = taker.strip(rows_by_frame(long_enough, _offsets(frame, len(kept))))
    return Tracked(sequence, distance, counts, figures, strip)


def _offsets(frame: IntArray, frames: int) -> IntArray:
    return np.concatenate([[0], np.cumsum(np.bincount(frame, minlength=frames))]).astype(np.int64)


def _rows_corrected(
    pair: StereoPair, pixels: Array, right: Array, config: ReadingConfig
) -> tuple[Array, dict[str, float]]:
    """Turn the right camera so that rows agree; what they were off by before and after."""
    off = pixels[:, 1] - pixels[:, 3]
    figures = {"row_error_px": float(np.median(off)), "row_spread_px": _spread(off)}
    rotation = row_rotation(pair.rig, pixels) if config.row_correction else None
    if rotation is not None:
        pixels = np.column_stack([pixels[:, :2], pair.turned_right(rotation).rectify_right(right)])
        off = pixels[:, 1] - pixels[:, 3]
        figures |= {
            "right_camera_turned_x_mrad": 1e3 * float(rotation[0]),
            "right_camera_turned_z_mrad": 1e3 * float(rotation[2]),
            "row_error_corrected_px": float(np.median(off)),
            "row_spread_corrected_px": _spread(off),
        }
    return pixels, figures


def _spread(values: Array) -> float:
    """Robust standard deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _with_velocity(inertia: Inertia | None, stamp: Array) -> Inertia:
    """Inertial samples with a velocity: 0 where none was measured."""
    if inertia is None:
        return Inertia(stamp, np.zeros((len(stamp), 3)), velocity=np.zeros((len(stamp), 3)))
    if inertia.velocity is not None:
        return inertia
    return Inertia(inertia.stamp, inertia.gyro, velocity=np.zeros_like(inertia.gyro))


def reference_frames(tracked: Tracked, poses: StampedPoses) -> tuple[IntArray, Array]:
    """Frames ``(m,)`` of a sequence that have a pose at their very stamp, and the poses ``(m, 4, 4)``."""
    _, frame, row = np.intersect1d(tracked.sequence.stamp, poses.stamp, return_indices=True)
    return frame.astype(np.int64), poses.world_T_imu[row]
