"""What may be said of a trajectory file that its content does not."""

from dataclasses import dataclass
from typing import Literal

Unit = Literal["auto", "s", "ms", "us", "ns"]
QuaternionOrder = Literal["auto", "xyzw", "wxyz"]


@dataclass(frozen=True)
class ReadOptions:
    """How a file is to be read.

    Attributes
    ----------
    unit : str
        Of its stamps; ``auto``: by their size.
    quaternion : str
        Order of its quaternions; ``auto``: by the names of the columns, else that of the format.
    topic : str or None
        Of a bag.
    strict : bool
        Whether whatever would be mended (order, duplicates, lost rows, norms) is rejected instead.
    """

    unit: Unit = "auto"
    quaternion: QuaternionOrder = "auto"
    topic: str | None = None
    strict: bool = False


DEFAULT = ReadOptions()
