"""Tracks of a recording and of a simulated drive that stands for it, side by side, after the same repairs.

``python -m experiments.track_statistics configs/ds3.yaml configs/like_03.yaml``
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vislam.base.errors import ConfigError
from vislam.base.types import Array
from vislam.cli.command import answer
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.open import open_dataset
from vislam.core import sequence as data
from vislam.core.rigid_fit import continuations, rigid_fits

_UNITS = ("mean column [px]", "disparity [px]", "row [px]")


def statistics(sequence: data.Sequence) -> dict[str, float]:
    """Statistics of the tracks of a repaired sequence, by name."""
    in_view, length = np.diff(sequence.offset), np.unique(sequence.track, return_counts=True)[1]
    spread = one_frame_spread(sequence)
    return {
        "tracks in view, mean": float(in_view.mean()),
        "tracks in view, standard deviation": float(in_view.std()),
        "track length, mean [frames]": float(length.mean()),
        "share of tracks of length 1": float(np.mean(length == 1)),
        "share of tracks of length 2": float(np.mean(length == 2)),
        "share of tracks longer than 10": float(np.mean(length > 10)),
        **{
            f"disparity, quantile {share:g} [px]": float(np.quantile(sequence.disparity, share))
            for share in (0.05, 0.25, 0.5, 0.75, 0.95)
        },
        **{f"one-frame residual, {name}": float(value) for name, value in zip(_UNITS, spread, strict=True)},
    }


def one_frame_spread(sequence: data.Sequence) -> Array:
    """Median absolute residual ``(3,)`` [px] of a step of a track against the rigid motion of its frame."""
    fits = rigid_fits(sequence, continuations(sequence)).values()
    return np.asarray(np.median(np.abs(np.vstack([fit.residual * fit.spread for fit in fits])), axis=0))


def side_by_side(recorded: Mapping[str, float], simulated: Mapping[str, float]) -> list[list[str]]:
    """Rows of name, recorded, simulated and their ratio."""
    return [
        [name, f"{value:.3g}", f"{simulated[name]:.3g}", f"{simulated[name] / value:.2f}" if value else "-"]
        for name, value in recorded.items()
    ]


def load_sequence(config: Config, *, data_dir: Path | None, recorded: bool) -> data.Sequence:
    """Open a recording or a simulation, repaired but for the tracks seen once, which count here."""
    section = config.data if recorded else _simulation_alone(config.data)
    section = replace(section, repair=replace(section.repair, single_observations=None))
    return open_dataset(section, seed=config.seed, data_dir=data_dir, allow_substitute=not recorded).sequence


def _simulation_alone(section: DataConfig) -> DataConfig:
    if section.simulation is None:
        raise ConfigError("data.simulation is missing in the second config")
    return replace(section, file=None, inertial=None, reference=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the statistics and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.track_statistics", description=__doc__)
    parser.add_argument("recorded", type=Path, help="config of the recording")
    parser.add_argument("simulated", type=Path, help="config with the simulation, and the same repairs")
    parser.add_argument("--data-dir", type=Path, help="first folder to look for the recording")
    options = parser.parse_args(arguments)
    return answer(lambda: _print(options), verbose=False)


def _print(options: argparse.Namespace) -> int:
    recorded, simulated = (configuration.load(path) for path in (options.recorded, options.simulated))
    if recorded.data.repair != simulated.data.repair:
        raise ConfigError("the two configs differ in data.repair: their tracks cannot be compared")
    found = [
        statistics(load_sequence(config, data_dir=options.data_dir, recorded=config is recorded))
        for config in (recorded, simulated)
    ]
    Terminal().rows(
        ["statistic", recorded.name, simulated.name, "ratio"],
        side_by_side(*found),
        title="tracks after the repairs, those seen once included",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
