"""Covariances beside the estimators' own, on recordings and in simulation.

``python -m experiments.consider`` runs ``eks`` and ``isam2`` on the recordings of :data:`RECORDINGS` with one
setting of what is considered (:data:`~vislam.comparison.config.ORDINARY`) and a sandwich of :data:`BLOCKS`
blocks, and ``eks`` on simulated drives with the right model and with a camera that is turned in the body; it
writes ``docs/results/consider_covariance.md``. ``ekf_invariant`` is the forward half of ``eks``, so that the
causal poses of ``eks`` are its own. With results folders as arguments it takes those and runs no recording;
what several have of one run is put together.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.progress import Silent
from vislam.base.shipped import find_config
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.comparison.compare import compare, run_comparison
from vislam.comparison.config import (
    ORDINARY,
    Config,
    ConsiderConfig,
    DataConfig,
    HeldOutConfig,
    NoiseConfig,
    SandwichConfig,
)
from vislam.comparison.open import open_dataset
from vislam.comparison.results import Results
from vislam.core.moved_data import PARAMETERS, moved
from vislam.core.run import BESIDE, Estimate
from vislam.evaluation import Evaluation, evaluate
from vislam.simulation import SimulationConfig

PAGE = Path(__file__).parents[1] / "docs" / "results" / "consider_covariance.md"
RECORDINGS = {
    "ds3": "KITTI-360 0003 (`03.npz`)",
    "kitti07": "KITTI 0027, noisy inertia",
    "battle/kitti_0001": "Clement 0001",
    "battle/kitti_0036": "Clement 0036",
    "battle/kitti_0020": "Clement 0020",
    "battle/starry_night": "Starry Night",
}
BLOCKS = 8
SEEDS = 4
TURN = 0.003
"""Of the camera about each axis in the wrong simulation, one standard deviation [rad]."""
PARTS = ("pose", "position_planar", "position_aligned")
"""What errors are of, the first that a reference allows."""
KINDS = ("", *(f"_{kind}" for kind in BESIDE))
KEYS = ("nees", "scale_gap", "coverage_90")
Row = dict[str, float]
Rows = dict[tuple[str, str, Estimate], Row]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is not given, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, help="results folders in place of new runs")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder of the results")
    parser.add_argument("--blocks", type=int, default=BLOCKS, help="of the sandwich; 0: none")
    parser.add_argument("--processes", type=int, default=2, help="that share the runs")
    options = parser.parse_args(arguments)
    folders = options.folders or [
        _run(name, options.out, options.processes, options.blocks) for name in RECORDINGS
    ]
    rows: Rows = {}
    for folder in folders:
        results = Results.load(folder)
        add(rows, results.record.name, results, evaluate(results.runs, results.record))
    made = results.record.provenance
    PAGE.write_text(page(rows, simulated(), f"{made['cpu']}, {made['date'][:10]}"), encoding="utf-8")
    return 0


def _run(name: str, out: Path, processes: int, blocks: int) -> Path:
    """Results folder of a recording."""
    path = find_config(name)
    assert path is not None
    config = configuration.with_estimators(
        configuration.load(path), {"eks": {}, "isam2": {"marginals": "poses"}}
    )
    sandwich = SandwichConfig(blocks=blocks) if blocks else None
    config = replace(config, consider=ORDINARY, sandwich=sandwich)
    return compare(
        config,
        out=out,
        data_dir=None,
        config_dir=path.parent,
        allow_substitute=False,
        progress=Terminal(),
        report=False,
        processes=processes,
    ).folder


def add(rows: Rows, name: str, results: Results, evaluation: Evaluation) -> None:
    """Add what results say of each estimate of each run; what rows have already stays."""
    for run in results.runs.values():
        for estimate in run.estimates:
            row = rows.setdefault((name, run.name, estimate), {})
            for key, value in _values(run.name, estimate, evaluation):
                row.setdefault(key, value)
            for kind in run.beside:
                found = getattr(run, kind)
                row.setdefault(f"cost_{kind}", found.seconds / run.cost.total_time)
                row.setdefault(f"runs_{kind}", len(found.cause))


def _values(name: str, estimate: Estimate, evaluation: Evaluation) -> Iterator[tuple[str, float]]:
    """Error, and what it is by each of the covariances."""
    for key in ("ate_rmse", "ate_planar_rmse"):
        if (value := evaluation.value(name, key, estimate)) is not None:
            yield "ate", value
            break
    for kind in KINDS:
        for key in KEYS:
            every = (evaluation.value(name, f"{key}_{part}{kind}", estimate) for part in PARTS)
            if (value := next((one for one in every if one is not None), None)) is not None:
                yield f"{key}{kind}", value
        if (value := evaluation.value(name, f"scale_gap_position{kind}", estimate)) is not None:
            yield f"position{kind}", value


def simulated() -> Rows:
    """Medians over simulated drives of ``eks``, with the right camera and with a turned one."""
    simulation = SimulationConfig(frames=100, tracks_in_view=25, pixel_sigma_px=0.3)
    root = np.sqrt(simulation.period)
    density = [simulation.gyro_sigma * root] * 3 + [simulation.velocity_sigma * root] * 3
    config = Config(
        name="simulated",
        data=DataConfig(simulation=simulation),
        noise=NoiseConfig(pixel_sigma_px=0.3, twist_density=tuple(density)),
        held_out=HeldOutConfig(share=0.0),
        consider=ConsiderConfig(camera_rotation=TURN),
        sandwich=SandwichConfig(blocks=BLOCKS),
        estimators={"eks": {}},
    )
    drawn: dict[tuple[str, str, Estimate], list[Row]] = {}
    for title, sigma in (("simulated, right model", 0.0), ("simulated, camera turned", TURN)):
        rng = np.random.default_rng(1)
        for seed in range(SEEDS):
            dataset = open_dataset(config.data, seed=seed)
            sequence = dataset.sequence
            for index, turn in enumerate(sigma * rng.standard_normal(3)):
                sequence = moved(sequence, "camera_rotation", index=index, amount=turn)
            results = run_comparison(config, replace(dataset, sequence=sequence), Silent())
            one: Rows = {}
            add(one, title, results, evaluate(results.runs, results.record))
            for entry, row in one.items():
                drawn.setdefault(entry, []).append(row)
    return {
        entry: {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
        for entry, rows in drawn.items()
    }


def page(recorded: Rows, drawn: Rows, machine: str) -> str:
    """The page, with a table of the recordings and one of the simulated drives."""
    lines = [
        "# Consider covariance on six recordings",
        "",
        "Generated by `python -m experiments.consider`; what the columns are:",
        "[consider covariance](../concepts/consider_covariance.md).",
        "One setting for all recordings:",
        "",
        *(f"- {line}" for line in settings()),
        "",
        "Each cell is `own / considered / sandwich`; gap and coverage are of the pose, on `03` of the planar",
        "position. Expected are NEES 1, gap 1, coverage 0.90. Cost is the time of the further runs over that",
        "of the run, and how many they are.",
        "`ekf_invariant` is `eks`, causal. A dash: no covariance, or not run.",
        "",
        *table(recorded),
        "",
        f"In simulation (`eks`, medians of {SEEDS} drives of 100 frames; considered is the camera's turn):",
        "",
        *table(drawn),
        "",
        f"{machine}.",
        "",
    ]
    return "\n".join(lines)


def settings() -> Iterator[str]:
    """What is considered, a line each."""
    for name, value in asdict(ORDINARY).items():
        if value:
            unit = PARAMETERS[name].unit
            yield f"`{name}`: {value:g}{' ' if unit else ''}{unit}"


def table(rows: Mapping[tuple[str, str, Estimate], Row]) -> Iterable[str]:
    """Lines of a table."""
    yield "| recording | run | ATE [m] | NEES | scale gap | of the position | coverage | cost, times |"
    yield "|---|---|---:|---:|---:|---:|---:|---:|"
    for (name, run, estimate), row in rows.items():
        told = "causal" if estimate == "filtered" else "smoothed"
        cells = [_cell(row, key) for key in ("nees", "scale_gap", "position", "coverage_90")]
        cost = " / ".join(
            f"{row[f'cost_{kind}']:.0f} ({row[f'runs_{kind}']:.0f})" if f"cost_{kind}" in row else "-"
            for kind in BESIDE
        )
        ate = f"{row['ate']:.2f}" if "ate" in row else "-"
        yield f"| {name} | `{run}` {told} | {ate} | {' | '.join(cells)} | {cost} |"


def _cell(row: Row, key: str) -> str:
    values: list[Any] = [row.get(f"{key}{kind}") for kind in KINDS]
    return " / ".join("-" if value is None else f"{value:.3g}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
