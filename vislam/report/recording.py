"""Results as a recording for the Rerun viewer: paths, landmarks and covariances in space, costs over time.

Only this module imports rerun, and only who asks for a recording imports this module.
"""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from vislam.base.errors import ConfigError
from vislam.base.files import replace_whole
from vislam.base.legible import one_line
from vislam.base.types import Array, IntArray
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation.trajectory_scores import headline_alignment
from vislam.report.colours import colours
from vislam.report.placement import origin, place, principal_axes

_SIGMAS = 3.0
_AXIS_LENGTH = 2.0
"""Length of the axes of a pose [m]."""
_SCALARS = {"step_time_ms": "step time [ms]", "nis_per_dof": "NIS per dof", "position_sigma": "sigma [m]"}
_ABOUT, _REFERENCE, _TRUE_LANDMARKS = "about", "reference", "true landmarks"
"""Entities of no run. What runs log lies below their names, so that no name of a run can take these."""


def write_recording(path: Path, runs: Mapping[str, Run], record: Record, *, title: str) -> None:
    """Write results as an ``.rrd`` file, whole or not at all.

    Its timelines are ``frame`` and ``time``, in seconds since the first frame of the sequence. Each run has
    the entities ``<run>/path``, ``causal_path`` where it differs, ``pose``, ``position_3_sigma``,
    ``landmarks``, which come with the frame that first saw them, and the scalars ``step_time_ms``,
    ``nis_per_dof`` and ``position_sigma`` (of the worst direction [m]), each where the run has it.

    Raises
    ------
    ConfigError
        If the environment switches Rerun off.
    """
    drawn = {name: run for name, run in runs.items() if len(run.frame)}
    colour = {name: int(f"{code[1:]}ff", 16) for name, code in colours(runs).items()}
    with warnings.catch_warnings():
        # The SDK warns of what it cannot log, and goes on without it.
        warnings.simplefilter("error", rr.error_utils.RerunWarning)
        recording = rr.RecordingStream("vislam")
        if not recording.is_enabled():
            raise ConfigError("--rerun: the environment variable RERUN switches it off; unset it")
        # Into memory first: on a full disk its own file sink leaves half a file, or waits for ever.
        content = recording.memory_recording()
        try:
            recording.send_blueprint(_blueprint(list(drawn)), make_active=False)
            recording.send_recording_name(one_line(title))
            recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            about = rr.TextDocument(_about(runs, record, title), media_type=rr.MediaType.MARKDOWN)
            recording.log(_ABOUT, about, static=True)
            if record.reference is not None:
                _log_reference(recording, record.reference)
            for name, run in drawn.items():
                _log_run(recording, name, run.levelled(), record, colour=colour[name])
            written = content.drain_as_bytes()
        finally:
            recording.disconnect()
    with replace_whole(path) as temporary:
        temporary.write_bytes(written)


def _blueprint(names: list[str]) -> rrb.Blueprint:
    """Layout of the viewer; landmarks stay once they have come."""
    until_now = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for timeline in ("frame", "time")
        ]
    )
    space = rrb.Spatial3DView(
        name="paths and landmarks", overrides={_entity(name, "landmarks"): until_now for name in names}
    )
    plots = [
        rrb.TimeSeriesView(name=title, contents=[_entity(name, key) for name in names])
        for key, title in _SCALARS.items()
    ]
    about = rrb.TextDocumentView(name="about", origin=_ABOUT)
    return rrb.Blueprint(rrb.Horizontal(space, rrb.Vertical(about, *plots), column_shares=[2, 1]))


def _entity(*parts: str) -> str:
    return str(rr.new_entity_path(list(parts)))


def _about(runs: Mapping[str, Run], record: Record, title: str) -> str:
    lines = [f"# {_literal(title)}", ""]
    if record.synthetic:
        lines += ["**The data are simulated**, in place of a recording or without one.", ""]
    lines += [f"- {_literal(note)}" for note in record.notes]
    lines += [
        f"- {name} is incomplete: {_literal(run.log.error)}" for name, run in runs.items() if not run.complete
    ]
    lines += [f"- {line}" for line in _world(record.reference)]
    lines += ["", "## Provenance", ""]
    lines += [f"- {key}: {value}" for key, value in record.provenance.items()]
    return "\n".join(lines)


