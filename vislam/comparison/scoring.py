"""Trajectory files against a reference file, without a run of ours: the same tables, page and checks."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError, DataError
from vislam.base.fields import STRICT
from vislam.base.settings import Title, parse, read
from vislam.base.types import Array
from vislam.checks.settings import Check
from vislam.comparison.imported import read_elsewhere
from vislam.comparison.provenance import provenance
from vislam.comparison.results import Results
from vislam.core.filled import measured_rows
from vislam.core.own_clock import OwnClock
from vislam.core.record import Record, Tracks
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.core.stamped import Stamped, nearest
from vislam.datasets.settings import MatchingConfig, TrajectoryConfig
from vislam.datasets.trajectories import Given
from vislam.evaluation.matching import Matching
from vislam.evaluation.own_clock import Elsewhere, Unmatched, on_own_clock
from vislam.models import CAMERA_AXES, StereoRig

_SAME = 0.45
"""Share of the shortest median step within which stamps of several trajectories are one moment."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ScoringConfig:
    """Trajectory files and what they are scored against."""

    name: Title
    """Name of the results, as it stands in titles."""
    reference: TrajectoryConfig
    """The reference."""
    trajectories: tuple[TrajectoryConfig, ...]
    """What is scored, in order."""
    matching: MatchingConfig = MatchingConfig()
    """How rows are matched."""
    checks: tuple[Check, ...] = ()
    """What is demanded of the results; the exit code says whether it holds."""
    false_alarm_rate: float = 0.01
    """Chance that results of consistent estimators fail one of the tests among the checks, whichever."""

    @property
    def estimators(self) -> dict[str, Any]:
        """The trajectories, by their names, as what checks are about."""
        return {one.name: {} for one in self.trajectories}

    @property
    def ablation_chain(self) -> dict[str, str]:
        """Nothing: an ablation chain is of own runs."""
        return {}


def matching_of(config: MatchingConfig) -> Matching:
    """How rows are matched, from settings."""
    end = float("inf") if config.end is None else config.end
    return Matching(config.association, config.max_time_difference, config.start, end)


def score_files(config: ScoringConfig, *, failed: dict[str, str] | None = None) -> Results:
    """Read and match trajectories with their reference.

    Parameters
    ----------
    config : ScoringConfig
    failed : dict, optional
        Takes why a trajectory cannot be scored, by its name, and the others are; by default that is an error.

    Raises
    ------
    ConfigError, DataError
        If a file cannot be read or used, or has nothing in common with the reference.
    """
    _refuse_names([one.name for one in config.trajectories])
    reference, source, notes, remark = _reference(config.reference)
    settings = matching_of(config.matching)
    own: dict[str, OwnClock] = {}
    for one in config.trajectories:
        try:
            found, given = read_elsewhere(one)
            _refuse_places(given, notes)
            if found.stamped.timed != source.timed:
                raise DataError(_kinds(one, config.reference, stamped=found.stamped.timed))
            own[one.name] = on_own_clock(found, reference, source, settings)
        except (DataError, Unmatched) as error:
            told = str(error) if isinstance(error, DataError) else f"{one.file}: {error}"
            if failed is None:
                raise DataError(told) from None
            failed[one.name] = told
    if not own:
        raise DataError(next(iter((failed or {}).values())))
    stamp = _timeline([clock.run.stamp for clock in own.values()])
    runs = {name: _on(stamp, clock) for name, clock in own.items()}
    record = _record(config, reference, source, stamp, notes)
    record = replace(record, notes=(*record.notes, *filter(None, [remark])))
    return Results(config, record, runs, own=own)


def _refuse_names(names: Sequence[str]) -> None:
    if not names:
        raise ConfigError("one trajectory or more must be given, got none")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"there are two trajectories called {twice}; choose another name")


