"""Axes and mounting of raw inertia: the reading under which gyro and accelerometer fit the camera's motion.

The readings are those of a twist (:mod:`vislam.inspection.mounting`) and, beside the proper turns of the
axes, their reflections: a driver that flips one axis makes one, and no mounting answers it.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array
from vislam.geometry import so3
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.inertia.forces import Forces, fall
from vislam.inspection.inertia.turns import Turns
from vislam.inspection.mounting import MARGIN, NEAR_DEG, clearly_better
from vislam.models import StereoRig

CHECK = "imu axes"
_BLOCKS = 12
_ITERATIONS = 8
_OFF_DEG, _SURE, _TOLD_DEG = 2.0, 4.0, 1.0
"""A rotation is off by so much, and so many standard deviations; it is told up to so much."""
_FLOOR = 1e-3
"""Of an error, as a share of the median of all readings."""
_FILE = "data.file"


@dataclass(frozen=True)
class Reading:
    """One way to read axes and rotation.

    Attributes
    ----------
    axes : tuple of str
        The sensor's axes in those of the extrinsic.
    inverse : bool
        Whether the rotation of the extrinsic is read the other way round.
    """

    axes: tuple[str, str, str]
    inverse: bool

    @property
    def turn(self) -> Array:
        """Signed permutation ``(3, 3)``; of determinant -1 for a reflection."""
        out = np.zeros((3, 3))
        for row, name in enumerate(self.axes):
            out[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
        return out

    @property
    def proper(self) -> bool:
        """Whether it is a mounting, and no reflection."""
        return bool(np.linalg.det(self.turn) > 0.0)

    @property
    def steps(self) -> tuple[bool, int]:
        """How far it is from what is configured: a reflection is farther than any turn."""
        return not self.proper, int(self.axes != ("x", "y", "z")) + int(self.inverse)

    def matrix(self, rig: StereoRig) -> Array:
        """``cam_R_imu (3, 3)`` by this reading of a rig's extrinsic."""
        stored = rig.imu_T_cam[:3, :3]
        return np.asarray((self.turn @ (stored.T if self.inverse else stored)).T)

    def __str__(self) -> str:
        """As messages have it."""
        reflected = "" if self.proper else " (a reflection)"
        return f"[{', '.join(self.axes)}]{reflected}" + (" with the inverse rotation" if self.inverse else "")


AS_CONFIGURED = Reading(("x", "y", "z"), False)


def readings() -> list[Reading]:
    """All 48 signed permutations under both readings of the rotation."""
    turns = [
        (signs[0] + order[0], signs[1] + order[1], signs[2] + order[2])
        for order in permutations("xyz")
        for signs in product(("", "-"), repeat=3)
    ]
    return [Reading(axes, inverse) for axes in turns for inverse in (False, True)]


@dataclass(frozen=True)
class _Ranking:
    """Errors of all readings.

    Attributes
    ----------
    everyone : list of Reading
    errors : (n, m)
        What each leaves, in the unit of the sensor.
    """

    everyone: list[Reading]
    errors: Array

    def rivals(self) -> list[Reading]:
        """Readings that are not told from the one with the least error."""
        log = np.log(np.maximum(self.errors, _FLOOR * np.median(self.errors)))
        score = np.median(self.errors, axis=1)
        at = int(np.argmin(log.mean(axis=1)))
        return [
            one
            for index, one in enumerate(self.everyone)
            if score[index] < MARGIN * score[at] or not clearly_better(log[at], log[index])
        ]

    def error(self, reading: Reading) -> float:
        """Median error of a reading."""
        return float(np.median(self.errors[self.everyone.index(reading)]))


def check_axes(
    turns: Turns, forces: Forces, rig: StereoRig, *, offset: float, bias_sigma: float
) -> tuple[Finding, Reading]:
    """Rank all readings of the axes by both sensors; return what to go on with, too.

    Parameters
    ----------
    turns : Turns
    forces : Forces
    rig : StereoRig
        As configured.
    offset : float
        How late the stamps of the samples are [s].
    bias_sigma : float
        Of the accelerometer [m/s^2].
    """
    everyone, measured = readings(), turns.measured(offset)
    by_gyro = _Ranking(everyone, np.array([_turned(one, measured, turns.seen, rig) for one in everyone]))
    by_force = _Ranking(
        everyone,
        np.array(
            [
                np.linalg.norm(fall(forces, one.matrix(rig), bias_sigma=bias_sigma).residual, axis=1)
                for one in everyone
            ]
        ),
    )
    of_gyro, of_force = by_gyro.rivals(), by_force.rivals()
    shared = [one for one in of_gyro if one in of_force]
    if AS_CONFIGURED in shared:
        return _as_configured(shared, turns.seen, measured, rig), AS_CONFIGURED
    best = min((one for one in shared if one.proper), key=lambda one: one.steps, default=None)
    errors = {"gyro_rad_s": by_gyro.error(AS_CONFIGURED), "accelerometer_m_s2": by_force.error(AS_CONFIGURED)}
    if best is None:
        return _no_mounting(of_gyro, of_force, errors), AS_CONFIGURED
    text = (
        f"as configured gyro and camera differ by {by_gyro.error(AS_CONFIGURED):.3g} rad/s and accelerometer "
        f"and camera by {by_force.error(AS_CONFIGURED):.3g} m/s^2, under {best} by {by_gyro.error(best):.3g} "
        f"and {by_force.error(best):.3g}{_not_told(shared, best, rig)}"
    )
    proposal = {
        "data.repair.axes": None if best.axes == ("x", "y", "z") else {"body": list(best.axes)},
        "data.repair.extrinsic": {"rotation": "inverse", "translation": "stored"} if best.inverse else None,
    }
    return Finding(CHECK, "fault", text, counts=errors, proposal=proposal), best


