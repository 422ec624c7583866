"""``python -m experiments.compare_cost``: CPU time of ``vislam compare`` by its parts.

Each command is a process of its own, whose user and system time are counted, so that other work on the
machine counts little. A part is the difference of two commands. With several checkouts each command is run
by one after the other, and the ratios are those to the first.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from experiments.timing import Part, tell

_IMPORTS = ("-c", "import vislam.comparison.compare, vislam.comparison.results, vislam.report.page")
_CHEAPEST = "dead_reckoning"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.compare_cost", description=__doc__)
    parser.add_argument("config", help="config, as of vislam compare")
    parser.add_argument("--estimators", required=True, help="comma-separated names")
    parser.add_argument(
        "--code",
        type=Path,
        action="append",
        metavar="FOLDER",
        help="checkout; repeat it for several (default: this one)",
    )
    options = parser.parse_args(arguments)
    folders = [path.resolve() for path in options.code or [Path(__file__).parents[1]]]
    tell({"compare": lambda: measure(options.config, options.estimators, folders)}, out=None)
    return 0


def measure(config: str, estimators: str, folders: Sequence[Path]) -> Part:
    """Run the commands of all parts by each checkout."""
    compare = ("-m", "vislam", "compare", config, "--estimators")
    commands = {
        "imports": _IMPORTS,
        "data, repairs, common observation set, scores": (*compare, _CHEAPEST, "--no-report"),
        "estimators": (*compare, estimators, "--no-report"),
        "page and figures": (*compare, estimators),
    }
    total = {part: [cpu_s(command, code) for code in folders] for part, command in commands.items()}
    rows, before = [], [0.0] * len(folders)
    for part, now in total.items():
        rows.append(_row(part, [late - early for late, early in zip(now, before, strict=True)]))
        before = now
    return Part(
        title=f"compare {config} --estimators {estimators}: CPU time",
        header=["part", *(f"{folder} [s]" for folder in folders), *["ratio"] * (len(folders) - 1)],
        rows=[*rows, _row("all", before)],
        notes=(),
        values={"cpu_s": total},
    )


def cpu_s(command: Sequence[str], code: Path) -> float:
    """User and system time [s] of a Python command by a checkout; CalledProcessError if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        before = os.times()
        subprocess.run(
            [sys.executable, *command],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(code)},
            check=True,
            capture_output=True,
        )
        after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def _row(part: str, seconds: Sequence[float]) -> list[str]:
    ratios = [f"{one / seconds[0]:.2f}" for one in seconds[1:]]
    return [part, *(f"{one:.1f}" for one in seconds), *ratios]


if __name__ == "__main__":
    sys.exit(main())
