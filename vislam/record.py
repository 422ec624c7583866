"""What evaluation and report know of a drive beside its runs, saved with them: nobody needs the recording."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from vislam.data.reference import Reference
from vislam.data.sequence import Repair, Sequence
from vislam.errors import DataError, first_line
from vislam.files import load_archive, save_archive
from vislam.frozen import FrozenList
from vislam.sensors import StereoRig
from vislam.types import Array, IntArray


@dataclass(frozen=True)
class Tracks:
    """Observations of stereo tracks.

    Attributes
    ----------
    frame, track : (n,)
        Index of the frame and id of the track of each.
    z, sigma : (n, 3)
        (uL, uR, v) and its standard deviations [px].
    """

    frame: IntArray
    track: IntArray
    z: Array
    sigma: Array

    @classmethod
    def of(cls, sequence: Sequence, sigma: Array) -> "Tracks":
        """Take the observations of a sequence, with their noise ``(n, 3)`` [px]."""
        return cls(sequence.frame_of, sequence.track, sequence.z, sigma)


@dataclass(frozen=True)
class Record:
    """The drive behind some runs.

    Attributes
    ----------
    name : str
    stand_in : bool
        Whether it was simulated in place of, or without, a recording.
    digest : str
        Hash of the data.
    notes : tuple of str
        What a reader must know.
    counts : dict
        What was read, cut, dropped and held out.
    repairs : tuple of Repair
    stamp : (T,)
        Camera times [s].
    rig : StereoRig
    given : Tracks
        The observations that all runs were given.
    held_out : Tracks
        Those of the tracks that were kept from all of them.
    reference : Reference or None
    frozen : FrozenList or None
    provenance : dict
        When, on what and with which versions the runs were made.
    step_twist : (T, 6) or None
        Mean inertial twist (omega, v) over the step that ends at each frame [rad/s, m/s].
    """

    name: str
    stand_in: bool
    digest: str
    notes: tuple[str, ...]
    counts: dict[str, int]
    repairs: tuple[Repair, ...]
    stamp: Array
    rig: StereoRig
    given: Tracks
    held_out: Tracks
    reference: Reference | None
    frozen: FrozenList | None
    provenance: dict[str, str]
    step_twist: Array | None = None

    def save(self, path: Path) -> None:
        """Write the record, whole or not at all."""
        tree = {item.name: getattr(self, item.name) for item in fields(self)}
        tree["repairs"] = [asdict(step) for step in self.repairs]
        arrays: dict[str, Array] = {}
        plain = _take_apart(tree, arrays, at="")
        save_archive(path, plain, arrays)

    @classmethod
    def load(cls, path: Path) -> "Record":
        """Read a saved record; DataError if it is none."""
        try:
            plain, arrays = load_archive(path)
            tree = _put_together(plain, arrays, at="")
            return cls(
                **{
                    **tree,
                    "notes": tuple(tree["notes"]),
                    "repairs": tuple(Repair(**step) for step in tree["repairs"]),
                    "rig": StereoRig(**tree["rig"]),
                    "given": Tracks(**tree["given"]),
                    "held_out": Tracks(**tree["held_out"]),
                    "reference": None if tree["reference"] is None else Reference(**tree["reference"]),
                    "frozen": None if tree["frozen"] is None else _frozen(tree["frozen"]),
                }
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(
                f"{path}: expected the saved record of a drive, got {first_line(error)}; "
                "run the comparison again"
            ) from None


def _frozen(tree: Mapping[str, Any]) -> FrozenList:
    return FrozenList(**{**tree, "by": tuple(tree["by"]), "exempt": tuple(tree["exempt"])})


def _take_apart(value: Any, arrays: dict[str, Array], *, at: str) -> Any:
    """Plain data of a tree of dataclasses; its arrays go to ``arrays`` by their dotted path."""
    if isinstance(value, np.ndarray):
        arrays[at] = value
        return {"array": at}
    if hasattr(value, "__dataclass_fields__"):
        value = {name: getattr(value, name) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        below = f"{at}." if at else ""
        return {key: _take_apart(item, arrays, at=f"{below}{key}") for key, item in value.items()}
    return value


def _put_together(plain: Any, arrays: Mapping[str, Array], *, at: str) -> Any:
    """Undo :func:`_take_apart`, but for the dataclasses, which stay dictionaries."""
    if not isinstance(plain, dict):
        return plain
    if plain.keys() == {"array"} and plain["array"] == at:
        return arrays[at]
    below = f"{at}." if at else ""
    return {key: _put_together(item, arrays, at=f"{below}{key}") for key, item in plain.items()}
