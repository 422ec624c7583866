"""What a calibration shows in the end: what was found, and what it changed on what it was not fitted to."""

from dataclasses import dataclass

import numpy as np

from vislam.calibration.candidates import Candidate
from vislam.calibration.estimate import Calibration
from vislam.comparison.config import Config
from vislam.core.shared_residuals import SHARED

_BIASES = ("gyro x", "gyro y", "gyro z", "velocity x", "velocity y", "velocity z")
_RAW_BIASES = (*_BIASES[:3], "accelerometer x", "accelerometer y", "accelerometer z")


@dataclass(frozen=True)
class Rows:
    """A table of words."""

    title: str
    header: list[str]
    rows: list[list[str]]


def tables(result: Calibration, config: Config, *, name: str) -> tuple[Rows, Rows]:
    """Tables of a calibration that began with a config, on a recording of a name."""
    header = ["parameter", "before", "calibrated", "95 % interval", "unit"]
    found = [*_parameters(result), *_biases(result, config), *_shared(result, config)]
    columns = ["on what was not fitted", "before", *(one.name for one in result.candidates)]
    return (
        Rows(f"vislam calibration: {name}", header, found),
        Rows("what it changed", columns, _changes(result)),
    )


def _parameters(result: Calibration) -> list[list[str]]:
    return [
        [
            item.parameter.name,
            f"{item.before:.4g}",
            f"{item.value:.4g}" if item.needed else f"below {item.value:.2g}",
            f"{item.low:.4g} to {item.high:.4g}" if item.needed else "not needed by the data",
            item.parameter.unit,
        ]
        for item in result.parameters
    ]


def _biases(result: Calibration, config: Config) -> list[list[str]]:
    rest, rows, raw = result.standstill, [], config.motion == "imu"
    units = ("rad/s", "m/s^2" if raw else "m/s")
    for index, name in enumerate(_RAW_BIASES if raw else _BIASES):
        unit = units[index > 2]
        # Raw inertia takes its first biases from the first state.
        before = "" if raw else f"{config.noise.bias_mean[index]:.4g}"
        rows.append([f"bias, {name}", before, *_interval(result.bias[index], result.bias_sigma[index]), unit])
        if rest.known[index]:
            told = _interval(rest.bias[index], rest.sigma[index])
            rows.append([f"bias at standstill, {name}", before, *told, unit])
    return rows


def _shared(result: Calibration, config: Config) -> list[list[str]]:
    return [
        [f"{item.name.replace('_', ' ')}{axis}", "0", *_interval(value, sigma), item.unit]
        for item in result.shared
        for axis, value, sigma in zip(SHARED[item.name], item.value, item.sigma, strict=True)
    ]


def _interval(value: float, sigma: float) -> tuple[str, str]:
    return f"{value:.4g}", f"{value - 1.96 * sigma:.4g} to {value + 1.96 * sigma:.4g}"


def _changes(result: Calibration) -> list[list[str]]:
    every, first = result.candidates, result.candidates[0].before
    rows = [
        ["log likelihood gained by blocks left out", "0", *(_gained(one) for one in every)],
        [
            "held-out tracks, median error [px]",
            _plain(first.held_out_px),
            *(_plain(one.trial.held_out_px) for one in every),
        ],
        ["path over inertial path", _plain(first.path), *(_plain(one.trial.path) for one in every)],
    ]
    rows.append(["pixel noise raised by", "1", *(f"{one.raised:.2f}" for one in every)])
    rows.append(
        ["standard deviations too small by", "1", *(f"{one.trial.overclaim(first):.2f}" for one in every)]
    )
    rows += [
        [f"log likelihood gained on {name}", "0", *(f"{one.elsewhere[name]:.1f}" for one in every)]
        for name in every[0].elsewhere
    ]
    verdicts = ["written" if one is result.best else "rejected" if one.objections else "" for one in every]
    before, after = result.before.nis_per_dof, result.after.nis_per_dof
    rows.append(["verdict", "written" if result.best is None else "", *verdicts])
    rows.append(["NIS per degree of freedom", f"{before:.3f}", *_of_written(result, f"{after:.3f}")])
    return rows


def _of_written(result: Calibration, value: str) -> list[str]:
    return [value if one is result.best else "" for one in result.candidates]


def _gained(one: Candidate) -> str:
    if one.predicted is None:
        return ""
    found = one.predicted
    return f"{found.total:.1f} +- {found.sigma:.1f} ({found.better} of {len(found.gain)} blocks)"


def _plain(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""
