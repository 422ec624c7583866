"""Whether held-out tracks rank trajectories as the truth does.

A tenth of the tracks is kept from eighteen runs of differing quality over one drive. Each run is scored in
pixels by these tracks, and against the drive's truth or reference; then the two orders are compared.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from itertools import combinations
from pathlib import Path

from scipy.stats import kendalltau, spearmanr

from benchmarks.held_out_errors import AXES, Errors, errors, poses
from benchmarks.held_out_figure import dots
from benchmarks.held_out_runs import VARIANTS, Given, Variant
from benchmarks.telling import tell
from benchmarks.timing import Drive, Part
from vislam.base.errors import DataError
from vislam.base.files import check_writable, replace_whole
from vislam.cli.command import answer
from vislam.cli.console import Terminal
from vislam.comparison.config import Config, DataConfig, NoiseConfig, load
from vislam.evaluation.held_out import CAP_PX, HeldOut, HeldOutScore, hold_out, paired, score
from vislam.simulation import SimulationConfig

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
SCORES: Mapping[str, Callable[[HeldOutScore], float]] = {
    "median": lambda found: found.median,
    "RMS": lambda found: found.capped_rms,
}
"""Figures of a score [px]."""


@dataclass(frozen=True)
class Ranked:
    """A run by both measures."""

    errors: Errors
    score: HeldOutScore


@dataclass(frozen=True)
class Ranking:
    """Runs over one drive, measured.

    Attributes
    ----------
    drive : str
    runs : mapping of name to Ranked
    reference : str
    reference_score : HeldOutScore
        What the truth or reference itself scores; of a frame that it lacks, a track is capped.
    """

    drive: str
    runs: Mapping[str, Ranked]
    reference: str
    reference_score: HeldOutScore

    def scores(self, figure: str) -> list[float]:
        """Scores of all runs [px]."""
        return [SCORES[figure](run.score) for run in self.runs.values()]

    def errors(self, key: str) -> list[float]:
        """Errors of all runs."""
        return [getattr(run.errors, key) for run in self.runs.values()]


def measure(drive: Drive, variants: Mapping[str, Variant], *, seed: int) -> Ranking:
    """Run the variants without the held-out tracks, and measure each by these and by the reference.

    Raises
    ------
    DataError
        If the drive has no reference with poses, or is shorter than 100 m.
    """
    sequence, reference = drive.dataset.sequence, drive.dataset.reference
    if reference is None or reference.pose is None:
        raise DataError(f"{drive.name}: a reference with poses is needed")
    mask = hold_out(sequence.track, share=SHARE, seed=seed)
    held, given = HeldOut.of(sequence, mask), Given.without(drive, mask)
    found = {}
    with Terminal().bar("runs", len(variants)) as bar:
        for done, (name, variant) in enumerate(variants.items(), start=1):
            found_poses = variant.run(name, given).world_T_imu
            wrong = errors(found_poses, reference, sequence.rig)
            found[name] = Ranked(wrong, score(held, found_poses))
            bar.done(done)
    own = score(held, poses(reference), frame=reference.frame)
    return Ranking(drive.name, found, reference.name, own)


def runs_part(found: Ranking) -> Part:
    """Table of the runs, best score first."""
    order = sorted(found.runs, key=lambda name: found.runs[name].score.median)
    tracks = len(found.reference_score.rms)
    own = _figures(found.reference_score)
    return Part(
        title=f"{found.drive}: {len(order)} runs by {tracks} held-out tracks",
        header=["run", "median", "RMS", "capped", *(key.replace("_", " ") for key in AXES)],
        rows=[
            _row(name, found.runs[name].score, [f"{error:.3g}" for error in astuple(found.runs[name].errors)])
            for name in order
        ]
        + [_row(f"({found.reference})", found.reference_score, ["-"] * len(AXES))],
        notes=(
            f"median, RMS: of the held-out tracks [px], capped: how many have {CAP_PX:g} px or more; "
            + ", ".join(AXES.values()),
        ),
        values={
            "tracks": tracks,
            "runs": {name: {**_figures(one.score), **asdict(one.errors)} for name, one in found.runs.items()},
            "reference": {"name": found.reference, **own},
        },
    )


def _row(name: str, scored: HeldOutScore, wrong: Sequence[str]) -> list[str]:
    pixels = [f"{figure(scored):.3f}" for figure in SCORES.values()]
    return [name, *pixels, f"{scored.capped}", *wrong]


def _figures(scored: HeldOutScore) -> dict[str, float]:
    return {**{name: figure(scored) for name, figure in SCORES.items()}, "capped": scored.capped}


def ranks_part(found: Ranking) -> Part:
    """Rank correlations of scores and errors, and whether pairs that are told apart are so rightly."""
    rows, values = [], []
    for name in SCORES:
        for key, title in AXES.items():
            rho = spearmanr(found.scores(name), found.errors(key))
            tau = kendalltau(found.scores(name), found.errors(key))
            numbers = [float(part) for part in (rho.statistic, rho.pvalue, tau.statistic, tau.pvalue)]
            rows.append([name, title, *(f"{number:.2g}" for number in numbers)])
            named = dict(zip(("spearman", "spearman_p", "kendall", "kendall_p"), numbers, strict=True))
            values.append({"score": name, "error": key, **named})
    told, right = told_apart(found.runs)
    shares = ", ".join(f"{title} {100.0 * right[key] / max(told, 1):.0f} %" for key, title in AXES.items())
    pairs = len(found.runs) * (len(found.runs) - 1) // 2
    return Part(
        title=f"{found.drive}: rank correlation over {len(found.runs)} runs",
        header=["score", "error", "Spearman", "p", "Kendall", "p"],
        rows=rows,
        notes=(
            f"{told} of {pairs} pairs of runs are told apart (p < {_TOLD_APART:g}); the better score "
            f"has the smaller error in so many of these: {shares}",
        ),
        values={"correlations": values, "pairs": pairs, "told_apart": told, "rightly": right},
    )


def told_apart(runs: Mapping[str, Ranked]) -> tuple[int, dict[str, int]]:
    """Count the pairs of runs that are told apart, and how many of these rightly, by each error."""
    told, right = 0, dict.fromkeys(AXES, 0)
    for one, other in combinations(runs.values(), 2):
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
    tell({"runs": lambda: runs_part(found), "ranks": lambda: ranks_part(found)}, out=options.out)
    if options.figure is not None:
        drawn = dots(
            dict(zip(found.runs, found.scores("median"), strict=True)),
            {title: found.errors(key) for key, title in AXES.items()},
            reference=(found.reference, found.reference_score.median),
            title=f"{found.drive}: held-out tracks against {found.reference}",
        )
        with replace_whole(options.figure) as temporary:
            drawn.savefig(temporary, format="png", dpi=110)
    return 0


if __name__ == "__main__":
    sys.exit(main())
