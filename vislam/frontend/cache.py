"""Tracks that were made before, found by the hash of the images and the settings."""

import hashlib
import json
import shutil
from importlib.util import find_spec
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.base.files import replace_whole
from vislam.base.progress import Progress
from vislam.core.images import Content, ImageRecording, StampedPoses
from vislam.core.strip import strip_path
from vislam.datasets.download import cache_folder
from vislam.frontend.registry import Chosen

_DIGITS = 20
_SOURCES = Path(__file__).parents[1]
_ROOMS = (
    "frontend",
    "models",
    "geometry",
    "core/images.py",
    "core/imu.py",
    "core/rigid_fit.py",
    "datasets/image_lists.py",
)
"""Sources on which the tracks depend."""


def require_opencv() -> None:
    """Raise ConfigError, with the remedy, if OpenCV is not installed."""
    if find_spec("cv2") is None:
        raise ConfigError(
            "tracks of images need OpenCV, which is not installed: pip install 'vislam[images]'"
        )


def tracks_of(
    recording: ImageRecording, chosen: Chosen, *, progress: Progress, fresh: bool = False
) -> tuple[Path, bool]:
    """File with the tracks of a recording in the user's cache, made if it is not there.

    Parameters
    ----------
    recording : ImageRecording
    chosen : Chosen
        Front end and settings.
    progress : Progress
    fresh : bool
        Whether to make it even if it is there.

    Returns
    -------
    path : Path
        The tracks; what the front end has to say of them lies beside.
    made : bool
        Whether they were made now.

    Raises
    ------
    ConfigError
        If OpenCV is not installed.
    DataError
        If the images cannot be used.
    """
    require_opencv()
    from vislam.frontend.track import track  # noqa: PLC0415
    from vislam.frontend.track_file import write_tracked  # noqa: PLC0415

    digest = _digest(recording, chosen, progress)
    path = cache_folder() / "tracks" / digest / "tracks.npz"
    if path.is_file() and not fresh:
        return path, False
    tracked = track(recording, chosen.reading, progress=progress, build=chosen.build)
    write_tracked(path, recording, tracked, chosen)
    return path, True


def copy_tracks(source: Path, target: Path) -> None:
    """Copy a file of tracks and what lies beside it."""
    from vislam.frontend.track_file import quality_path, reference_path, summary_path  # noqa: PLC0415

    for part in (quality_path, summary_path, reference_path, strip_path, lambda path: path):
        if part(source).is_file():
            with replace_whole(part(target)) as temporary:
                shutil.copyfile(part(source), temporary)


def _digest(recording: ImageRecording, chosen: Chosen, progress: Progress) -> str:
    """Hash of all that the tracks depend on."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        place = _SOURCES / room
        for source in [place] if place.is_file() else sorted(place.rglob("*.py")):
            digest.update(source.read_bytes())
    digest.update(json.dumps([chosen.name, chosen.settings, chosen.origin], default=str).encode())
    digest.update(f"{_opencv_version()}|{recording.name}|{recording.pair}|{recording.counts}".encode())
    digest.update(recording.stamp.tobytes())
    inertia, reference = recording.inertia, recording.reference
    if inertia is not None:
        arrays = (inertia.stamp, inertia.gyro, inertia.velocity, inertia.accelerometer)
        digest.update(b"|".join(b"" if array is None else array.tobytes() for array in arrays))
        digest.update(f"{inertia.noise}".encode())
    if isinstance(reference, StampedPoses):
        digest.update(reference.stamp.tobytes() + reference.world_T_imu.tobytes())
    with progress.bar("reading", len(recording)) as bar:
        for count, contents in enumerate(zip(recording.left, recording.right, strict=True), 1):
            for content in contents:
                digest.update(_content(content))
            bar.done(count)
    return digest.hexdigest()[:_DIGITS]


def _content(content: Content | None) -> bytes:
    """Hash of an image; one that cannot be read has the hash of nothing."""
    if content is None:
        return b""
    if isinstance(content, bytes):
        return hashlib.sha256(content).digest()
    layout = (content.encoding, content.height, content.width, content.step, content.big_endian)
    return hashlib.sha256(f"{layout}".encode() + content.data.tobytes()).digest()


def _opencv_version() -> str:
    import cv2  # noqa: PLC0415

    return str(cv2.__version__)
