"""Poses as they are known some frames later: what is asked for, and what an estimator answers."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.trajectory import Poses

Read = Callable[[int, bool], tuple[Array, Array | None]]
"""Pose ``(4, 4)`` of a frame as known now and, if asked for, its covariance ``(6, 6)``."""


@dataclass(frozen=True)
class Lags:
    """How much later poses are asked for.

    Attributes
    ----------
    frames : tuple of int
        Lags in frames, increasing, none below 0.
    cov_every : int
        Frames between two whose covariances are asked for, from the first on.
    """

    frames: tuple[int, ...]
    cov_every: int


@dataclass(frozen=True)
class Lagged:
    """Fixed-lag poses of all frames at each lag; at the end of the sequence, those of the last frame.

    Attributes
    ----------
    lag : (l,)
        Lags in frames, increasing. The last may be T - 1: what all data say.
    world_T_imu : (l, T, 4, 4)
    cov : (l, T, 6, 6)
        Covariances on the right of the poses, NaN throughout where there is none.
    """

    lag: IntArray
    world_T_imu: Array
    cov: Array

    def __iter__(self) -> Iterator[tuple[int, Poses]]:
        """Lags with their poses."""
        for lag, poses, cov in zip(self.lag.tolist(), self.world_T_imu, self.cov, strict=True):
            yield lag, Poses(poses, cov)

    def moved(self, world_T_old: Array) -> "Lagged":
        """Poses in another world; covariances on the right of a pose stay what they are."""
        return Lagged(self.lag, world_T_old @ self.world_T_imu, self.cov)

    @classmethod
    def of(cls, poses: Mapping[int, Poses]) -> "Lagged | None":
        """Poses by their lag; None if there are none."""
        if not poses:
            return None
        found = [poses[lag] for lag in sorted(poses)]
        return cls(
            np.array(sorted(poses)),
            np.array([one.world_T_imu for one in found]),
            np.array([one.covariances for one in found]),
        )


class LagReader:
    """Reads the fixed-lag poses of an estimator after each frame.

    Parameters
    ----------
    lags : Lags
    """

    def __init__(self, lags: Lags) -> None:
        self._lags, self._frames = lags, 0
        self._poses: dict[int, list[tuple[Array, Array | None]]] = {lag: [] for lag in lags.frames}

    def take(self, newest: int, read: Read) -> None:
        """Read the poses whose lag ends with the newest frame."""
        self._frames = newest + 1
        for lag, found in self._poses.items():
            if newest >= lag:
                found.append(read(newest - lag, self._with_cov(newest - lag)))

    def finish(self, read: Read) -> dict[int, Poses]:
        """Read what ends before its lag as it is known after the last frame; return poses by lag."""
        for found in self._poses.values():
            for k in range(len(found), self._frames):
                found.append(read(k, self._with_cov(k)))
        return {lag: _packed(found) for lag, found in self._poses.items() if found}

    def _with_cov(self, k: int) -> bool:
        return k % self._lags.cov_every == 0


def _packed(found: list[tuple[Array, Array | None]]) -> Poses:
    unknown = np.full((6, 6), np.nan)
    return Poses(
        np.array([pose for pose, _ in found]),
        np.array([unknown if cov is None else cov for _, cov in found]),
    )
