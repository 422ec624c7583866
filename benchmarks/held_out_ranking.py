"""Do held-out tracks rank trajectories as the truth does?

A tenth of the tracks is kept from some twenty runs of differing quality over one drive. Each run is scored in
pixels by these tracks, and against the drive's truth or reference; then the two orders are compared.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau, spearmanr

from benchmarks.held_out_figure import dots
from benchmarks.held_out_runs import VARIANTS, Given, Variant
from benchmarks.telling import tell
from benchmarks.timing import Drive, Part
from vislam.command import answer
from vislam.config import Config, DataConfig, NoiseConfig, load
from vislam.data.reference import Reference
from vislam.errors import DataError
from vislam.evaluation.held_out import HeldOut, HeldOutScore, hold_out, paired, score
from vislam.evaluation.trajectory import distance_driven, match
from vislam.files import check_writable, replace_whole
from vislam.geometry import se3, so3
from vislam.simulation import SimulationConfig
from vislam.terminal import Terminal
from vislam.types import Array

SHARE = 0.1
_TOLD_APART = 0.01
"""Two runs are told apart if the p-value of their comparison is below this."""

_SIMULATION = SimulationConfig(
    frames=800,
    tracks_in_view=60.0,
    pixel_sigma_px=0.15,
    drift_px=0.2,
    match_px=0.7,
    outlier_probability=0.01,
    moving_share=0.05,
    stale_probability=0.05,
    gyro_bias=(-0.0095, -0.0105, -0.0095),
    gyro_sigma=0.01,
    velocity_sigma=0.1,
)
_DENSITY = [sigma * _SIMULATION.period**0.5 for sigma in (_SIMULATION.gyro_sigma, _SIMULATION.velocity_sigma)]
SIMULATED = Config(
    name="simulated",
    data=DataConfig(simulation=_SIMULATION),
    noise=NoiseConfig(
        pixel_sigma_px=_SIMULATION.pixel_sigma_px,
        drift_px=_SIMULATION.drift_px,
        match_px=_SIMULATION.match_px,
        twist_density=(_DENSITY[0],) * 3 + (_DENSITY[1],) * 3,
    ),
    gate_probability=0.9999,
)
"""A town drive with the errors of a recording, moving objects among them, and inertial noise in between those
of the shipped recordings."""
DATA: Mapping[str, Config | Path] = {
    "simulated": SIMULATED,
    "kitti07": Path(__file__).parents[1] / "configs" / "kitti07.yaml",
}


@dataclass(frozen=True)
class Errors:
    """What is wrong with a trajectory by truth or reference.

    Attributes
    ----------
    ate : float
        RMSE of the position, rigidly aligned [m].
    way_10, way_100 : float
        Mean error of the way over stretches of 10 m and of 100 m [% of the length].
    turn_10 : float
        Mean error of the turn over stretches of 10 m [deg].
    """

    ate: float
    way_10: float
    way_100: float
    turn_10: float


AXES = {
    "ate": "ATE [m]",
    "way_10": "way over 10 m [%]",
    "way_100": "way over 100 m [%]",
    "turn_10": "turn over 10 m [deg]",
}
"""Names of the errors."""
SCORES: Mapping[str, Callable[[HeldOutScore], float]] = {
    "median": lambda found: found.median,
    "capped RMS": lambda found: found.capped_rms,
}
"""Figures of a score [px]."""


@dataclass(frozen=True)
class Ranked:
    """A run by both measures."""

    errors: Errors
    score: HeldOutScore


def errors(world_T_imu: Array, reference: Reference) -> Errors:
    """Compare a trajectory with a reference that has poses."""
    assert reference.pose is not None
    inside = reference.frame < len(world_T_imu)
    estimate, wanted = world_T_imu[reference.frame[inside]] @ reference.imu_T_point, reference.pose[inside]
    way_10, turn_10 = _over(10.0, estimate, wanted)
    return Errors(
        ate=match(world_T_imu, reference, planar=False).ate,
        way_10=100.0 * way_10 / 10.0,
        way_100=_over(100.0, estimate, wanted)[0],
        turn_10=float(np.rad2deg(turn_10)),
    )


def _over(length: float, estimate: Array, wanted: Array) -> tuple[float, float]:
    """Mean error of way [m] and of turn [rad] over all stretches of a length [m]; NaN if there are none."""
    driven = distance_driven(wanted)
    last = np.searchsorted(driven, driven + length)
    first = np.flatnonzero(last < len(driven))
    if not len(first):
        return float("nan"), float("nan")
    steps = [se3.inverse(poses[first]) @ poses[last[first]] for poses in (estimate, wanted)]
    error = se3.inverse(steps[0]) @ steps[1]
    turn = np.linalg.norm(so3.log(error[:, :3, :3]), axis=1)
    return float(np.linalg.norm(error[:, :3, 3], axis=1).mean()), float(turn.mean())


def measure(drive: Drive, variants: Mapping[str, Variant], *, seed: int) -> dict[str, Ranked]:
    """Run the variants without the held-out tracks, and measure each by these and by the reference.

    Raises
    ------
    DataError
        If the drive has no reference with poses.
    """
    sequence, reference = drive.dataset.sequence, drive.dataset.reference
    if reference is None or reference.pose is None:
        raise DataError(f"{drive.name}: a reference with poses is needed")
    mask = hold_out(sequence.track, share=SHARE, seed=seed)
    held, given = HeldOut.of(sequence, mask), Given.without(drive, mask)
    found = {}
    with Terminal().progress("runs", len(variants)) as bar:
        for done, (name, variant) in enumerate(variants.items(), start=1):
            run = variant.run(name, given)
            found[name] = Ranked(errors(run.world_T_imu, reference), score(held, run.world_T_imu))
            bar.update(0, completed=done)  # type: ignore[arg-type]
    return found


def runs_part(drive: Drive, found: Mapping[str, Ranked]) -> Part:
    """Table of the runs, best score first."""
    order = sorted(found, key=lambda name: found[name].score.median)
    some = next(iter(found.values())).score
    return Part(
        title=f"{drive.name}: {len(found)} runs by {len(some.rms)} held-out tracks",
        header=["run", *(f"{name} [px]" for name in SCORES), "capped", *AXES.values()],
        rows=[
            [
                name,
                *(f"{figure(found[name].score):.3f}" for figure in SCORES.values()),
                f"{found[name].score.capped}",
                *(f"{getattr(found[name].errors, key):.3g}" for key in AXES),
            ]
            for name in order
        ],
        notes=(),
        values={
            "tracks": len(some.rms),
            "runs": {
                name: {
                    **{key: figure(one.score) for key, figure in SCORES.items()},
                    "capped": one.score.capped,
                    **asdict(one.errors),
                }
                for name, one in found.items()
            },
        },
    )


def ranks_part(drive: Drive, found: Mapping[str, Ranked]) -> Part:
    """Rank correlations of the scores with the errors, and whether pairs that are told apart are so rightly."""
    rows, values = [], []
    for name, figure in SCORES.items():
        scores = [figure(one.score) for one in found.values()]
        for key, title in AXES.items():
            wrong = [getattr(one.errors, key) for one in found.values()]
            rho, tau = spearmanr(scores, wrong), kendalltau(scores, wrong)
            rows.append(
                [
                    name,
                    title,
                    f"{rho.statistic:.2f}",
                    f"{rho.pvalue:.1g}",
                    f"{tau.statistic:.2f}",
                    f"{tau.pvalue:.1g}",
                ]
            )
            values.append(
                {
                    "score": name,
                    "error": key,
                    "spearman": float(rho.statistic),
                    "spearman_p": float(rho.pvalue),
                    "kendall": float(tau.statistic),
                    "kendall_p": float(tau.pvalue),
                }
            )
    told, right = told_apart(found)
    shares = ", ".join(f"{100.0 * right[key] / max(told, 1):.0f} % {title}" for key, title in AXES.items())
    pairs = len(found) * (len(found) - 1) // 2
    return Part(
        title=f"{drive.name}: rank correlation over {len(found)} runs",
        header=["score", "error", "Spearman", "p", "Kendall", "p"],
        rows=rows,
        notes=(
            f"{told} of {pairs} pairs of runs are told apart (p < {_TOLD_APART:g}); of these the better one "
            f"is better by: {shares}",
        ),
        values={"correlations": values, "pairs": pairs, "told_apart": told, "rightly": right},
    )


def told_apart(found: Mapping[str, Ranked]) -> tuple[int, dict[str, int]]:
    """Count the pairs of runs that are told apart, and how many of these rightly, by each error."""
    told, right = 0, dict.fromkeys(AXES, 0)
    for one, other in combinations(found.values(), 2):
        outcome = paired(one.score, other.score)
        if outcome.p_value < _TOLD_APART:
            told += 1
            for key in AXES:
                smaller = getattr(one.errors, key) < getattr(other.errors, key)
                right[key] += smaller == (outcome.better > 0.5)
    return told, right


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.held_out_ranking", description=__doc__)
    add = parser.add_argument
    add("--data", choices=DATA, default="simulated", help="the drive (default: simulated)")
    add("--frames", type=int, metavar="N", help="only the first N frames")
    add("--seed", type=int, default=0, help="seed of the simulation and of the held-out tracks (default: 0)")
    add("--runs", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME", help="default: all")
    add("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    add("--figure", type=Path, metavar="FILE.png", help="file for the figure")
    return parser


def _measure(options: argparse.Namespace) -> int:
    for file in (options.out, options.figure):
        if file is not None:
            check_writable(file)
    config = DATA[options.data]
    config = config if isinstance(config, Config) else load(config)
    drive = Drive.open(replace(config, seed=options.seed))
    if options.frames is not None:
        drive = drive.first(options.frames)
    found = measure(drive, {name: VARIANTS[name] for name in options.runs}, seed=options.seed)
    tell(
        {"runs": lambda: runs_part(drive, found), "ranks": lambda: ranks_part(drive, found)}, out=options.out
    )
    if options.figure is not None:
        drawn = dots(
            {name: one.score.median for name, one in found.items()},
            {title: [getattr(one.errors, key) for one in found.values()] for key, title in AXES.items()},
            title=f"{drive.name}: held-out tracks against {_name(drive)}",
        )
        with replace_whole(options.figure) as temporary:
            drawn.savefig(temporary, format="png", dpi=110)
    return 0


def _name(drive: Drive) -> str:
    assert drive.dataset.reference is not None
    return drive.dataset.reference.name


if __name__ == "__main__":
    sys.exit(main())
