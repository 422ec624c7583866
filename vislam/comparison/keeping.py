"""What finished runs are kept in while others still run, and found in again by the next start."""

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from vislam.base.errors import DataError
from vislam.core.run import Run
from vislam.datasets.export import write_kitti, write_npz, write_ply, write_tum

_log = logging.getLogger("vislam")
RUNS = "runs"
_LIST = "list"


class Keeper(Protocol):
    """Keeps runs by their name; ``preparatory`` are those that only select observations for the others."""

    def find(self, name: str, *, identity: str, preparatory: bool = False) -> Run | None:
        """Complete run of that identity from an earlier start, or None."""
        ...

    def has(self, name: str, *, identity: str) -> bool:
        """Whether :meth:`find` would find one."""
        ...

    def keep(self, run: Run, *, preparatory: bool = False) -> None:
        """Keep a run, complete or not."""
        ...


class NoKeeper:
    """Keeps nothing."""

    def find(self, name: str, *, identity: str, preparatory: bool = False) -> Run | None:
        """Find nothing."""
        return None

    def has(self, name: str, *, identity: str) -> bool:
        """Find nothing."""
        return False

    def keep(self, run: Run, *, preparatory: bool = False) -> None:
        """Do nothing."""


@dataclass
class FolderKeeper:
    """Keeps runs as files of a results folder, with trajectory and map in the formats of other tools.

    Attributes
    ----------
    folder : Path
    fresh : bool
        Whether what an earlier start has left is passed over.
    found : list of str
        Names of the runs that were found.
    """

    folder: Path
    fresh: bool = False
    found: list[str] = field(default_factory=list)

    def find(self, name: str, *, identity: str, preparatory: bool = False) -> Run | None:
        """Complete run of that identity from an earlier start, or None."""
        run = self._load(name, identity, preparatory=preparatory)
        if run is not None and not preparatory:
            self.found.append(name)
        return run

    def has(self, name: str, *, identity: str) -> bool:
        """Whether :meth:`find` would find one."""
        return self._load(name, identity, preparatory=False) is not None

    def keep(self, run: Run, *, preparatory: bool = False) -> None:
        """Write a run, each file whole or not at all."""
        run.save(self._path(run.name, preparatory=preparatory))
        if preparatory or not len(run.stamp):
            return
        write_tum(self.folder / f"{run.name}.tum", run.stamp, run.final.world_T_imu)
        write_kitti(self.folder / f"{run.name}_kitti.txt", run.final.world_T_imu)
        write_npz(self.folder / f"{run.name}_trajectory.npz", run)
        write_ply(self.folder / f"{run.name}.ply", run.landmarks.points_world)

    def clear(self) -> None:
        """Remove the runs of earlier starts, if it is to start afresh."""
        for part in (RUNS, _LIST) if self.fresh else ():
            for path in (self.folder / part).glob("*.npz"):
                path.unlink()

    def _load(self, name: str, identity: str, *, preparatory: bool) -> Run | None:
        path = self._path(name, preparatory=preparatory)
        if self.fresh or not path.is_file():
            return None
        try:
            run = Run.load(path)
        except DataError as error:
            _log.info("%s", error)
            return None
        return run if run.complete and run.name == name and run.identity == identity else None

    def _path(self, name: str, *, preparatory: bool) -> Path:
        return self.folder / (_LIST if preparatory else RUNS) / f"{name}.npz"
