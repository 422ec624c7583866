"""Recordings of images that can be fetched as ZIP archives, of which most publish no checksum.

An archive goes to the disk as it comes, under a temporary name, and is unpacked beside: what has the name of
a recording is whole. Each file in a ZIP has a CRC-32, which is checked; a SHA-256 is, where one is known, and
is reported in any case.
"""

import hashlib
import re
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from vislam.base.errors import DataError, first_line
from vislam.datasets.download import RefusedError, download_unsized

EUROC = (
    *("MH_01_easy", "MH_02_easy", "MH_03_medium", "MH_04_difficult", "MH_05_difficult"),
    *("V1_01_easy", "V1_02_medium", "V1_03_difficult", "V2_01_easy", "V2_02_medium", "V2_03_difficult"),
)
"""Sequences of EuRoC (Burri et al. 2016)."""
KITTI_RAW = "DATE_drive_NNNN_sync or DATE_drive_NNNN_extract"
"""How a drive of KITTI raw is named, as 2011_09_26_drive_0001_sync."""
_DRIVE = re.compile(r"(?P<day>\d{4}_\d\d_\d\d)_drive_\d{4}_(?:sync|extract)")
_EUROC_URL = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset"
_EUROC_PAGE = "https://doi.org/10.3929/ethz-b-000690084"
_KITTI_URL = "https://s3.eu-central-1.amazonaws.com/avg-kitti/raw_data"
_KITTI_PAGE = "https://www.cvlibs.net/datasets/kitti/raw_data.php"
_HALLS = {"MH": "machine_hall", "V1": "vicon_room1", "V2": "vicon_room2"}
_CALIBRATION = ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt")
_NOT_OURS = "__MACOSX"


@dataclass(frozen=True)
class Archive:
    """A ZIP archive and what is taken of it.

    Attributes
    ----------
    file : str
        Its name, behind ``--base-url``.
    url : str
    into : str
        Folder, in that of all recordings, in which it is unpacked.
    gives : tuple of str
        Paths in it that are kept.
    sha256 : str or None
        None: none is published.
    """

    file: str
    url: str
    into: str
    gives: tuple[str, ...]
    sha256: str | None = None


@dataclass(frozen=True)
class ImageSet:
    """A recording of images, in one archive or more.

    Attributes
    ----------
    name : str
    archives : tuple of Archive
    folder : str
        Where it is then, in the folder of all recordings.
    page : str
        Where it can be had by hand.
    """

    name: str
    archives: tuple[Archive, ...]
    folder: str
    page: str


def image_set(name: str) -> ImageSet | None:
    """The recording of that name; None if it is none of EuRoC's or of KITTI raw's."""
    if name in EUROC:
        url = f"{_EUROC_URL}/{_HALLS[name[:2]]}/{name}/{name}.zip"
        return ImageSet(name, (Archive(f"{name}.zip", url, name, ("mav0",)),), name, _EUROC_PAGE)
    match = _DRIVE.fullmatch(name)
    if match is None:
        return None
    day, drive = match["day"], name.rpartition("_")[0]
    calibration = Archive(
        f"{day}_calib.zip",
        f"{_KITTI_URL}/{day}_calib.zip",
        "",
        tuple(f"{day}/{file}" for file in _CALIBRATION),
    )
    images = Archive(f"{name}.zip", f"{_KITTI_URL}/{drive}/{name}.zip", "", (f"{day}/{name}",))
    return ImageSet(name, (calibration, images), f"{day}/{name}", _KITTI_PAGE)


def fetch_images(
    wanted: ImageSet,
    *,
    folder: Path,
    base_url: str | None,
    timeout: float,
    deadline: float | None,
    say: Callable[[str], None],
    watch: Callable[[int], None],
) -> Path:
    """Bring a recording into a folder, what of it is not there yet, and return its own.

    Raises
    ------
    DataError
        If it cannot be had, or an archive is damaged; archives that came before stay unpacked.
    """
    for archive in wanted.archives:
        target = folder / archive.into
        if all((target / path).exists() for path in archive.gives):
            say(f"{archive.file}: already unpacked in {target}, not downloaded again")
            continue
        target.mkdir(parents=True, exist_ok=True)
        # Beside what it becomes, so that it is renamed and not copied.
        with tempfile.TemporaryDirectory(prefix=".fetching-", dir=target) as place:
            digest = _download(
                archive,
                Path(place),
                page=wanted.page,
                base_url=base_url,
                timeout=timeout,
                deadline=deadline,
                watch=watch,
            )
            _unpack(archive, Path(place), target)
        checked = "as pinned" if archive.sha256 is not None else "none is published to compare with"
        say(f"{archive.file}: downloaded and unpacked in {target}; SHA-256 {digest}, {checked}")
    return folder / wanted.folder


class _Sink:
    """A file on the disk that knows how much is in it."""

    def __init__(self, path: Path, watch: Callable[[int], None]) -> None:
        self.wanted, self.size, self.hash = True, 0, hashlib.sha256()
        self._file, self._watch = path.open("wb"), watch

    def write(self, chunk: bytes) -> None:
        if not self.wanted:
            raise ValueError("expected before the deadline")
        self._file.write(chunk)
        self.size += len(chunk)
        self.hash.update(chunk)
        self._watch(self.size)

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def _download(
    archive: Archive,
    place: Path,
    *,
    page: str,
    base_url: str | None,
    timeout: float,
    deadline: float | None,
    watch: Callable[[int], None],
) -> str:
    """Have the archive in a folder and return its SHA-256."""
    url = archive.url if base_url is None else f"{base_url.rstrip('/')}/{archive.file}"
    sink = _Sink(place / archive.file, watch)
    try:
        download_unsized(url, sink, timeout=timeout, deadline=deadline)
        digest = sink.hash.hexdigest()
        if archive.sha256 not in (None, digest):
            raise RefusedError(f"expected sha256 {archive.sha256}, got {digest}")
    except RefusedError as error:
        raise DataError(
            f"{archive.file}: could not be fetched; {url}: {error}; check the connection and try again, name "
            f"another server with --base-url, or get it from {page} and unpack it"
        ) from None
    finally:
        sink.close()
    return digest


def _unpack(archive: Archive, place: Path, target: Path) -> None:
    """Unpack what an archive gives, and give it its name."""
    inside = place / "unpacked"
    try:
        with zipfile.ZipFile(place / archive.file) as file:
            members = [item for item in file.infolist() if _is_wanted(item, archive)]
            size, free = sum(item.file_size for item in members), shutil.disk_usage(place).free
            if size > free:
                raise DataError(
                    f"{archive.file}: no room in {target}: {size} bytes unpacked, {free} are free"
                )
            for item in members:
                file.extract(item, inside)
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, EOFError, ValueError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"{archive.file}: is no ZIP archive that can be read ({first_line(error)})") from None
    for path in archive.gives:
        if not (inside / path).exists():
            raise DataError(f"{archive.file}: must have {path}, which is not in it")
    for path in archive.gives:
        goal = target / path
        goal.parent.mkdir(parents=True, exist_ok=True)
        if not goal.exists():
            (inside / path).rename(goal)


def _is_wanted(item: zipfile.ZipInfo, archive: Archive) -> bool:
    """Whether a member is of what the archive gives; one that would leave the folder is refused."""
    path = PurePosixPath(item.filename)
    if path.is_absolute() or ".." in path.parts:
        raise DataError(f"{archive.file}: has a file {item.filename!r}, which lies outside of it")
    return _NOT_OURS not in path.parts and any(path.is_relative_to(given) for given in archive.gives)
