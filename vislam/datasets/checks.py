"""Checks that readers have in common: what numbers of a recording can be, whatever file they come from."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.models import StereoRig

UNSEEN = -1.0
"""Pixel of a track that a frame does not have, in files with a cell for each track in each frame."""
LARGEST_STAMP = 1e20
"""Nanoseconds since 1970 are read, to be told from seconds by their steps."""
LARGEST_NUMBER = 1e6
"""Of pixels and lengths [px, m]: beyond it a number is no measurement, and squares of squares overflow."""
LARGEST_TWIST = 200.0
"""Of velocities [rad/s, m/s]; no camera that is carried is faster."""
LARGEST_FORCE = 2000.0
"""Of the specific force [m/s^2]: some 200 times that at rest, more than what navigates can measure."""
_SHORTEST_STEP = 1e-6
"""Frames closer in time than this are none [s]."""
_SHORTEST_BASELINE = 1e-4
_ROTATION_TOLERANCE = 1e-3
"""How far R^T R may be from the identity; the files carry seven digits."""


@dataclass(frozen=True)
class Checks:
    """Checks on the arrays of one file; what fails is a DataError that names file, key, expected and got."""

    path: Path

    def fail(self, key: str, expected: str, got: str) -> DataError:
        """Error that names the key, what was expected of it and what came."""
        return DataError(f"{self.path}: '{key}' must be {expected}, got {got}")

    def numbers(self, key: str, values: Array, *, largest: float = LARGEST_NUMBER, unit: str = "") -> Array:
        """Values that are finite and can be a measurement."""
        infinite = np.count_nonzero(~np.isfinite(values))
        if infinite:
            raise self.fail(key, "free of NaN and infinity", f"{infinite} of them")
        beyond = np.flatnonzero(np.abs(values) > largest)
        if len(beyond):
            got = f"{values.reshape(-1)[beyond[0]]:g}"
            if unit:
                got = f"{got}: is it in another unit?"
            raise self.fail(key, f"made of numbers up to {largest:g}{unit and ' '}{unit}", got)
        return values

    def shaped(self, key: str, values: Array, shape: tuple[int, ...]) -> Array:
        """Values of a shape."""
        if values.shape != shape:
            raise self.fail(key, f"of shape {shape}", f"{values.shape}")
        return values

    def stamps(self, key: str, stamp: Array, *, least: int = 2) -> Array:
        """Stamps ``(T,)`` [s] that increase, from any array of that many numbers."""
        if stamp.size != max(stamp.shape, default=0) or stamp.size < least:
            raise self.fail(key, f"of shape (T,) or (1, T) with T at least {least}", f"{stamp.shape}")
        stamp = stamp.reshape(-1)
        wrong = np.flatnonzero(np.diff(stamp) < _SHORTEST_STEP)
        if len(wrong):
            raise self.fail(
                key,
                "increasing [s]",
                f"{stamp[wrong[0] + 1]:.6f} after {stamp[wrong[0]]:.6f} at frame {wrong[0] + 1}",
            )
        return stamp

    def rig(self, key: str, matrix: Array, *, baseline: float, imu_T_cam: Array) -> StereoRig:
        """Rig of an intrinsic matrix ``(3, 3)``, of the given name, and what else has been checked."""
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        plain = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        if not (np.allclose(matrix, plain, atol=1e-9) and min(fx, fy) >= 1.0 and min(cx, cy) > 0):
            raise self.fail(
                key,
                "an intrinsic matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx, fy >= 1, cx, cy > 0 [px]",
                f"{matrix.tolist()}",
            )
        return StereoRig(float(fx), float(fy), float(cx), float(cy), baseline, imu_T_cam)

    def baseline(self, key: str, value: Array) -> float:
        """One length that two cameras can be apart [m]."""
        value = value.reshape(-1)
        if len(value) != 1 or value[0] < _SHORTEST_BASELINE:
            raise self.fail(key, "one baseline > 0 [m]", f"{value[:2].tolist()} of {len(value)}")
        return float(value[0])

    def rigid(self, key: str, pose: Array) -> Array:
        """Rigid transform ``(4, 4)``, its rotation made one to the last digit."""
        rotation = pose[:3, :3]
        off, determinant = so3.defect(rotation)
        if off > _ROTATION_TOLERANCE or determinant < 0 or np.any(pose[3] != [0, 0, 0, 1]):
            raise self.fail(
                key,
                "a rigid transform (rotation, determinant +1, last row 0 0 0 1)",
                f"R^T R off by {off:.2g}, determinant {determinant:.3g}, last row {pose[3].tolist()}",
            )
        u, _, vt = np.linalg.svd(rotation)
        return se3.from_rotation_translation(u @ vt, pose[:3, 3])

    def dense(self, key: str, pixels: Array) -> "Observations":
        """Observations of an array ``(4, M, T)`` of uL, vL, uR, vR, ``UNSEEN`` where a frame has no track."""
        seen = pixels != UNSEEN
        whole = seen.all(axis=0)
        frame, track = np.nonzero(whole.T)
        found = self.numbers(key, pixels[:, track, frame].T)
        return Observations(frame, track, found, int(np.count_nonzero(seen.any(axis=0) & ~whole)))


@dataclass(frozen=True)
class Observations:
    """Stereo observations, frame after frame.

    Attributes
    ----------
    frame, track : (n,)
    pixels : (n, 4)
        uL, vL, uR, vR [px].
    incomplete : int
        Cells of the file that had a part of the four only, and were dropped.
    """

    frame: IntArray
    track: IntArray
    pixels: Array
    incomplete: int

    def offset(self, frames: int) -> IntArray:
        """Where the observations of each frame begin, ``(T + 1,)``."""
        counts = np.bincount(self.frame, minlength=frames)
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    def sequence(self, name: str, *, stamp: Array, twist: Array, rig: StereoRig, digest: str) -> Sequence:
        """Sequence of a file whose twist ``(T, 6)`` has a sample a frame, and no vertical velocity."""
        frames = len(stamp)
        return Sequence(
            name=name,
            stamp=stamp,
            inertial_stamp=stamp,
            twist=twist,
            vertical_velocity=np.full(frames, np.nan),
            rig=rig,
            offset=self.offset(frames),
            track=self.track,
            pixels=self.pixels,
            row=np.arange(len(self.track)),
            digest=digest,
            counts=self.counts(frames),
        )

    def counts(self, frames: int) -> dict[str, int]:
        """What was read."""
        return {
            "frames": frames,
            "feature_columns": len(np.unique(self.track)),
            "observations_read": len(self.track),
            "observations_incomplete": self.incomplete,
        }
