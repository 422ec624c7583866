"""What evaluation and report need of a sequence beside its runs, in place of the recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from vislam.base.errors import DataError
from vislam.base.legible import brief
from vislam.base.types import Array, IntArray
from vislam.core.archive import read_archive, write_archive
from vislam.core.bound import Bound
from vislam.core.observation_set import CommonSet
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.core.schema import (
    IDS,
    INCREASING,
    NOT_NEGATIVE,
    POSITIVE,
    RIGID,
    SORTED,
    UNIQUE,
    Coordinate,
    Extent,
    Level,
    Plain,
    Section,
    Table,
    mask,
    real,
    whole,
)
from vislam.core.sequence import Repair, Sequence
from vislam.core.stamped import Stamped
from vislam.core.strip import TABLE as STRIP
from vislam.core.strip import Strip
from vislam.models import StereoRig

_WHAT = "the saved record of a drive"
_FORMER = {"stand_in": "synthetic", "frozen": "common_set"}
"""Names that earlier versions wrote, and what they are called now."""
_TABLE: Table = {
    "name": Plain(str),
    "synthetic": Plain(bool),
    "digest": Plain(str),
    "notes": Plain(tuple[str, ...]),
    "counts": Plain(dict[str, int]),
    "repairs": Plain(tuple[Repair, ...]),
    "stamp": real("T", INCREASING),
    "rig": Section(),
    "rig.fx": Plain(Extent),
    "rig.fy": Plain(Extent),
    "rig.cx": Plain(Coordinate),
    "rig.cy": Plain(Coordinate),
    "rig.baseline": Plain(Extent),
    "rig.imu_T_cam": real("4 4", RIGID),
    "given": Section(),
    "given.frame": whole("n", SORTED, NOT_NEGATIVE, below="T"),
    "given.track": whole("n", IDS),
    "given.z": real("n 3"),
    "given.sigma": real("n 3", POSITIVE),
    "held_out": Section(),
    "held_out.frame": whole("h", SORTED, NOT_NEGATIVE, below="T"),
    "held_out.track": whole("h", IDS),
    "held_out.z": real("h 3"),
    "held_out.sigma": real("h 3", POSITIVE),
    "reference": Section(optional=True),
    "reference.name": Plain(str),
    "reference.limits": Plain(str),
    "reference.frame": whole("m", INCREASING, NOT_NEGATIVE, below="T"),
    "reference.position": real("m 2|m 3"),
    "reference.pose": real("m 4 4", RIGID, optional=True),
    "reference.imu_T_point": real("4 4", RIGID),
    "reference.track": whole("j", UNIQUE, IDS),
    "reference.points_world": real("j 3"),
    "reference.sigma": Plain(Level),
    "reference.bias": real("6|T 6", optional=True),
    "reference.sigma_rotation": Plain(Level, later=True),
    "reference.source": Section(optional=True, later=True),
    "reference.source.stamp": real("r", INCREASING),
    "reference.source.position": real("r 2|r 3"),
    "reference.source.pose": real("r 4 4", RIGID, optional=True),
    "reference.source.cov": real("r 6 6", gaps=True, optional=True),
    "reference.source.timed": Plain(bool),
    "common_set": Section(optional=True),
    "common_set.by": Plain(Annotated[tuple[str, ...], Field(min_length=1)]),
    "common_set.exempt": Plain(tuple[str, ...]),
    "common_set.kept": mask("n"),
    "common_set.digest": Plain(str),
    "provenance": Plain(dict[str, str]),
    "step_twist": real("T 6", gaps=True, optional=True, later=True),
    "bound": Section(optional=True, later=True),
    "bound.filtered": real("T 6 6"),
    "bound.smoothed": real("T 6 6"),
    "bound.filtered_error": real("T 6"),
    "bound.smoothed_error": real("T 6"),
    "strip": Section(optional=True, later=True),
    **{f"strip.{name}": item for name, item in STRIP.items()},
}
"""The fields of a saved record: type, shape and range of each, a letter for each size."""


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
    """The sequence behind some runs.

    Attributes
    ----------
    name : str
    synthetic : bool
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
    common_set : CommonSet or None
    provenance : dict
        When, on what and with which versions the runs were made.
    step_twist : (T, 6) or None
        Mean inertial twist (omega, v) over the step that ends at each frame [rad/s, m/s].
    bound : Bound or None
        The least that any estimator can err by; None where it was not asked for.
    strip : Strip or None
        Small pictures with the observations in them, where the tracks are of images.
    """

    name: str
    synthetic: bool
    digest: str
    notes: tuple[str, ...]
    counts: dict[str, int]
    repairs: tuple[Repair, ...]
    stamp: Array
    rig: StereoRig
    given: Tracks
    held_out: Tracks
    reference: Reference | None
    common_set: CommonSet | None
    provenance: dict[str, str]
    step_twist: Array | None = None
    bound: Bound | None = None
    strip: Strip | None = None

    def save(self, path: Path) -> None:
        """Write the record, whole or not at all."""
        write_archive(path, self)

    @classmethod
    def load(cls, path: Path) -> "Record":
        """Read a saved record; a DataError names what is invalid."""
        tree = read_archive(path, _TABLE, what=_WHAT, former=_FORMER)
        kinds = {"rig": StereoRig, "reference": Reference, "common_set": CommonSet}
        kinds |= {"given": Tracks, "held_out": Tracks, "bound": Bound, "strip": Strip}
        if tree["reference"] is not None and tree["reference"].get("source") is not None:
            tree["reference"]["source"] = Stamped(**tree["reference"]["source"])
        for name, kind in kinds.items():
            tree[name] = None if tree.get(name) is None else kind(**tree[name])
        found = cls(**tree)
        if found.reference is not None and not _is_whole(found.reference):
            raise DataError(
                f"{path}: expected {_WHAT}, got a 'reference' whose positions are not those of its poses; "
                "run the comparison again"
            )
        return found

    def refuse_other(self, run: Run, *, path: Path) -> None:
        """Raise DataError if a saved run is not what its file is named for, or of another sequence."""
        if got := self._unlike(run, name=path.stem):
            raise DataError(
                f"{path}: expected a run of the drive in the record beside it, got {got}; "
                "run the comparison again"
            )

    def _unlike(self, run: Run, *, name: str) -> str:
        """What shows that a run is of another sequence, or another run; empty if nothing does."""
        frames, given = len(self.stamp), len(self.given.track)
        if run.name != name:
            return f"the run '{brief(run.name)}'"
        if run.frames_expected != frames or run.frame.max(initial=-1) >= frames:
            return f"frames up to {run.frame.max(initial=-1)} of {run.frames_expected} for {frames}"
        if run.complete and len(run.frame) < frames:
            return f"a complete run with {len(run.frame)} of {frames} frames"
        if not np.array_equal(run.stamp, self.stamp[run.frame]):
            return "other stamps"
        return "" if len(run.used) == given else f"{len(run.used)} observations for {given}"


def _is_whole(reference: Reference) -> bool:
    """Whether the positions of a reference are those of its poses, if it has any."""
    return reference.pose is None or np.array_equal(reference.position, reference.pose[:, :3, 3])
