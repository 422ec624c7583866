"""Runs of differing quality over one drive: other estimators, and estimators that are told something wrong.

The repairs and the ids of the tracks are the same for all; only what an estimator is given differs.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.timing import Drive
from vislam.base.types import Array, BoolArray
from vislam.core import estimator
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.core.sequence import Sequence
from vislam.estimators import loop
from vislam.geometry import se3
from vislam.models.odometry import MotionNoise

OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "ekf": {"robust": "student"},
    "ekf_invariant": {"robust": "student"},
    "eks": {"robust": "student"},
    "isam2": {"robust": "cauchy"},
    "isam2_norelin": {"robust": "cauchy"},
}
"""Options of each estimator, as in the shipped configs."""
_NO_BIAS = 1e-9
"""Standard deviation of a bias that is not estimated, in any unit."""


@dataclass(frozen=True)
class Given:
    """What an estimator is given.

    Attributes
    ----------
    problem : Problem
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    """

    problem: Problem
    sequence: Sequence
    sigma: Array

    @classmethod
    def without(cls, drive: Drive, held: BoolArray) -> "Given":
        """All of a drive but the observations ``held (n,)``."""
        return cls(drive.problem, drive.dataset.sequence.select(~held), drive.sigma[~held])

    def run(self, name: str, *, of: str, options: Mapping[str, Any]) -> Run:
        """Run the estimator ``of``, under a name."""
        solver = estimator.find(of)(self.problem, {**OPTIONS.get(of, {}), **options})
        return loop.run(solver, self.sequence, self.sigma, name=name)


@dataclass(frozen=True)
class Variant:
    """An estimator, its options beside those of ``OPTIONS``, and what is changed of what it is given."""

    of: str
    options: Mapping[str, Any]
    change: Callable[[Given], Given]

    def run(self, name: str, given: Given) -> Run:
        """Run it under a name."""
        return self.change(given).run(name, of=self.of, options=self.options)


def _as_it_is(given: Given) -> Given:
    return given


def _bias_of_the_filter(given: Given) -> Given:
    """Tell the mean bias that the filter ends with."""
    found = given.run("ekf", of="ekf", options={"finished": "as_left"})
    return replace(given, problem=replace(given.problem, bias_mean=found.bias[-1]))


def _bias_zero(given: Given) -> Given:
    """Say that there is no bias."""
    noise = MotionNoise(given.problem.noise.twist, np.zeros(6))
    return replace(given, problem=replace(given.problem, noise=noise, bias_sigma=np.full(6, _NO_BIAS)))


def _one_track_of(many: int) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        keep = given.sequence.track % many == 0
        return replace(given, sequence=given.sequence.select(keep), sigma=given.sigma[keep])

    return change


def _pixel_noise_times(factor: float) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        noise = given.problem.track_noise
        scaled = replace(
            noise, white=factor * noise.white, drift=factor * noise.drift, match=factor * noise.match
        )
        return replace(given, problem=replace(given.problem, track_noise=scaled), sigma=factor * given.sigma)

    return change


def _twist_noise_times(factor: float) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        noise = given.problem.noise
        scaled = MotionNoise(factor * noise.twist, noise.bias_walk)
        return replace(given, problem=replace(given.problem, noise=scaled))

    return change


def _clock_later_by(seconds: float) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        later = given.sequence.clock_offset + seconds
        return replace(given, sequence=replace(given.sequence, clock_offset=later))

    return change


def _baseline_times(factor: float) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        rig = given.problem.rig
        return replace(
            given, problem=replace(given.problem, rig=replace(rig, baseline=factor * rig.baseline))
        )

    return change


def _disparity_less(pixels: float) -> Callable[[Given], Given]:
    def change(given: Given) -> Given:
        shifted = given.sequence.pixels + np.array([0.0, 0.0, pixels, 0.0])
        return replace(given, sequence=replace(given.sequence, pixels=shifted))

    return change


def _camera_turned(degrees: float) -> Callable[[Given], Given]:
    """Turn the camera about its own x axis, which is a pitch."""
    turn = se3.exp(np.deg2rad([degrees, 0.0, 0.0, 0.0, 0.0, 0.0]))

    def change(given: Given) -> Given:
        rig = given.problem.rig
        return replace(
            given, problem=replace(given.problem, rig=replace(rig, imu_T_cam=rig.imu_T_cam @ turn))
        )

    return change


def _variant(of: str, change: Callable[[Given], Given] = _as_it_is, **options: Any) -> Variant:
    return Variant(of, options, change)


VARIANTS: Mapping[str, Variant] = {
    "isam2": _variant("isam2"),
    "isam2_norelin": _variant("isam2_norelin"),
    "eks": _variant("eks"),
    "ekf_invariant": _variant("ekf_invariant"),
    "ekf": _variant("ekf"),
    "ekf, as if no outliers": _variant("ekf", gate=False, robust="none"),
    "eks, tracks: a fifth": _variant("eks", _one_track_of(5)),
    "eks, tracks: a twentieth": _variant("eks", _one_track_of(20)),
    "eks, pixel noise: x 10": _variant("eks", _pixel_noise_times(10.0)),
    "eks, twist noise: x 10": _variant("eks", _twist_noise_times(10.0)),
    "eks, twist noise: x 0.1": _variant("eks", _twist_noise_times(0.1)),
    "eks, clock: + 0.1 s": _variant("eks", _clock_later_by(0.1)),
    "eks, baseline: + 5 %": _variant("eks", _baseline_times(1.05)),
    "eks, disparities: - 1 px": _variant("eks", _disparity_less(1.0)),
    "eks, camera: 1 deg": _variant("eks", _camera_turned(1.0)),
    "eks, bias: none": _variant("eks", _bias_zero),
    "dead reckoning": _variant("dead_reckoning"),
    "dead reckoning, bias known": _variant("dead_reckoning", _bias_of_the_filter),
}
"""After the comma, what is changed; ``camera`` is its pitch, ``tracks`` the share of them that is left.

Chosen before any was scored, and all of them kept.
"""
