"""Our own open format of stereo tracks: one ``.npz`` file, one row an observation.

What each key means, its shape, unit and frame are told in ``docs/reference/track_format.md``.
"""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.files import replace_whole
from vislam.base.legible import brief
from vislam.base.types import Array, IntArray
from vislam.core.imu import ImuSeries
from vislam.core.reference import Reference
from vislam.core.sequence import Sequence
from vislam.core.strip import Strip
from vislam.datasets.archive import Arrays, opened, sha256
from vislam.datasets.checks import LARGEST_FORCE, LARGEST_STAMP, LARGEST_TWIST, Observations
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import TracksNpz

PAGE = "docs/reference/track_format.md"
REQUIRED = (
    *("stamp", "frame", "track", "pixels", "K", "baseline", "imu_T_cam"),
    *("angular_velocity", "linear_velocity"),
)
IMU = ("imu_stamp", "imu_gyro", "imu_accel")
"""Keys of raw inertia: all of them or none. With them the velocities may be left out."""
OPTIONAL = (
    *IMU,
    *("version", "inertial_stamp", "vertical_velocity", "simulated"),
    *("reference_frame", "reference_pose", "landmark_track", "landmark_world"),
)
FORMER = {"climb_rate": "vertical_velocity"}
"""Keys of files of earlier versions, and what they are called now."""
TELLING = frozenset({"frame", "track", "pixels"})
"""Keys that no other format has together."""
_VERSION = 1
_MOST_OBSERVATIONS = 1 << 24
_FEWEST_IMU = 4
_LARGEST_ID = 10**6
"""Ids beyond it are renumbered: what counts tracks by their ids takes memory."""


def read(source: TracksNpz, opening: Opening) -> Recording:
    """Read a file of tracks as it stands."""
    return load_tracks_npz(opening.find(source.file))


def load_tracks_npz(path: Path) -> Recording:
    """Read a file of the open track format as it stands; nothing is repaired here.

    Raises
    ------
    DataError
        If the file is missing, broken, lacks keys, has unknown ones, or has a value that cannot be right.
    """
    with opened(path) as archive:
        return _Reader(Arrays(archive, path), path).recording()


