"""``python -m benchmarks.filter_consistency``: whether the filters are as right as they claim.

Monte-Carlo over simulated drives with the noise, the bias and the start that the filters are told of. Whether
a member of the family claims too much of its poses is measured by the NEES, by how many errors are within
three standard deviations, and by the information that it believes to gain of where the world is. Writes
``consistency.json`` and figures.
"""

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import consistency_figures
from benchmarks.drives import LEVELS, drive
from benchmarks.variants import VARIANTS
from vislam.base.files import replace_whole
from vislam.base.types import Array
from vislam.cli.console import Terminal
from vislam.comparison.config import parse
from vislam.core import estimator
from vislam.core.estimator import Problem
from vislam.estimators import loop
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.evaluation.consistency import (
    COMPONENTS,
    PARTS,
    Average,
    Consistency,
    average,
    consistency,
    coverage,
)
from vislam_baselines import dead_reckoning

MOTION_ALONE = "dead_reckoning"
"""The check of the motion noise: linear enough over the first frames."""
FIRST = 20
"""Frames of that check."""
_EACH = {"pose": 6, "rotation": 3, "position": 3}


@dataclass(frozen=True)
class Outcome:
    """What one estimator said on one drive.

    Attributes
    ----------
    consistency : Consistency
        Of the poses as known in the end.
    yaw_error : (T,)
        In the world [rad].
    nis_per_dof : float
    gained : (T, 6) or None
        Information gained at each frame on motions (omega, v) of the world [1/rad^2, 1/m^2].
    """

    consistency: Consistency
    yaw_error: Array
    nis_per_dof: float
    gained: Array | None


@dataclass(frozen=True)
class Summary:
    """What one estimator said on all drives that it finished.

    Attributes
    ----------
    drives, failed : int
    anees : dict of str to Average
        By part of the pose.
    first : Average
        Of the pose, over the first frames alone.
    coverage : (6,)
        Share of the errors (omega, v) within three standard deviations.
    position_rmse, yaw_rmse : float
        [m], [deg].
    nis_per_dof : float
    gained : (T, 6) or None
        Information gained up to each frame, mean over the drives [1/rad^2, 1/m^2].
    """

    drives: int
    failed: int
    anees: dict[str, Average]
    first: Average
    coverage: Array
    position_rmse: float
    yaw_rmse: float
    nis_per_dof: float
    gained: Array | None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.drives < 2:
        parser.error("--drives must be at least 2: one drive has no average")
    terminal, started = Terminal(), time.perf_counter()
    document: dict[str, Any] = {"drives": options.drives, "frames": options.frames, "levels": {}}
    with _side_by_side(options.processes) as mapped:
        for name in options.levels:
            outcomes = []
            jobs = mapped(measure, repeat(name), range(options.drives), repeat(options.frames))
            with terminal.bar(name, options.drives) as bar:
                for outcome in jobs:
                    outcomes.append(outcome)
                    bar.done(len(outcomes))
            found = summaries(outcomes)
            _print(terminal, name, found)
            document["levels"][name] = {"noise": asdict(LEVELS[name]), "estimators": _plain(found)}
            title = f"{name} noise, {options.drives} simulated drives of {options.frames} frames"
            for key, figure in consistency_figures.all_figures(found, title=title).items():
                with replace_whole(options.out / f"{key}_{name}.png") as temporary:
                    figure.savefig(temporary, format="png", dpi=110)
            document["seconds"] = time.perf_counter() - started
            with replace_whole(options.out / "consistency.json") as temporary:
                temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    terminal.note(f"{document['seconds']:.0f} s; {options.out}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.filter_consistency", description=__doc__)
    add = parser.add_argument
    add("--drives", type=int, default=50, help="simulated drives of each level of noise (default: 50)")
    add("--frames", type=int, default=500, help="frames of each (default: 500)")
    add("--levels", nargs="+", choices=LEVELS, default=list(LEVELS), help="levels of noise (default: all)")
    add("--processes", type=int, default=2, help="drives run side by side (default: 2)")
    add("--out", type=Path, default=Path("results/filter_consistency"), help="folder for figures and numbers")
    return parser


@contextmanager
def _side_by_side(processes: int) -> Iterator[Callable[..., Iterator[dict[str, "Outcome | None"]]]]:
    """A ``map`` that works in processes; one process is this one."""
    if processes == 1:
        yield map
        return
    # A forked process would inherit the locks of threads that it does not have.
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield pool.map