def _turned(reading: Reading, measured: Array, seen: Array, rig: StereoRig) -> Array:
    """What a reading leaves of the rates ``(m,)``, a bias taken out [rad/s]."""
    off = seen - measured @ reading.matrix(rig).T
    return np.asarray(np.linalg.norm(off - np.median(off, axis=0), axis=1))


def _not_told(shared: list[Reading], best: Reading, rig: StereoRig) -> str:
    others = [one for one in shared if _apart_deg(one, best, rig) > NEAR_DEG and one.proper]
    if not others:
        return ""
    more = f" and {len(others) - 1} more" if len(others) > 1 else ""
    return f", not told from {min(others, key=lambda one: one.steps)}{more}"


def _apart_deg(one: Reading, other: Reading, rig: StereoRig) -> float:
    turn = one.matrix(rig).T @ other.matrix(rig)
    return float(np.degrees(np.linalg.norm(so3.log(turn)))) if np.linalg.det(turn) > 0.0 else 180.0


def _no_mounting(of_gyro: list[Reading], of_force: list[Reading], errors: dict[str, float]) -> Finding:
    """Finding where no mounting suits both sensors."""
    gyro, force = (min(some, key=lambda one: one.steps) for some in (of_gyro, of_force))
    named = [
        f"the {name} fits the camera as {one}"
        for name, one in (("gyro", gyro), ("accelerometer", force))
        if one != AS_CONFIGURED
    ]
    right = [name for name, one in (("gyro", gyro), ("accelerometer", force)) if one == AS_CONFIGURED]
    text = (
        f"{' and '.join(named)}{f', the {right[0]} as configured' if right else ''}: no mounting suits both"
    )
    if not right and gyro == force:
        text = f"gyro and accelerometer fit the camera as {gyro}: no mounting is a reflection"
    text = f"{text}; look at the signs and the order of the axes in the driver, and write the file again"
    return Finding(CHECK, "fault", text, counts=errors, unknown={_FILE: f"the axes of the samples: {text}"})


def _as_configured(shared: list[Reading], seen: Array, measured: Array, rig: StereoRig) -> Finding:
    """Finding where the axes are those configured, up to a small rotation."""
    turn = rig.cam_T_imu[:3, :3]
    whole = _misaligned(measured, seen, turn)
    parts = [part for part in np.array_split(np.arange(len(seen)), _BLOCKS) if len(part)]
    left_out = [
        _misaligned(np.delete(measured, part, axis=0), np.delete(seen, part, axis=0), turn) for part in parts
    ]
    value, sigma = np.degrees(whole), np.degrees(jackknife(np.array(left_out)))
    found = tuple(
        Measured.around(f"rotation about the camera's {axis}", "deg", float(value[i]), sigma=float(sigma[i]))
        for i, axis in enumerate("xyz")
    )
    text = "; ".join(str(one) for one in found)
    off = [i for i in range(3) if abs(value[i]) > max(_OFF_DEG, _SURE * sigma[i]) and sigma[i] < _TOLD_DEG]
    if off:
        # Of a rotation by a few degrees there is no step of the config: the extrinsic is to be calibrated.
        text = f"the camera is turned against imu_T_cam as configured: {text}; calibrate the extrinsic"
        return Finding(CHECK, "fault", text, found, unknown={_FILE: f"imu_T_cam: {text}"})
    doubt = _not_told(shared, AS_CONFIGURED, rig)
    unsure = [axis for i, axis in enumerate("xyz") if not sigma[i] < _TOLD_DEG]
    if doubt or unsure:
        reason = f"axes as configured fit{doubt}"
        if unsure:
            reason = f"{reason}; turns are too few about {' and '.join(unsure)} to tell {_TOLD_DEG:g} deg"
        return Finding(CHECK, "unclear", f"{reason}: {text}", found)
    return Finding(CHECK, "ok", f"as configured: {text}", found)


def _misaligned(measured: Array, seen: Array, turn: Array) -> Array:
    """Small rotation ``(3,)`` that takes the gyro's rates in the camera to those of the camera [rad]."""
    angle, weight = np.zeros(3), np.ones(len(seen))
    for _ in range(_ITERATIONS):
        turned = measured @ (so3.exp(angle) @ turn).T
        design = np.concatenate([-so3.hat(turned), np.tile(np.eye(3), (len(seen), 1, 1))], axis=2)
        normal = np.einsum("m,mij,mik->jk", weight, design, design)
        right = np.einsum("m,mij,mi->j", weight, design, seen - turned)
        solution = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        residual = seen - turned - design @ solution
        square = np.sum(residual**2, axis=1)
        weight = 1.0 / (1.0 + square / (9.0 * np.median(square) + 1e-18)) ** 2
        angle = so3.log(so3.exp(solution[:3]) @ so3.exp(angle))
    return angle
