"""What a config makes of a recording as a whole: the smoothed filter's held-out tracks, and its path."""

from collections.abc import Sequence as Items
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.calibration.likelihood import Evaluator
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.run import Run
from vislam.core.sequence import Sequence
from vislam.evaluation.held_out import HeldOut, HeldOutScore, paired, score

_MORE, _FARTHER = 1.02, 1.1
"""Factors by which the median error of held-out tracks may rise, and the distance from the inertial path."""
CLAIMED = 1.05
"""Factor by which standard deviations may be smaller than what is shown: a tenth in the NEES."""


@dataclass(frozen=True)
class Trial:
    """A smoothed run of a config.

    Attributes
    ----------
    held_out : HeldOutScore or None
        None where no track is held out, or the run did not finish.
    path : float
        Length of its path over that of the inertial data alone; NaN where that stands still.
    sigma : (2,)
        RMS standard deviation of its rotations and of its positions [rad, m]; NaN without covariances.
    """

    held_out: HeldOutScore | None
    path: float
    sigma: Array

    @property
    def held_out_px(self) -> float:
        """Median error of the held-out tracks [px]; NaN if there are none."""
        return float("nan") if self.held_out is None else self.held_out.median

    def overclaim(self, before: "Trial") -> float:
        """How much more its covariances claim than it shows, against a trial before; 1 if nothing.

        Its standard deviations may be smaller in proportion to its error on held-out tracks: with less, what
        both are off by is more of them than before. Innovations cannot tell, as errors that all tracks share
        are in both sides of them.
        """
        shown, claimed = self.held_out_px / before.held_out_px, float(np.min(self.sigma / before.sigma))
        return shown / claimed if np.isfinite(shown) and np.isfinite(claimed) and claimed > 0.0 else 1.0


def trials(configs: Items[Config], evaluator: Evaluator) -> list[Trial]:
    """Run the smoothed filter with each config on the evaluator's sequence."""
    runs = evaluator.smoothed(configs)
    return [_trial(config, *found) for config, found in zip(configs, runs, strict=True)]


def _trial(config: Config, dataset: Dataset, run: Run) -> Trial:
    if not run.complete or run.smoothed is None:
        return Trial(None, float("nan"), np.full(2, np.nan))
    poses = run.smoothed.world_T_imu
    length = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
    # Raw inertia has no path of its own.
    inertial = 0.0 if config.motion == "imu" else inertial_length(dataset.sequence)
    held = dataset.held_out
    scored = None
    if held is not None and held.observations:
        scored = score(HeldOut.of(held, np.ones(held.observations, dtype=bool)), poses)
        scored = scored if len(scored.track) else None
    path = length / inertial if inertial > 0.0 else float("nan")
    return Trial(scored, path, _sigmas(run.smoothed.cov))


def _sigmas(cov: Array | None) -> Array:
    """RMS standard deviations ``(2,)`` of rotation and position over the frames."""
    if cov is None:
        return np.full(2, np.nan)
    variance = np.diagonal(cov, axis1=1, axis2=2)
    return np.sqrt([np.nanmean(variance[:, :3]), np.nanmean(variance[:, 3:])])


def inertial_length(sequence: Sequence) -> float:
    """Length of the path by the recorded velocity alone [m]."""
    speed = np.linalg.norm(sequence.step_means()[0][1:, 3:], axis=1)
    return float(speed @ np.diff(sequence.stamp))


def objections(after: Trial, before: Trial, *, sequence: Sequence, config: Config) -> list[str]:
    """Why a trial is worse than the one before, in words; empty if it is not.

    Parameters
    ----------
    after, before : Trial
    sequence : Sequence
    config : Config
        From before: its prior of the forward velocity's bias says how far the path may be from the inertial
        one.
    """
    found = []
    if before.held_out is not None and after.held_out is None:
        found.append("the smoothed filter does not finish")
    if before.held_out is not None and after.held_out is not None:
        risen = after.held_out.median > _MORE * before.held_out.median
        if risen and paired(after.held_out, before.held_out).high < 0.5:
            found.append(
                f"held-out tracks are predicted worse: {before.held_out.median:.3f} px before, "
                f"{after.held_out.median:.3f} px"
            )
    if (more := after.overclaim(before)) > CLAIMED:
        found.append(
            f"its standard deviations are {more:.2f} times too small for what held-out tracks show, taken "
            "those before for right"
        )
    duration = float(sequence.stamp[-1] - sequence.stamp[0])
    allowed = config.noise.bias_sigma[3] * duration / max(inertial_length(sequence), 1e-9)
    off, was = (abs(one.path - 1.0) for one in (after, before))
    if np.isfinite(off) and off > max(allowed, _FARTHER * was):
        found.append(
            f"its path is {100.0 * (after.path - 1.0):+.2f} % off the inertial one, before "
            f"{100.0 * (before.path - 1.0):+.2f} %; the prior of the velocity bias allows "
            f"{100.0 * allowed:.2f} %"
        )
    return found
