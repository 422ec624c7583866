"""evo on the trajectory that is scored here, as a program of its own: the same errors, and what it takes."""

import json
import os
import resource
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.datasets.trajectories import read_poses
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import Matched, associate
from vislam.evaluation.rpe import rpe_by_time
from vislam.evaluation.trajectory import Statistics, ate

APE, RPE = "evo_ape", "evo_rpe"
_KEYS = ("rmse", "mean", "median", "max")


@dataclass(frozen=True)
class Compared:
    """The same errors by evo and by ours, and the CPU time of whole programs that compute them.

    Attributes
    ----------
    theirs, ours : mapping of str to Statistics
        Of the APE after SE(3) alignment and of the RPE from frame to frame [m].
    their_s, our_s : float
        CPU time of ``evo_ape`` and ``evo_rpe``, and of ``vislam evaluate``, which has all its metrics [s].
    """

    theirs: Mapping[str, Statistics]
    ours: Mapping[str, Statistics]
    their_s: float
    our_s: float

    @property
    def apart(self) -> float:
        """Largest difference of any statistic [m]."""
        pairs = [(self.theirs[name], self.ours[name]) for name in self.theirs]
        return max(abs(getattr(a, key) - getattr(b, key)) for a, b in pairs for key in _KEYS)

    def lines(self) -> Iterator[str]:
        """Rows of the table."""
        yield ""
        yield "| | APE, RMSE [m] | RPE, RMSE [m] | whole programs, CPU [s] |"
        yield "|---|---:|---:|---:|"
        for name, found, spent in (("evo", self.theirs, self.their_s), ("vislam", self.ours, self.our_s)):
            yield f"| {name} | {found[APE].rmse:.12f} | {found[RPE].rmse:.12f} | {spent:.1f} |"
        yield ""
        yield f"largest difference of RMSE, mean, median and maximum: {self.apart:.1e} m"


def compare(folder: Path, run: Run, reference: Reference) -> Compared:
    """Score a run by evo and by ours on the same two files, which are written into a folder."""
    assert reference.pose is not None
    files = folder / "reference.tum", folder / "estimate.tum"
    stamp = run.stamp[np.searchsorted(run.frame, reference.frame)]
    write_tum(files[0], stamp, reference.pose)
    write_tum(files[1], run.stamp, run.final.world_T_imu @ reference.imu_T_point)
    theirs, before = {}, _children()
    for program, how in ((APE, ("--align",)), (RPE, ("--delta", "1", "--delta_unit", "f"))):
        out = folder / f"{program}.zip"
        _call(program, "tum", *map(str, files), *how, "--save_results", str(out), home=folder)
        theirs[program] = read_results(out)
    their_s, before = _children() - before, _children()
    scored = ("evaluate", str(files[0]), "--trajectory", f"run={files[1]}", "--no-report")
    _call(sys.executable, "-m", "vislam", *scored, "--out", str(folder / "ours"), home=folder)
    return Compared(theirs, ours(*files), their_s, _children() - before)


def ours(reference: Path, estimate: Path) -> dict[str, Statistics]:
    """The same errors of the same files by our functions."""
    matched = _matched(reference, estimate)
    absolute = ate(matched, find_alignment("se3", matched)).position
    relative = rpe_by_time(matched, float(np.median(np.diff(matched.stamp)))).translation
    assert relative is not None
    return {APE: absolute, RPE: relative}


def _matched(reference: Path, estimate: Path) -> Matched:
    (_, pose), (stamp, estimated) = (read_poses(path, "tum") for path in (reference, estimate))
    frame = np.arange(len(stamp))
    target = Reference("reference", "", frame, pose[:, :3, 3], pose, np.eye(4))
    return associate(frame, stamp, estimated, target)


def write_tum(path: Path, stamp: Array, pose: Array) -> None:
    """Write poses ``(n, 4, 4)`` with all their digits."""
    xyzw = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    np.savetxt(path, np.column_stack([stamp, pose[:, :3, 3], xyzw]), fmt="%.17g")


def read_results(path: Path) -> Statistics:
    """Statistics in a file that evo saved."""
    with zipfile.ZipFile(path) as archive:
        found = json.loads(archive.read("stats.json"))
    return Statistics(**{key: float(found[key]) for key in _KEYS})


def _call(*command: str, home: Path) -> None:
    """Run a program quietly, with a folder of settings of its own."""
    environment = {**os.environ, "HOME": str(home), "MPLBACKEND": "agg"}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)


def _children() -> float:
    """CPU time of all programs that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
