"""Lists of images of two cameras: sorted, looked for on the disk, and paired by their stamps."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import BoolArray, IntArray
from vislam.core.images import Content, Images

NANOSECONDS = 1e-9
_FEWEST = 2
_APART = 0.1
"""Share of the usual time between images by which the stamps of a pair may differ."""


@dataclass(frozen=True)
class ImageFiles:
    """Images that are files."""

    paths: tuple[Path, ...]

    @property
    def place(self) -> str:
        """Folder of the first."""
        return str(self.paths[0].parent) if self.paths else "no folder"

    def __len__(self) -> int:
        """Return the number of files."""
        return len(self.paths)

    def __iter__(self) -> Iterator[Content | None]:
        """Read one after the other."""
        for path in self.paths:
            try:
                yield path.read_bytes()
            except OSError:
                yield None

    def of(self, rows: "IntArray | BoolArray") -> "ImageFiles":
        """The files of a mask or of indices."""
        return ImageFiles(tuple(self.paths[row] for row in np.arange(len(self.paths))[rows]))

    def present(self) -> BoolArray:
        """Which of the files are there; each folder is listed once."""
        folders = {path.parent for path in self.paths}
        names = {
            folder: {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
            for folder in folders
        }
        return np.array([path.name in names[path.parent] for path in self.paths], dtype=bool)


@dataclass(frozen=True)
class Listed:
    """Images of one camera as its recording lists them.

    Attributes
    ----------
    stamp_ns : (n,)
        [ns].
    images : Images
    """

    stamp_ns: IntArray
    images: Images

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.images)

    def of(self, rows: "IntArray | BoolArray") -> "Listed":
        """The images of a mask or of indices."""
        return Listed(self.stamp_ns[rows], self.images.of(rows))


def paired(left: Listed, right: Listed, *, where: Path) -> tuple[Listed, Listed, dict[str, int]]:
    """Pairs of images that are there, in the order of their stamps, with counts of what is left out.

    A left image belongs to the right one nearest in time, if that is within a tenth of the usual time between
    images.

    Raises
    ------
    DataError
        If fewer than two pairs are left.
    """
    counts = {"images_listed": len(left) + len(right)}
    for side, listed in (("left", left), ("right", right)):
        counts[f"images_out_of_order_{side}"] = int(np.sum(np.diff(listed.stamp_ns) < 0))
    left, right = _sorted(left), _sorted(right)
    counts["images_duplicate"] = counts["images_listed"] - len(left) - len(right)
    present = [listed.images.present() for listed in (left, right)]
    for side, mask in zip(("left", "right"), present, strict=True):
        counts[f"images_missing_{side}"] = int(np.sum(~mask))
    left, right = left.of(present[0]), right.of(present[1])
    rows, partners = _matched(left.stamp_ns, right.stamp_ns)
    counts["images_unpaired"] = len(left) + len(right) - 2 * len(rows)
    counts["pairs"] = len(rows)
    if len(rows) < _FEWEST:
        told = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise DataError(f"{where}: must have {_FEWEST} pairs of images or more, got {len(rows)} ({told})")
    return left.of(rows), right.of(partners), counts


def _sorted(listed: Listed) -> Listed:
    """In the order of the stamps, the first image of each."""
    _, first = np.unique(listed.stamp_ns, return_index=True)
    return listed.of(first)


def _matched(left: IntArray, right: IntArray) -> tuple[IntArray, IntArray]:
    """Indices of both images of each pair, stamps increasing."""
    nothing = np.empty(0, np.int64)
    if not len(left) or not len(right):
        return nothing, nothing
    usual = float(np.median(np.diff(left))) if len(left) > 1 else np.inf
    after = np.clip(np.searchsorted(right, left), 1, max(len(right) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(right) - 1)
    nearest = np.where(np.abs(right[before] - left) <= np.abs(right[after] - left), before, after)
    rows = np.flatnonzero(np.abs(right[nearest] - left) <= _APART * usual)
    _, once = np.unique(nearest[rows], return_index=True)
    return rows[once], nearest[rows[once]]