class _Reader:
    """One open archive."""

    def __init__(self, arrays: Arrays, path: Path) -> None:
        self._arrays, self._checks, self._path = arrays, arrays.checks, path

    def recording(self) -> Recording:
        self._check_keys()
        small, checks = self._arrays.small, self._checks
        stamp = checks.stamps("stamp", small("stamp", largest=LARGEST_STAMP))
        seen, ids = self._observations(len(stamp))
        imu = self._imu()
        inertial_stamp, twist, rise = self._odometry(stamp, imu)
        rig = checks.rig(
            "K",
            small("K", (3, 3)),
            baseline=checks.baseline("baseline", small("baseline")),
            imu_T_cam=checks.rigid("imu_T_cam", small("imu_T_cam", (4, 4))),
        )
        sequence = Sequence(
            name=self._path.stem,
            stamp=stamp,
            inertial_stamp=inertial_stamp,
            twist=twist,
            vertical_velocity=rise,
            rig=rig,
            offset=seen.offset(len(stamp)),
            track=seen.track,
            pixels=seen.pixels,
            row=np.arange(len(seen.track)),
            synthetic="simulated" in self._arrays.keys and bool(small("simulated", ())),
            digest=sha256(self._path),
            counts={**seen.counts(len(stamp)), **({} if imu is None else imu.counts)},
            imu=imu,
        )
        reference = self._reference(len(stamp))
        points = None if reference is None else self._points(ids)
        made = (f"SIMULATED: the tracks of {self._path.name} are those of a simulation",)
        strip = Strip.beside(self._path, frames=len(sequence), observations=sequence.observations)
        return Recording(sequence, reference, points, made if sequence.synthetic else (), strip)

    def _check_keys(self) -> None:
        keys = self._arrays.keys
        velocities = ("angular_velocity", "linear_velocity")
        spared = velocities if keys.issuperset(IMU) and not keys.intersection(velocities) else ()
        asked = IMU if keys.intersection(IMU) else ()
        missing = [key for key in (*REQUIRED, *asked) if key not in keys and key not in spared]
        if missing:
            raise DataError(
                f"{self._path}: key {', '.join(map(repr, missing))} is missing; {PAGE} tells what each holds"
            )
        for former in FORMER.keys() & keys:
            if FORMER[former] in keys:
                raise DataError(
                    f"{self._path}: key {former!r} is the former name of {FORMER[former]!r}: give one of them"
                )
        unknown = sorted(keys - {*REQUIRED, *OPTIONAL, *FORMER})
        if unknown:
            raise DataError(
                f"{self._path}: key {brief(', '.join(map(repr, unknown)))} is unknown; optional are "
                f"{', '.join(OPTIONAL)}, see {PAGE}"
            )
        if "version" in keys and (version := float(self._arrays.small("version", ()))) != _VERSION:
            raise self._checks.fail("version", f"{_VERSION}", f"{version:g}: a newer vislam may read it")

    def _odometry(self, stamp: Array, imu: ImuSeries | None) -> tuple[Array, Array, Array]:
        """Stamps ``(S,)``, twist ``(S, 6)`` and vertical velocity ``(S,)`` of the inertial samples.

        Without velocities in the file the twist is that of the gyro, and its velocity is not measured, 0.
        """
        small, checks, keys = self._arrays.small, self._checks, self._arrays.keys
        if imu is not None and "angular_velocity" not in keys:
            twist = np.hstack([imu.gyro, np.zeros_like(imu.gyro)])
            return imu.stamp.copy(), twist, np.full(len(imu), np.nan)
        if "inertial_stamp" in keys:
            stamp = checks.stamps("inertial_stamp", small("inertial_stamp", largest=LARGEST_STAMP))
        samples = len(stamp)
        rate = small("angular_velocity", (samples, 3), largest=LARGEST_TWIST, unit="rad/s")
        velocity = small("linear_velocity", (samples, 3), largest=LARGEST_TWIST, unit="m/s")
        rise = np.full(samples, np.nan)
        for key in ("vertical_velocity", *FORMER):
            if key in keys:
                rise = small(key, (samples,), largest=LARGEST_TWIST, unit="m/s")
        return stamp, np.hstack([rate, velocity]), rise

    def _imu(self) -> ImuSeries | None:
        """Raw inertia, where the file has it."""
        if "imu_stamp" not in self._arrays.keys:
            return None
        small = self._arrays.small
        stamp = small("imu_stamp", largest=LARGEST_STAMP)
        if stamp.ndim != 1 or len(stamp) < _FEWEST_IMU:
            raise self._checks.fail("imu_stamp", f"of shape (N,), N at least {_FEWEST_IMU}", f"{stamp.shape}")
        shape = (len(stamp), 3)
        gyro = small("imu_gyro", shape, largest=LARGEST_TWIST, unit="rad/s")
        accel = small("imu_accel", shape, largest=LARGEST_FORCE, unit="m/s^2")
        back = np.count_nonzero(np.diff(stamp) <= 0.0)
        if 2 * back > len(stamp):
            raise self._checks.fail("imu_stamp", "increasing [s]", f"{back} of {len(stamp)} that are not")
        return ImuSeries.of(stamp, gyro, accel)

    def _whole(self, key: str, count: int | None, *, below: int | None = None) -> IntArray:
        """Whole numbers ``(n,)`` from 0 on."""
        values = self._arrays.small(key, None if count is None else (count,), largest=1e18)
        if values.ndim != 1:
            raise self._checks.fail(key, "of shape (n,)", f"{values.shape}")
        wrong = (values < 0) | (values != np.round(values))
        if below is not None:
            wrong |= values >= below
        if wrong.any():
            bound = "" if below is None else f" to {below - 1}"
            raise self._checks.fail(key, f"whole numbers from 0{bound}", f"{values[wrong][0]:g}")
        return values.astype(np.int64)

    def _observations(self, frames: int) -> tuple[Observations, IntArray]:
        """Observations by frame and track, and the ids that the file has for them."""
        frame = self._whole("frame", None, below=frames)
        track = self._whole("track", len(frame))
        pixels = self._arrays.small("pixels", (len(frame), 4), most=4 * _MOST_OBSERVATIONS)
        order = np.lexsort((track, frame))
        frame, track, pixels = frame[order], track[order], pixels[order]
        twice = np.flatnonzero((np.diff(frame) == 0) & (np.diff(track) == 0))
        if len(twice):
            got = f"track {track[twice[0]]} twice in frame {frame[twice[0]]}"
            raise self._checks.fail("track", "seen once in a frame at most", got)
        numbered = track
        if track.max(initial=0) > _LARGEST_ID:
            _, numbered = np.unique(track, return_inverse=True)
        return Observations(frame, numbered, pixels, 0), track

    def _reference(self, frames: int) -> Reference | None:
        if "reference_pose" not in self._arrays.keys:
            return None
        frame = np.arange(frames)
        if "reference_frame" in self._arrays.keys:
            frame = self._whole("reference_frame", None, below=frames)
            if np.any(np.diff(frame) <= 0):
                raise self._checks.fail("reference_frame", "increasing", "frames that are not")
        pose = self._arrays.small("reference_pose", (len(frame), 4, 4))
        pose = np.array([self._checks.rigid("reference_pose", one) for one in pose]).reshape(-1, 4, 4)
        return Reference(
            name="poses of the file",
            limits="as the file has them",
            frame=frame,
            position=pose[:, :3, 3],
            pose=pose,
            imu_T_point=np.eye(4),
        )

    def _points(self, ids: IntArray) -> Array | None:
        """Reference position of the point of each observation ``(n, 3)``, NaN where there is none."""
        if "landmark_world" not in self._arrays.keys:
            return None
        track = self._whole("landmark_track", None)
        points = self._arrays.small("landmark_world", (len(track), 3))
        order = np.argsort(track)
        track, points = track[order], points[order]
        if np.any(np.diff(track) == 0):
            raise self._checks.fail("landmark_track", "without repetitions", "some that are")
        out = np.full((len(ids), 3), np.nan)
        if len(track):
            place = np.minimum(np.searchsorted(track, ids), len(track) - 1)
            known = track[place] == ids
            out[known] = points[place[known]]
        return out


