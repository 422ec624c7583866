"""Biases of gyro and velocity against the camera's motion, and the priors that the data support.

A bias of the velocity is what is left at standstill: a scale of the camera goes with the speed, and so does a
velocity that points beside the body's axis. Both are fitted beside it, so where the speed hardly changes the
bias cannot be told, and its interval says so.
"""

from dataclasses import replace

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.pooled_fit import TwistError
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding, Measured, robust_mean
from vislam.inspection.motion import VisionSteps

_AXES = "xyz"
_BLOCKS = 12
_ITERATIONS = 10
_SIGNIFICANT = 3.0
"""Standard deviations at which a bias becomes the mean of its prior."""
_BEYOND = 2.0
"""Configured standard deviations within which a bias may lie."""
_WIDER = 2.0
"""The intervals come from the drive's own blocks; a prior is held so many times wider."""


def check_biases(
    sequence: Sequence, steps: VisionSteps, *, bias_mean: tuple[float, ...], bias_sigma: tuple[float, ...]
) -> Finding:
    """Biases of all six axes against the configured prior."""
    means, _ = sequence.step_means()
    inertial = means[steps.frame]
    gyro = [
        robust_mean((inertial - steps.twist)[:, i], name=f"gyro bias {_AXES[i]}", unit="rad/s")
        for i in range(3)
    ]
    velocity, along = _velocity_biases(inertial[:, 3:], steps.twist[:, 3:])
    return _judged((*gyro, *velocity), along, mean=np.array(bias_mean), sigma=np.array(bias_sigma))


def check_biases_of_few(
    sequence: Sequence, error: TwistError, *, bias_mean: tuple[float, ...], bias_sigma: tuple[float, ...]
) -> Finding:
    """Biases against the configured prior from all tracks together, where single steps show too few."""
    names = [f"gyro bias {a}" for a in _AXES] + [f"velocity bias {a}" for a in _AXES]
    sigma = np.sqrt(np.diagonal(error.cov))
    measured = tuple(
        Measured.around(
            name, "rad/s" if index < 3 else "m/s", float(error.bias[index]), sigma=float(sigma[index])
        )
        for index, name in enumerate(names)
    )
    speed = float(np.median(np.abs(sequence.step_means()[0][:, 3])))
    # Ahead, what goes with the speed is the camera's scale.
    along = np.array([0.0, 0.0, 0.0, 0.0, *(speed * np.abs(error.direction[1:]))])
    found = _judged(measured, along, mean=np.array(bias_mean), sigma=np.array(bias_sigma))
    return replace(found, text=f"{found.text}; from all tracks together, as single steps show too few")


def _judged(measured: tuple[Measured, ...], along: Array, *, mean: Array, sigma: Array) -> Finding:
    """Biases against a prior ``mean (6,)``, ``sigma (6,)``, and the one that the data support."""
    value, error = (np.array([getattr(item, name) for item in measured]) for name in ("value", "sigma"))
    told = np.isfinite(value) & np.isfinite(error)
    value, error = np.where(told, value, 0.0), np.where(told, error, np.inf)
    beyond = np.abs(value - mean) - 1.96 * error > _BEYOND * sigma
    text = "; ".join(str(item) for item in measured)
    new_mean, new_sigma, reasons = _prior(value, error, along, mean=mean, sigma=sigma, beyond=beyond)
    unknown = {"noise.bias_sigma": "; ".join(reasons)} if reasons else {}
    settings = {"noise.bias_mean": _rounded(new_mean), "noise.bias_sigma": _rounded(new_sigma)}
    if beyond.any():
        names = ", ".join(item.name for item, out in zip(measured, beyond, strict=True) if out)
        text = f"{names} beyond twice the configured prior: {text}"
        return Finding("biases", "fault", text, measured, proposal=settings, unknown=unknown)
    text = f"within the configured prior as far as the data tell: {text}"
    return Finding("biases", "ok", text, measured, settings=settings, unknown=unknown)


def _prior(
    value: Array, error: Array, along: Array, *, mean: Array, sigma: Array, beyond: BoolArray
) -> tuple[Array, Array, list[str]]:
    """Mean and standard deviation ``(6,)`` of a prior that the data support, and what is not observable."""
    taken = beyond | (np.abs(value) > _SIGNIFICANT * error)
    known = _WIDER * error < sigma
    spread = np.hypot(np.hypot(np.where(taken, 0.0, value), _WIDER * error), along)
    new_sigma = np.where(taken & beyond, np.maximum(spread, sigma), np.minimum(spread, sigma))
    names = [f"gyro {a}" for a in _AXES] + [f"velocity {a}" for a in _AXES]
    reasons = [
        f"bias of {name} is told to {one:.2g} only, prior as configured"
        for name, one, out in zip(names, error, known | taken, strict=True)
        if not out
    ]
    return np.where(taken, value, mean), new_sigma, reasons


def _velocity_biases(inertial: Array, seen: Array) -> tuple[list[Measured], Array]:
    """Velocity biases, and the share ``(6,)`` of each axis' error that goes with the speed [m/s]."""
    speed = inertial[:, 0]
    everything = np.arange(len(speed))
    parts = [part for part in np.array_split(everything, _BLOCKS) if len(part)]
    measured, along = [], np.zeros(6)
    for axis in range(3):
        target = seen[:, axis] - inertial[:, axis]
        whole = _line(speed, target, everything)
        left_out = np.array([_line(speed, target, np.setdiff1d(everything, part)) for part in parts])
        # Without a change of speed each block finds the same line, and none knows where it begins.
        lever = abs(float(np.mean(speed))) / max(float(np.std(speed)), 1e-9)
        scatter = 1.4826 * float(np.median(np.abs(target - whole[0] - whole[1] * speed)))
        sigma = float(np.hypot(jackknife(left_out[:, 0]), scatter * lever / np.sqrt(len(speed))))
        measured.append(Measured.around(f"velocity bias {_AXES[axis]}", "m/s", -float(whole[0]), sigma=sigma))
        if axis > 0:
            # Ahead, what goes with the speed is the camera's scale.
            along[3 + axis] = abs(float(whole[1])) * float(np.median(np.abs(speed)))
    return measured, along


def _line(at: Array, value: Array, rows: IntArray) -> Array:
    """Value at zero and slope of a robust line (Cauchy weights), ``(2,)``."""
    design = np.column_stack([np.ones(len(rows)), at[rows]])
    weight: Array = np.ones(len(rows))
    solution: Array = np.zeros(2)
    for _ in range(_ITERATIONS):
        solution = np.asarray(np.linalg.lstsq(design * weight[:, None], value[rows] * weight, rcond=None)[0])
        residual = value[rows] - design @ solution
        scale = 1.5 * float(np.median(np.abs(residual))) + 1e-6
        weight = 1.0 / np.sqrt(1.0 + (residual / (2.0 * scale)) ** 2)
    return solution


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.3g}") for value in values]
