"""Trajectory files of any format: the registry, and how a format is guessed from the content.

``read_rows`` is the way in: it looks at the first bytes and the number of columns, reads, puts in order,
drops what is lost or double, and counts and says all of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from vislam.base.errors import DataError, first_line
from vislam.base.files import open_regular
from vislam.datasets.trajectory_formats import archive, bag, clean, matrices, positions, quaternions
from vislam.datasets.trajectory_formats.options import DEFAULT, ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.datasets.trajectory_formats.table import TextTable, read_text_table

__all__ = ["FORMATS", "ReadOptions", "Rows", "TrajectoryFormat", "guess", "read_rows"]


@dataclass(frozen=True)
class TrajectoryFormat:
    """A format of trajectory files.

    Attributes
    ----------
    name : str
    what : str
        A line, in one sentence.
    columns : tuple of int
        Numbers a line; empty for a format that is no text.
    more : bool
        Whether further columns may follow the last number of these.
    read_table, read_file : callable or None
        One of them: from a table, or from the file itself.
    """

    name: str
    what: str
    columns: tuple[int, ...] = ()
    more: bool = False
    read_table: Callable[[TextTable, ReadOptions], Rows] | None = None
    read_file: Callable[[Path, ReadOptions], Rows] | None = None

    @property
    def wanted(self) -> str:
        """What a line must hold."""
        return f"{' or '.join(map(str, self.columns))} finite numbers{' or more' if self.more else ''}"

    def fits(self, columns: int) -> bool:
        """Whether lines of this many numbers can be of the format."""
        return columns in self.columns or (self.more and columns > max(self.columns))


_ALL = (
    TrajectoryFormat("planar_xy", "frame x y", (3,), read_table=positions.planar_xy),
    TrajectoryFormat("kitti", "3 x 4 or 4 x 4 matrix by rows", (12, 16), read_table=matrices.kitti),
    TrajectoryFormat("kitti360", "frame, then the matrix", (13, 17), read_table=matrices.kitti360),
    TrajectoryFormat("tum", "stamp x y z qx qy qz qw", (8, 9), read_table=quaternions.tum),
    TrajectoryFormat(
        "euroc",
        "stamp [ns], x, y, z, qw, qx, qy, qz, more",
        (8,),
        more=True,
        read_table=quaternions.euroc,
    ),
    TrajectoryFormat("positions", "stamp x y z, covariance", (4, 10, 13), read_table=positions.positions),
    TrajectoryFormat("openvins", "tum, then 6 + 6 of covariances", (20,), read_table=quaternions.openvins),
    TrajectoryFormat("smfeval", "tum, then 21 of a covariance", (29,), read_table=quaternions.smfeval),
    TrajectoryFormat("tum_cov", "tum, then 36 of a covariance", (44,), read_table=quaternions.tum_cov),
    TrajectoryFormat("matrices", "stamp, then the matrix", (13, 17), read_table=matrices.stamped_matrices),
    TrajectoryFormat("npz", "an export of vislam", read_file=archive.npz),
    TrajectoryFormat("rosbag", "a bag of ROS 1, ROS 2 or MCAP", read_file=bag.rosbag),
)
FORMATS = {one.name: one for one in _ALL}
_BAGS = (b"#ROSBAG V", b"\x89MCAP0", b"SQLite format 3\0")
_BY_COLUMNS = {3: "planar_xy", 4: "positions", 8: "tum", 9: "tum", 10: "positions", 12: "kitti", 16: "kitti"}
_BY_COLUMNS |= {20: "openvins", 29: "smfeval", 44: "tum_cov"}


def read_rows(path: Path, name: str = "auto", options: ReadOptions = DEFAULT) -> Rows:
    """Read a trajectory file.

    Parameters
    ----------
    path : Path
    name : str
        One of ``FORMATS``; ``auto``: guessed from the content, which ``told`` then says.
    options : ReadOptions

    Returns
    -------
    Rows
        In order, each stamp once.

    Raises
    ------
    DataError
        If the file cannot be read or is not of the format; with ``options.strict`` also at what would be
        mended.
    """
    table = None
    guessed = name == "auto"
    if guessed:
        name, table = guess(path)
    form = FORMATS[name]
    if form.read_file is not None:
        rows = form.read_file(path, options)
    else:
        assert form.read_table is not None
        table = read_text_table(path, wanted=form.wanted) if table is None else table
        if len(table.values) and not form.fits(table.columns):
            raise DataError(
                f"{path}:{table.line[0]}: must hold {form.wanted}, got {table.columns} columns; "
                f"{form.name} is {form.what}"
            )
        if not len(table.values):
            raise DataError(f"{path}: must have 2 lines of {form.name} or more, got 0")
        rows = form.read_table(table, options)
    rows = clean.in_order(rows, strict=options.strict)
    return replace(rows, told=(f"read as {name}", *rows.told)) if guessed else rows


def guess(path: Path) -> tuple[str, TextTable | None]:
    """Format of a file by its content, and its table, if it is a text that had to be read for that.

    Raises
    ------
    DataError
        If it is none that is known.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "rosbag", None
        raise DataError(f"{path}: must be a trajectory file or a bag of ROS 2, got a folder")
    try:
        with open_regular(path) as file:
            head = file.read(64)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({first_line(error)})") from None
    if head.startswith(_BAGS):
        return "rosbag", None
    if head.startswith(b"PK\x03\x04"):
        return "npz", None
    if head.startswith(b"ply"):
        raise DataError(f"{path}: must be a trajectory, got a map of points (PLY); give it as map=")
    table = read_text_table(path)
    return _of_table(table), table


def _of_table(table: TextTable) -> str:
    if not len(table.values):
        raise DataError(f"{table.path}: must have 2 lines of numbers or more, got 0")
    columns = table.columns
    euroc = any("q_rs" in one for one in table.names) or (table.commas and columns > 8)
    if euroc and columns >= 8 and columns not in (29, 44, 20):
        return "euroc"
    if columns in (13, 17):
        last = table.values[:, 13:] if columns == 17 else None
        whole = last is None or bool((abs(last - (0.0, 0.0, 0.0, 1.0)) < 1e-6).all())
        if whole:
            return "kitti360" if table.whole_first and table.values[-1, 0] < 1e8 else "matrices"
    if columns in _BY_COLUMNS:
        return _BY_COLUMNS[columns]
    if columns > 8:
        return "euroc"
    known = ", ".join(f"{one.name} ({one.what})" for one in _ALL)
    raise DataError(
        f"{table.path}:{table.line[0]}: must be of a known format, got {columns} columns; known are {known}"
    )