def write_tracks_npz(path: Path, recording: Recording) -> None:
    """Write a recording in the open track format, whole or not at all; the same one gives the same bytes.

    The reference landmark of a track that goes over to another point is left out.
    """
    sequence, reference = recording.sequence, recording.reference
    rig = sequence.rig
    arrays = {
        "version": np.array(_VERSION),
        "stamp": sequence.stamp,
        "frame": sequence.frame_of,
        "track": sequence.track,
        "pixels": sequence.pixels,
        "K": np.array([[rig.fx, 0.0, rig.cx], [0.0, rig.fy, rig.cy], [0.0, 0.0, 1.0]]),
        "baseline": np.array(rig.baseline),
        "imu_T_cam": rig.imu_T_cam,
        "inertial_stamp": sequence.inertial_stamp - sequence.clock_offset,
        "angular_velocity": sequence.twist[:, :3],
        "linear_velocity": sequence.twist[:, 3:],
    }
    if np.isfinite(sequence.vertical_velocity).all():
        arrays["vertical_velocity"] = sequence.vertical_velocity
    if sequence.imu is not None:
        arrays["imu_stamp"] = sequence.imu.stamp - sequence.clock_offset
        arrays["imu_gyro"], arrays["imu_accel"] = sequence.imu.gyro, sequence.imu.accel
    if sequence.synthetic:
        arrays["simulated"] = np.array(1)
    if reference is not None and reference.pose is not None:
        # Poses of the file are those of the body.
        arrays["reference_frame"] = reference.frame
        arrays["reference_pose"] = reference.pose @ np.linalg.inv(reference.imu_T_point)
        if recording.points_world is not None:
            arrays["landmark_track"], arrays["landmark_world"] = _landmarks(
                sequence.track, recording.points_world
            )
    with replace_whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _landmarks(track: IntArray, points_world: Array) -> tuple[IntArray, Array]:
    """Tracks of which all observations are of one known point, and the points."""
    ids, first, which = np.unique(track, return_index=True, return_inverse=True)
    points = points_world[first]
    other = np.bincount(which, weights=np.any(points_world != points[which], axis=1))
    known = np.isfinite(points).all(axis=1) & (other == 0)
    return ids[known], points[known]
