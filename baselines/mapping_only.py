"""Mapping with given poses (course report, section III-B)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.fields import STRICT, Positive
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.step import Final, Step
from vislam.core.trajectory import Landmarks
from vislam_baselines.dead_reckoning import DeadReckoning, DeadReckoningOptions
from vislam_baselines.landmarks import IndependentLandmarks, initialise, update
from vislam_baselines.observations import NEAREST, SMALLEST_DISPARITY, look, pixel_variances
from vislam_baselines.saved import SavedRun
from vislam_baselines.twist import require_twist


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MappingOnlyOptions:
    """Options of mapping with given poses."""

    poses: str = "dead_reckoning"
    """``dead_reckoning``: the twist integrated as the report does; else the file of a saved run."""
    pixel_variance: Positive | None = 3.0
    """Variance of each pixel coordinate, the report's V [px^2]; null: the noise of the comparison."""
    every: Annotated[int, Field(ge=1)] = 20
    """One track in so many is mapped: those whose id it divides."""


def build(problem: Problem, options: Mapping[str, Any]) -> "MappingOnly":
    """Build the mapping from a problem and the options of its config section."""
    parsed = settings.parse(MappingOnlyOptions, dict(options), at="estimators.mapping_only")
    return MappingOnly(problem, parsed)


class MappingOnly:
    """Estimates landmarks and nothing else.

    Given the poses, landmarks are independent: in the report's joint filter all blocks between two of them
    stay zero. Their covariances are what the pixels alone leave open, as if the poses were right.
    """

    def __init__(self, problem: Problem, options: MappingOnlyOptions) -> None:
        self._rig = problem.rig
        self._options = options
        self._saved: SavedRun | None = None
        if options.poses != "dead_reckoning":
            self._saved = SavedRun(options.poses, at="estimators.mapping_only.poses")
        require_twist(problem, "estimators.mapping_only")
        self._reckoning = DeadReckoning(problem, DeadReckoningOptions(integration="first"))
        self._in_view = IndependentLandmarks(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)))
        self._left: list[IndependentLandmarks] = []

    def process(self, frame: Frame) -> Step:
        """Take one frame: its pose as given, then update what is known, then initialise what is new."""
        given = self._reckoning.process(frame)
        if self._saved is not None:
            given = Step(self._saved.pose(frame))
        pose = given.pose
        variance = pixel_variances(frame, self._options.pixel_variance)
        wanted = (frame.stereo.track % self._options.every == 0) & frame.stereo.usable

        _, slots, rows = np.intersect1d(
            self._in_view.track, frame.stereo.track, assume_unique=True, return_indices=True
        )
        self._left.append(self._in_view.select(~np.isin(self._in_view.track, frame.stereo.track)))
        known = self._in_view.select(slots)
        seen = look(self._rig, pose, known.points_world)
        fused = wanted[rows] & (seen.depth > NEAREST)
        updated, nis, log_likelihood = update(
            known.select(fused), seen.select(fused), frame.stereo.z[rows[fused]], variance[rows[fused]]
        )

        new = wanted & (frame.stereo.z[:, 0] - frame.stereo.z[:, 1] > SMALLEST_DISPARITY)
        new[rows] = False
        first = initialise(self._rig, pose, frame.stereo.track[new], frame.stereo.z[new], variance[new])
        self._in_view = IndependentLandmarks.join([known.select(~fused), updated, first])
        used = new.copy()
        used[rows[fused]] = True
        return replace(
            given,
            nis=nis,
            dof=3 * int(np.count_nonzero(fused)),
            log_likelihood=log_likelihood,
            used=used,
            gated=wanted & ~used,
        )

    def finalize(self) -> Final:
        """Leave the poses as given, and return all landmarks, their ids ascending."""
        landmarks = IndependentLandmarks.join([*self._left, self._in_view])
        landmarks = landmarks.select(np.argsort(landmarks.track))
        return Final(
            map=Landmarks(landmarks.track, landmarks.points_world, landmarks.cov),
            up=None if self._saved is None else self._saved.run.up,
        )
