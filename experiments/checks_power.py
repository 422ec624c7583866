"""Which planted faults the checks of ``configs/ci_drives.yaml`` catch, on all its drives together.

``python -m experiments.checks_power [SEEDS] [ESTIMATOR,...]``: a line for each fault, with the checks that
fail.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

from vislam.base.types import Array
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.estimators.ekf.measurement import View
from vislam.study.points import Point
from vislam.study.pooled import judge_pooled
from vislam.study.trial import run_trial

CONFIG = Path(__file__).parents[1] / "configs" / "ci_drives.yaml"
TWIST = [0.0037947332] * 3 + [0.0632455532] * 3
FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "pixel noise stated twice as large": {"noise.pixel_sigma_px": 1.0},
    "pixel noise stated half as large": {"noise.pixel_sigma_px": 0.25},
    "twist noise stated twice as large": {"noise.twist_density": [2.0 * one for one in TWIST]},
    "twist noise stated half as large": {"noise.twist_density": [0.5 * one for one in TWIST]},
    "clock late by 30 ms": {"data.simulation.clock_offset": 0.03},
    "baseline stated 1 % too large": {"data.simulation.stated_baseline": 0.6001},
    "bias prior ten times too tight": {"noise.bias_sigma": [0.002, 0.002, 0.002, 0.001, 0.005, 0.002]},
}
_JACOBIANS = View.jacobians
DROPPED = "yaw left out of the camera's Jacobian (filters)"


def main(arguments: list[str]) -> None:
    """Measure."""
    config = configuration.load(CONFIG)
    seeds = int(arguments[0]) if arguments else 6
    if len(arguments) > 1:
        names = arguments[1].split(",")
        config = configuration.with_estimators(config, {name: config.estimators[name] for name in names})
    for fault, values in FAULTS.items():
        print(f"{fault}: {failing(config, values, seeds)}", flush=True)
    with patch.object(View, "jacobians", _without_yaw):
        print(f"{DROPPED}: {failing(config, {}, seeds)}", flush=True)


def failing(config: Config, values: Mapping[str, Any], seeds: int) -> str:
    """Names of the checks that do not hold."""
    tree = Point.of(config, values).tree
    results = [run_trial(tree, seed) for seed in range(config.seed, config.seed + seeds)]
    failed = [one for one in judge_pooled(config, results) if not one.holds]
    told = ", ".join(f"{one.estimator} {one.name}" for one in failed) or "nothing"
    return f"{len(failed)} of {len(config.checks)} ({told})"


def _without_yaw(self: View, *arguments: Any) -> tuple[Array, Array]:
    """Jacobians of filters that do not know that a turn about the vertical moves what they see."""
    by_nav, by_landmark = _JACOBIANS(self, *arguments)
    by_nav[:, :, 2] = 0.0
    return by_nav, by_landmark


if __name__ == "__main__":
    main(sys.argv[1:])
