"""The saved run of another estimator, whose poses or map are given to a baseline."""

from pathlib import Path

import numpy as np

from vislam.base.errors import ConfigError, DataError
from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.core.run import Run

_SAME_TIME = 1e-6
"""Stamps that differ by no more are of the same frame [s]."""


class SavedRun:
    """A complete run and its poses by frame.

    Attributes
    ----------
    run : Run
    """

    def __init__(self, path: str, *, at: str) -> None:
        """Read the file; a ConfigError names the key ``at`` if it holds no complete run."""
        self._name = f"{at}: {path}"
        try:
            self.run = Run.load(Path(path))
        except DataError as error:
            raise ConfigError(f"{at}: {error}") from None
        if not self.run.complete:
            raise ConfigError(f"{self._name} is incomplete: {self.run.log.error}")

    def pose(self, frame: Frame) -> Array:
        """Pose ``world_T_imu (4, 4)`` of a frame, as known in the end; ConfigError if there is none."""
        place = np.flatnonzero(self.run.frame == frame.k)
        if not len(place) or abs(self.run.stamp[place[0]] - frame.stamp) > _SAME_TIME:
            raise self.refusal(f"has no pose of frame {frame.k} at {frame.stamp:.3f} s")
        return self.run.final.world_T_imu[place[0]]

    def refusal(self, why: str) -> ConfigError:
        """Error to raise where the run does not fit the data."""
        return ConfigError(f"{self._name} {why}; name a run of the same data with the same repairs")
