"""Trajectories from elsewhere, such as another SLAM system's output, as runs beside our own."""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.errors import ConfigError, DataError
from vislam.base.settings import parse
from vislam.base.types import Array, BoolArray
from vislam.base.yaml_text import parse_yaml
from vislam.comparison.results import Results
from vislam.core.own_clock import OwnClock
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.core.stamped import Stamped, nearest
from vislam.datasets.maps import read_points
from vislam.datasets.settings import TrajectoryConfig, fields_of
from vislam.datasets.trajectories import UPRIGHT, Given, load_trajectory
from vislam.evaluation.covariance_conventions import Covariances
from vislam.evaluation.matching import Matching
from vislam.evaluation.own_clock import Elsewhere, Unmatched, as_run, on_own_clock
from vislam.geometry import se3
from vislam.models import CAMERA_AXES

_NAME = re.compile(r"\w[\w.+-]{0,47}")
_TEXTS = ("file", "name", "times", "frames", "cov", "map", "topic", "limits")
"""Keys whose values are texts, whatever they look like."""
_FRAME_TOLERANCE = 0.02
"""Farthest that a stamp may be from the camera stamp of the frame that it is drawn and compared at [s]."""
_FEWEST = 2


def with_trajectories(
    results: Results, given: Sequence[TrajectoryConfig], settings: Matching | None = None
) -> Results:
    """Return the results with one more run for each trajectory.

    Raises
    ------
    ConfigError
        If a name is taken.
    DataError
        If a file cannot be read or holds no poses of this sequence.
    """
    runs, own = dict(results.runs), dict(results.own)
    for config in given:
        if config.name in runs:
            raise ConfigError(
                f"--trajectory {config.name}: there is a run called {config.name} already; "
                "choose another name"
            )
        run, clock = _beside(config, results.record, settings or Matching())
        runs[config.name] = run
        if clock is not None:
            own[config.name] = clock
    return replace(results, runs=runs, own=own)


def parse_trajectory(text: str, *, option: str = "--trajectory", name: str = "") -> TrajectoryConfig:
    """Settings of ``NAME=FILE[,key=value...]``, of ``FILE[,key=value...]`` where a name is given, or of YAML.

    What begins with a brace is YAML, for paths with commas and names with spaces.

    Raises
    ------
    ConfigError
        If it cannot be understood.
    """
    if text.lstrip().startswith("{"):
        try:
            tree = parse_yaml(text)
        except ValueError as error:
            raise ConfigError(f"{option} {text}: not a YAML mapping ({error})") from None
    else:
        tree = _pairs(text, option, name)
    if isinstance(tree, dict) and name and "name" not in tree:
        tree["name"] = _stem(str(tree.get("file", name)))
    if isinstance(tree, dict) and tree.get("format") == "planar_xy" and not name:
        raise ConfigError(
            f"{option} {text}: planar_xy holds no poses; expected tum, euroc, kitti or kitti360"
        )
    named = tree.get("name", "") if isinstance(tree, dict) else ""
    return parse(TrajectoryConfig, tree, at=option if name else f"{option} {named}")


def _pairs(text: str, option: str, name: str) -> dict[str, Any]:
    first, *rest = text.split(",")
    file = first
    if not name:
        label, equals, file = first.partition("=")
        if not (equals and file and _NAME.fullmatch(label)):
            raise ConfigError(f"{option} {text}: expected NAME=FILE, then any of {_keys()} behind commas")
    tree: dict[str, Any] = {"file": file} if name else {"file": file, "name": label}
    for part in rest:
        key, equals, value = part.partition("=")
        if not equals or key not in fields_of(TrajectoryConfig) or (key == "name" and not name):
            shown = "FILE" if name else "NAME=FILE"
            raise ConfigError(f"{option} {text}: expected {shown}, then any of {_keys()} behind commas")
        tree[key] = value if key in _TEXTS else _value(value)
    return tree


def _value(text: str) -> Any:
    try:
        return parse_yaml(text)
    except ValueError:
        return text


def _keys() -> str:
    return ", ".join(f"{key}=" for key in fields_of(TrajectoryConfig) if key not in ("name", "file"))


def _stem(file: str) -> str:
    """Name of a file without its suffix, as far as a name may be that."""
    return re.sub(r"[|\x00-\x1f]", "_", Path(file).stem)[:64] or "reference"


def read_elsewhere(config: TrajectoryConfig, *, imu_T_cam: Array | None = None) -> tuple[Elsewhere, Given]:
    """Read a trajectory, its covariances and its map, as of the body.

    Raises
    ------
    ConfigError
        If it is that of a camera, and nobody knows where that sits.
    DataError
        If a file cannot be read.
    """
    path = Path(config.file)
    # Unlike Path.exists, this is no error for a name too long to be one.
    if not os.path.exists(path):
        raise DataError(f"{path}: not found; --trajectory takes the path of a file")
    given = load_trajectory(config)
    point_T_body = np.eye(4)
    if config.pose_of == "left_camera":
        if imu_T_cam is None:
            raise ConfigError(
                f"{config.name}: pose_of: left_camera needs a recording, which says where that sits; without "
                "one give body_T_point, or nothing if all are of the same point"
            )
        point_T_body = se3.inverse(imu_T_cam)
    own, cov = given.stamped, None
    raw = given.stamped.cov
    if raw is not None and not config.conjugated:
        cov = _covariances(given, raw, point_T_body)
    if own.pose is not None:
        pose = own.pose @ point_T_body
        own = replace(own, pose=pose, position=pose[:, :3, 3])
    told = given.told
    if raw is not None and config.conjugated:
        told = (*told, "covariances of conjugated attitudes are left out")
    found = Elsewhere(
        name=config.name,
        stamped=replace(own, cov=None),
        covariances=cov,
        clock_offset="estimate" if config.clock_offset == "estimate" else 0.0,
        alignment=config.alignment,
        points=_points(config),
        told=told,
        counts=given.counts,
    )
    return found, given