def measure(
    level: str, seed: int, frames: int, variants: Mapping[str, Mapping[str, Any]] = VARIANTS
) -> dict[str, Outcome | None]:
    """Run all variants, and dead reckoning, over one drive; None for one that did not finish."""
    sequence, problem, truth = drive(LEVELS[level], frames=frames, seed=seed)
    sigma = np.broadcast_to(problem.track_noise.sigma, (sequence.observations, 3))
    found: dict[str, Outcome | None] = {}
    for name, solver in _estimators(problem, variants):
        run = loop.run(solver, sequence, sigma, name=name)
        if not run.complete:
            found[name] = None
            continue
        turned = truth[:, :3, :3] @ run.world_T_imu[:, :3, :3].transpose(0, 2, 1)
        found[name] = Outcome(
            consistency(run, truth),
            np.arctan2(turned[:, 1, 0], turned[:, 0, 0]),
            run.nis_per_dof,
            run.world_gained if np.isfinite(run.world_gained).all() else None,
        )
    return found


def _estimators(
    problem: Problem, variants: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, estimator.Estimator]]:
    """Fresh estimators; those whose poses are not smoothed have no use for the way back."""
    yield MOTION_ALONE, dead_reckoning.build(problem, {})
    for name, chosen in variants.items():
        smoothed = chosen.get("smoothed", False)
        finished = {} if smoothed else {"finished": "as_left", "observability": True}
        yield name, EkfEstimator(problem, parse(EkfOptions, {**chosen, **finished, "gate": False}, at=name))


def summaries(outcomes: Sequence[Mapping[str, Outcome | None]]) -> dict[str, Summary]:
    """Summarise the outcomes of all drives, by estimator."""
    found = {}
    for name in outcomes[0]:
        done = [outcome for drive in outcomes if (outcome := drive[name]) is not None]
        if len(done) > 1:
            found[name] = _summary(done, failed=len(outcomes) - len(done))
    return found


def _summary(done: Sequence[Outcome], *, failed: int) -> Summary:
    each = [outcome.consistency for outcome in done]
    error, sigma = np.array([one.error for one in each]), np.array([one.sigma for one in each])
    nees = {part: np.array([one.nees[part] for one in each]) for part in PARTS}
    gained = [outcome.gained for outcome in done if outcome.gained is not None]
    yaw = np.array([outcome.yaw_error for outcome in done])
    return Summary(
        drives=len(done),
        failed=failed,
        anees={part: average(values, freedom=_EACH[part]) for part, values in nees.items()},
        first=average(nees["pose"][:, :FIRST], freedom=6),
        coverage=coverage(error, sigma),
        position_rmse=float(np.sqrt(np.mean(np.sum(error[:, :, 3:] ** 2, axis=2)))),
        yaw_rmse=float(np.rad2deg(np.sqrt(np.mean(yaw**2)))),
        nis_per_dof=float(np.mean([outcome.nis_per_dof for outcome in done])),
        gained=np.cumsum(np.mean(gained, axis=0), axis=0) if gained else None,
    )


def _print(terminal: Terminal, level: str, found: Mapping[str, Summary]) -> None:
    """Print the table of one level."""
    terminal.rows(
        ["", "pose", "95 %", "frames inside", f"first {FIRST}", "rotation", "position"],
        [
            [
                name + (f" ({one.failed} failed)" if one.failed else ""),
                f"{one.anees['pose'].overall:.2f}",
                f"{one.anees['pose'].overall_low:.2f}-{one.anees['pose'].overall_high:.2f}",
                f"{100.0 * one.anees['pose'].share_inside:.0f} %",
                f"{one.first.overall:.2f}",
                f"{one.anees['rotation'].overall:.2f}",
                f"{one.anees['position'].overall:.2f}",
            ]
            for name, one in found.items()
        ],
        title=f"{level} noise: average NEES per degree of freedom, 1 expected",
    )
    terminal.rows(
        ["", "position [m]", "yaw [deg]", "NIS"],
        [
            [
                name,
                f"{one.position_rmse:.4f}",
                f"{one.yaw_rmse:.4f}",
                f"{one.nis_per_dof:.3f}" if one.nis_per_dof else "-",
            ]
            for name, one in found.items()
        ],
        title=f"{level} noise: root mean square errors, and NIS per degree of freedom",
    )
    terminal.rows(
        ["", *COMPONENTS],
        [[name, *(f"{100.0 * share:.2f}" for share in one.coverage)] for name, one in found.items()],
        title=f"{level} noise: errors within three standard deviations [%], 99.73 expected",
    )
    terminal.rows(
        ["", "turn x", "turn y", "turn z (yaw)", "move x", "move y", "move z"],
        [
            [name, *(f"{value:.2g}" for value in one.gained[-1])]
            for name, one in found.items()
            if one.gained is not None
        ],
        title=f"{level} noise: information gained on motions of the world [1/rad^2, 1/m^2], none expected",
    )


def _plain(found: Mapping[str, Summary]) -> dict[str, Any]:
    """Summaries as plain data."""
    return {name: _lists(asdict(one)) for name, one in found.items()}


def _lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lists(item) for key, item in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


if __name__ == "__main__":
    sys.exit(main())
