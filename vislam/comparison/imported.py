"""Trajectories from elsewhere, such as another SLAM system's output, as runs beside our own."""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vislam.base.errors import ConfigError, DataError
from vislam.comparison import config as configuration
from vislam.comparison.results import Results
from vislam.core.record import Record
from vislam.core.run import Cost, Innovations, Log, Run
from vislam.core.trajectory import Poses
from vislam.datasets.settings import ReferenceConfig
from vislam.datasets.trajectories import load_reference
from vislam.geometry import se3

_KEYS = ("format", "pose_of", "up")


def with_trajectories(results: Results, given: Sequence[str]) -> Results:
    """Return the results with one more run for each ``NAME=FILE[,key=value...]``.

    Raises
    ------
    ConfigError
        If one of them cannot be understood, or a name is taken.
    DataError
        If a file cannot be read or holds no poses of this sequence.
    """
    runs = dict(results.runs)
    for text in given:
        name, config = _parse(text)
        if name in runs:
            raise ConfigError(
                f"--trajectory {text}: there is a run called {name} already; choose another name"
            )
        runs[name] = load_trajectory(name, config, results.record)
    return replace(results, runs=runs)


def load_trajectory(name: str, config: ReferenceConfig, record: Record) -> Run:
    """Read a trajectory as a run that knows poses and nothing else.

    Its rows are matched with the frames as those of a reference are; what belongs to none is counted.
    """
    path = Path(config.file)
    # Unlike Path.is_file, this is no error for a name too long to be one.
    if not os.path.isfile(path):
        raise DataError(f"{path}: not found; --trajectory takes the path of a file")
    read = load_reference(path, config, imu_T_cam=record.rig.imu_T_cam, stamp=record.stamp)
    assert read.pose is not None
    poses = read.pose @ se3.inverse(read.imu_T_point)
    frames = len(poses)
    unfused = np.zeros(len(record.given.track), bool)
    return Run(
        name=name,
        frames_expected=frames,
        frame=read.frame,
        stamp=record.stamp[read.frame],
        filtered=Poses(poses),
        innovations=Innovations.unknown(frames),
        used=unfused,
        gated=unfused,
        cost=Cost(total_time=float("nan")),
        log=Log(counts={"frames_without_a_pose": len(record.stamp) - frames}),
        blind=True,
    )


def _parse(text: str) -> tuple[str, ReferenceConfig]:
    first, *rest = text.split(",")
    name, equals, file = first.partition("=")
    pairs = dict(part.partition("=")[::2] for part in rest)
    if not (equals and file and re.fullmatch(r"\w[\w.+-]{0,47}", name)) or not set(pairs) <= set(_KEYS):
        raise ConfigError(
            f"--trajectory {text}: expected NAME=FILE, then any of format=, pose_of= and up= behind commas"
        )
    tree = {"format": "tum", "file": file, "name": name, "limits": "from elsewhere", **pairs}
    if tree["format"] == "planar_xy":
        raise ConfigError(
            f"--trajectory {text}: planar_xy holds no poses; expected tum, euroc, kitti or kitti360"
        )
    return name, configuration.parse(ReferenceConfig, tree, at=f"--trajectory {name}")