def _reference(config: TrajectoryConfig) -> tuple[Reference, Stamped, Given, str]:
    """Reference without rows, its rows that were measured, how they were read, and a remark on the others."""
    if config.clock_offset == "estimate" or config.alignment != "se3":
        raise ConfigError("reference: clock_offset: estimate and alignment: sim3 are of a trajectory")
    found, given = read_elsewhere(config)
    own: Elsewhere = found
    points = np.empty((0, 3)) if own.points is None else own.points
    reference = Reference(
        name=config.name,
        limits=config.limits,
        frame=np.empty(0, np.int64),
        position=np.empty((0, own.stamped.position.shape[1])),
        pose=None,
        imu_T_point=np.eye(4),
        track=np.arange(len(points)),
        points_world=points,
        sigma=config.sigma_m,
        sigma_rotation=float(np.deg2rad(config.sigma_deg)),
    )
    rows, remark = measured_rows(own.stamped, config.name)
    return reference, rows, given, remark


def _refuse_places(given: Given, reference: Given) -> None:
    """Raise DataError if poses are known by their places alone, and those of the reference are others."""
    rows = reference.stamped
    if given.by_place and not rows.timed and (not reference.by_place or len(given.stamped) != len(rows)):
        raise DataError(
            f"{given.config.file}: {len(given.stamped)} poses for {len(rows)} of the reference, and "
            "nothing says which belong together; give frames=FILE (their numbers) or times=FILE (their "
            "stamps), a line for each"
        )


def _kinds(one: TrajectoryConfig, reference: TrajectoryConfig, *, stamped: bool) -> str:
    """Say that one side has stamps and the other has none."""
    lacking, having = (reference, one) if stamped else (one, reference)
    return (
        f"{lacking.file}: has no stamps, and {having.file} has nothing else; give times=FILE (a stamp for "
        f"each row) of {lacking.name}"
    )


def _timeline(stamps: Sequence[Array]) -> Array:
    """Moments of several trajectories: stamps of different ones next to each other are one moment."""
    every = np.sort(np.concatenate(stamps))
    steps = [float(np.median(np.diff(one))) for one in stamps if len(one) > 1]
    tolerance = _SAME * min(steps, default=0.0)
    moments = [every[0]]
    for value in every[1:]:
        if value - moments[-1] > tolerance:
            moments.append(value)
    return np.array(moments)


def _on(stamp: Array, clock: OwnClock) -> Run:
    """The run at the moments of all, for drawing and for comparing it with the others."""
    row, frame = nearest(clock.run.stamp, stamp, float("inf"))
    poses = clock.run.filtered
    kept = replace(
        poses, world_T_imu=poses.world_T_imu[row], cov=None if poses.cov is None else poses.cov[row]
    )
    return replace(
        clock.run,
        frames_expected=len(row),
        frame=frame,
        stamp=clock.run.stamp[row],
        filtered=kept,
        innovations=type(clock.run.innovations).unknown(len(row)),
    )


def _record(
    config: ScoringConfig, reference: Reference, source: Stamped, stamp: Array, given: Given
) -> Record:
    inside = (
        np.flatnonzero(source.within(stamp)) if source.timed else np.flatnonzero(np.isin(stamp, source.stamp))
    )
    shown = source.interpolated(stamp[inside]) if len(source) > 1 else source
    digest = hashlib.sha256(source.stamp.tobytes() + source.position.tobytes()).hexdigest()
    none = Tracks(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
    imu_T_cam = np.eye(4)
    imu_T_cam[:3, :3] = CAMERA_AXES
    return Record(
        name=Path(config.reference.file).name,
        synthetic=False,
        digest=digest,
        notes=tuple(f"{config.reference.name}: {text}" for text in given.told if "read as" not in text),
        counts={"reference_rows": len(source), **{f"reference_{k}": v for k, v in given.counts.items()}},
        repairs=(),
        stamp=stamp,
        rig=StereoRig(1.0, 1.0, 0.0, 0.0, 1.0, imu_T_cam),
        given=none,
        held_out=none,
        reference=replace(reference, frame=inside, position=shown.position, pose=shown.pose, source=source),
        common_set=None,
        provenance=provenance(),
    )


def read_checks(path: Path) -> tuple[Check, ...]:
    """Checks of a YAML file, under ``checks``; a ConfigError says what is wrong with it."""
    tree = read(path)
    if set(tree) != {"checks"}:
        raise ConfigError(f"{path}: expected the key checks and no other, got {', '.join(tree) or 'none'}")
    return parse(tuple[Check, ...], tree["checks"], at="checks")