def _literal(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return re.sub(r"([\\`*_\[\]<>#|])", r"\\\1", one_line(text))


def _world(reference: Reference | None) -> list[str]:
    """What a reader must know of the places that are drawn."""
    ellipsoids = f"Ellipsoids are {_SIGMAS:g} sigma of the position, as the final estimate has them."
    if reference is None:
        return ["There is no reference. Each run is in its own world, z up.", ellipsoids]
    kind = headline_alignment(reference.planar)
    name, limits = _literal(reference.name), _literal(reference.limits)
    lines = [
        f"Reference: {name} ({limits}). The origin is its first position.",
        f"Each run is aligned with it ({kind}, over all positions that both have) and drawn at its point; a "
        "run with fewer than three of them stays in its own world.",
        ellipsoids,
    ]
    if reference.planar:
        lines.append("The reference has no height and is drawn at height 0; heights of runs are their own.")
    return lines


def _log_reference(recording: rr.RecordingStream, reference: Reference) -> None:
    """Log positions as points, joined by lines where no frame lies between, and true landmarks."""
    height = np.zeros((len(reference.position), 3 - reference.position.shape[1]))
    position = np.hstack([reference.position, height]) - origin(reference)
    strips = np.split(position, np.flatnonzero(np.diff(reference.frame) > 1) + 1)
    grey, size = 0xB0B0B0FF, rr.Radius.ui_points(2.0)
    recording.log(
        _REFERENCE,
        rr.Points3D(position, colors=grey, radii=size),
        rr.LineStrips3D([strip for strip in strips if len(strip) > 1], colors=grey),
        static=True,
    )
    if len(reference.points_world):
        points = reference.points_world - origin(reference)
        recording.log(
            _entity(_TRUE_LANDMARKS),
            rr.Points3D(points, colors=grey, radii=rr.Radius.ui_points(1.0)),
            static=True,
        )


def _log_run(recording: rr.RecordingStream, name: str, run: Run, record: Record, *, colour: int) -> None:
    placed, times = place(run, record.reference), _times(run.frame, record)
    recording.log(_entity(name, "path"), _strip(placed.pose, colour, width=1.5), static=True)
    if run.smoothed is not None:
        recording.log(_entity(name, "causal_path"), _strip(placed.causal, colour, width=0.5), static=True)
    pose = _entity(name, "pose")
    recording.log(pose, rr.TransformAxes3D(_AXIS_LENGTH), static=True)
    moves = rr.Transform3D.columns(
        translation=placed.pose[:, :3, 3], quaternion=_xyzw(placed.pose[:, :3, :3])
    )
    recording.send_columns(pose, times, moves)
    track = run.landmarks.track
    if len(track):
        _log_landmarks(recording, _entity(name, "landmarks"), track, placed.points, record, colour=colour)
    sigma = np.full((len(run.frame), 3), np.nan)
    known = np.isfinite(placed.position_cov).all(axis=(1, 2))
    if known.any():
        sigma[known], axes = principal_axes(placed.position_cov[known])
        entity = _entity(name, "position_3_sigma")
        recording.log(entity, rr.Ellipsoids3D.from_fields(colors=colour), static=True)
        ellipsoids = rr.Ellipsoids3D.columns(
            half_sizes=_SIGMAS * sigma[known], centers=placed.pose[known, :3, 3], quaternions=_xyzw(axes)
        )
        # An empty row takes the ellipsoid before it away.
        recording.send_columns(entity, times, ellipsoids.partition(known.astype(int)))
    scalars = {"position_sigma": sigma[:, 2]}
    if len(run.cost.step_time) == len(run.frame):
        scalars["step_time_ms"] = 1e3 * run.cost.step_time
    nis, dof = run.innovations.nis, run.innovations.dof
    scalars["nis_per_dof"] = np.where(dof > 0, nis / np.maximum(dof, 1), np.nan)
    for key, values in scalars.items():
        _log_scalar(recording, _entity(name, key), run.frame, values, record, name=name, colour=colour)


def _log_landmarks(
    recording: rr.RecordingStream, entity: str, track: IntArray, points: Array, record: Record, *, colour: int
) -> None:
    """Log landmarks at the frames that first saw them; the layout keeps them in view from there on."""
    order = np.argsort(record.given.frame, kind="stable")
    seen, at = np.unique(record.given.track[order], return_index=True)
    first = record.given.frame[order][at][np.searchsorted(seen, track)]
    frame, count = np.unique(first, return_counts=True)
    style = rr.Points3D.from_fields(colors=colour, radii=rr.Radius.ui_points(1.0))
    recording.log(entity, style, static=True)
    columns = rr.Points3D.columns(positions=points[np.argsort(first, kind="stable")]).partition(count)
    recording.send_columns(entity, _times(frame, record), columns)


def _log_scalar(
    recording: rr.RecordingStream,
    entity: str,
    frame: IntArray,
    values: Array,
    record: Record,
    *,
    name: str,
    colour: int,
) -> None:
    """Log what is finite of one value a frame."""
    known = np.isfinite(values)
    if known.any():
        recording.log(entity, rr.SeriesLines(colors=colour, names=name), static=True)
        recording.send_columns(
            entity, _times(frame[known], record), rr.Scalars.columns(scalars=values[known])
        )


def _times(frame: IntArray, record: Record) -> list[rr.TimeColumn]:
    seconds = record.stamp[frame] - record.stamp[0]
    return [rr.TimeColumn("frame", sequence=frame), rr.TimeColumn("time", duration=seconds)]


def _strip(pose: Array, colour: int, *, width: float) -> rr.LineStrips3D:
    return rr.LineStrips3D([pose[:, :3, 3]], colors=colour, radii=rr.Radius.ui_points(width))


def _xyzw(rotation: Array) -> Array:
    return np.asarray(Rotation.from_matrix(rotation).as_quat())