def _covariances(given: Given, raw: Array, point_T_body: Array) -> Covariances:
    moved = np.eye(4)
    if given.config.body_T_point is not None:
        turn = Rotation.from_quat(given.config.body_T_point[3:]).as_matrix()
        moved = se3.from_rotation_translation(turn, np.array(given.config.body_T_point[:3]))
    body = given.stamped.poses @ point_T_body
    # Undo what was done to the poses of the file: its covariances stand in its own axes.
    beside = given.stamped.poses @ se3.inverse(moved)
    if given.config.up == "-y":
        beside = se3.inverse(UPRIGHT) @ beside
    return Covariances(
        raw=raw,
        file_pose=se3.inverse(beside) if given.config.inverted else beside,
        body_pose=body,
        inverted=given.config.inverted,
        moved=moved @ point_T_body,
        convention=given.convention,
    )


def _points(config: TrajectoryConfig) -> Array | None:
    """Points of its map, in a world whose z points up as far as the options say."""
    if config.map is None:
        return None
    points = read_points(Path(config.map))
    return points @ CAMERA_AXES.T if config.up == "-y" else points


def _beside(config: TrajectoryConfig, record: Record, settings: Matching) -> tuple[Run, OwnClock | None]:
    """A trajectory as a run of the recording's frames, and as it is scored."""
    found, given = read_elsewhere(config, imu_T_cam=record.rig.imu_T_cam)
    own = found.stamped
    frames = len(record.stamp)
    if not own.timed:
        _refuse_places(given, frames, "frames")
        inside = own.stamp < frames
        own = own.take(inside)
        cov = found.covariances
        stamp = record.stamp[own.stamp.astype(int)]
        found = replace(
            found,
            stamped=replace(own, stamp=stamp, timed=True),
            covariances=None if cov is None else _taken(cov, inside),
        )
        own = found.stamped
    clock = None
    reference = record.reference
    if reference is not None:
        try:
            clock = on_own_clock(found, reference, _source(record, reference), settings)
        except Unmatched as error:
            raise DataError(f"{config.file}: {error}") from None
        offset = clock.facts.get("clock_offset", 0.0)
        own = own.shifted(offset)
    row, frame = nearest(own.stamp, record.stamp, _FRAME_TOLERANCE)
    if len(row) < _FEWEST:
        raise DataError(
            f"{config.file}: must cover {_FEWEST} of the {frames} frames or more, got {len(row)}; "
            "are its stamps in the clock of the recording?"
        )
    counts = {**(found.counts or {}), "frames_without_a_pose": frames - len(row)}
    rows, cov_rows = own.take(row), None
    if clock is not None:
        rows, cov_rows = _scored_rows(clock, own.stamp[row], rows)
    run = as_run(replace(found, counts=counts), rows, cov_rows, frame=frame)
    unfused = np.zeros(len(record.given.track), bool)
    run = replace(run, frames_expected=len(row), stamp=record.stamp[frame], used=unfused, gated=unfused)
    return run, clock


def _scored_rows(clock: OwnClock, stamp: Array, rows: Stamped) -> tuple[Stamped, Array | None]:
    """Rows at some stamps as they are scored, with their covariances in our convention."""
    scored = clock.run
    at = np.searchsorted(scored.stamp, stamp).clip(max=len(scored.stamp) - 1)
    if not np.array_equal(scored.stamp[at], stamp):
        return rows, None
    pose = scored.filtered.world_T_imu[at]
    cov = None if scored.filtered.cov is None else scored.filtered.cov[at]
    return replace(rows, pose=pose, position=pose[:, :3, 3]), cov


def _taken(cov: Covariances, rows: BoolArray) -> Covariances:
    return replace(cov, raw=cov.raw[rows], file_pose=cov.file_pose[rows], body_pose=cov.body_pose[rows])


def _source(record: Record, reference: Reference) -> Stamped:
    """Rows of the reference on their own stamps, or at the frames where it is known at these only."""
    if reference.source is not None:
        return reference.source
    return Stamped(record.stamp[reference.frame], reference.position, reference.pose)


def _refuse_places(given: Given, count: int, what: str) -> None:
    """Raise DataError if rows are known by their places alone, and are not as many as there should be."""
    if given.by_place and len(given.stamped) != count:
        raise DataError(
            f"{given.config.file}: {len(given.stamped)} poses for {count} {what}, and nothing says which "
            "belong together; give frames=FILE (their numbers) or times=FILE (their stamps), a line for each"
        )
