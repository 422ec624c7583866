"""All sets of tracks at hand: ``vislam inspect``, then ``vislam compare`` with the config that it wrote.

``python -m experiments.all_sets`` inspects each set, compares estimators with what was written, and
prints the tables of ``docs/results/other_recordings.md``: trajectories with ATE, NEES and held-out error,
filtered and smoothed, and verdicts. Nothing is set by hand but the estimators and, where the recording does
not bring it, the reference, which no estimator reads. Runs that are in ``--out`` already are kept; a set that
fails is named and passed over. Exit codes: 0 done, 2 bad arguments or a set that failed.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from vislam.cli import compare, inspect
from vislam.core.run import ESTIMATES, Estimate
from vislam.evaluation.lookup import Lookup
from vislam.inspection.checks import BARE_REPAIR

_TRACKS = "clement2015"
_PLANAR = {
    "file": "03_positions_xy.txt",
    "format": "planar_xy",
    "name": "KITTI-360 poses",
    "limits": "planar, 266 of 1010 frames in bursts, no height, no attitude",
    "sigma_m": 0.05,
}
_CAMERA = {
    "file": "0027_poses.txt",
    "format": "kitti",
    "pose_of": "left_camera",
    "up": "-y",
    "name": "KITTI odometry 07",
    "limits": "frames 0 to 1100 of 1106, left camera",
}
_USUAL: dict[str, dict[str, Any]] = {
    **{name: {} for name in ("dead_reckoning", "ekf", "ekf_invariant", "eks", "msckf")},
    "fixed_lag": {"pose_cov_every": 10},
    "isam2": {"pose_cov_every": 10, "marginals": "all"},
}
COLUMNS = "| filtered ATE [m] | NEES | held-out [px] | smoothed ATE [m] | NEES | held-out [px] |"


@dataclass(frozen=True)
class Set:
    """A set of tracks.

    Attributes
    ----------
    title : str
    data : mapping
        The config's ``data``.
    estimators : mapping
    planar : bool
        Whether its reference has no height.
    common_set_from : sequence of str
        Estimators whose observations are the common set.
    """

    title: str
    data: Mapping[str, Any]
    estimators: Mapping[str, Any] = field(default_factory=lambda: _USUAL)
    planar: bool = False
    common_set_from: Sequence[str] = ("ekf_invariant",)


def _mat(name: str) -> dict[str, Any]:
    return {"source": {"format": "clement_mat", "file": f"{_TRACKS}/{name}.mat"}}


SETS = {
    "starry_night": Set("Starry Night (`dataset3`)", _mat("dataset3")),
    "kitti_0001": Set("KITTI 2011_09_26 0001", _mat("2011_09_26_drive_0001_sync_KLT")),
    "kitti_0036": Set("KITTI 2011_09_26 0036", _mat("2011_09_26_drive_0036_sync_KLT")),
    "kitti_0020": Set("KITTI 2011_09_30 0020", _mat("2011_09_30_drive_0020_sync_KLT")),
    "ds3": Set("`03.npz`, planar ATE", {"file": "03.npz", "reference": _PLANAR}, planar=True),
    "kitti07": Set("`0027.npz`", {"file": "0027.npz", "reference": _CAMERA}),
    # 650 landmarks in view: only the filter without landmarks in its state has steps below a second.
    "kitti00": Set(
        "`kitti00`, of the gtsam wheel",
        {"packaged": {"name": "kitti00"}},
        {"dead_reckoning": {}, "msckf": {}, "isam2": {}},
        common_set_from=["msckf"],
    ),
}
"""The sets of tracks that DATA.md and the gtsam wheel have, by the names that the command takes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sets and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"of {', '.join(SETS)}; all by default")
    parser.add_argument("--data-dir", type=Path, help="first folder to look for data")
    parser.add_argument("--out", type=Path, default=Path("results/all_sets"), help="folder of the results")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.sets if name not in SETS]
    if unknown:
        parser.error(f"{unknown[0]}: no such set; expected one of {', '.join(SETS)}")
    found = {}
    for name in options.sets or SETS:
        document = run(name, SETS[name], out=options.out, data_dir=options.data_dir)
        if document is not None:
            found[name] = document
    print("\n".join([*trajectories(found), "", *verdicts(found)]), flush=True)
    return 0 if len(found) == len(options.sets or SETS) else 2


def run(name: str, one: Set, *, out: Path, data_dir: Path | None) -> dict[str, Any] | None:
    """Inspect a set, compare with what was written, and return both documents; None if one has failed."""
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    given, written = folder / "given.yaml", folder / "inspected.yaml"
    # As ``vislam inspect --file`` begins: with no repair configured, each fault is there to be found.
    tree = {"name": name, "data": {**one.data, "repair": BARE_REPAIR}, "estimators": dict(one.estimators)}
    tree["common_set_from"] = list(one.common_set_from)
    given.write_text(yaml.safe_dump(tree, sort_keys=False), "utf-8")
    place = [] if data_dir is None else ["--data-dir", str(data_dir)]
    common = [*place, "--no-substitute"]
    asked = [str(given), *common, "--out", str(folder / "inspection"), "--write-config", str(written)]
    if inspect.main(asked):
        return None
    # 1: a run that broke off, which the table has as such.
    if compare.main([str(written), *common, "--no-report", "--out", str(folder)]) not in (0, 1):
        return None
    newest = max(folder.glob(f"{name}-*/metrics.json"), key=lambda path: path.stat().st_mtime)
    inspected = json.loads((folder / "inspection" / "inspection.json").read_text("utf-8"))
    return {"metrics": json.loads(newest.read_text("utf-8")), "inspection": inspected}


def trajectories(found: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Table of all estimators of all sets, line by line."""
    yield f"| set | estimator {COLUMNS}"
    yield "|---|---|" + "---:|" * 6
    for name, documents in found.items():
        document = documents["metrics"]
        values = Lookup(
            {(m["estimator"], m["key"], m["estimate"]): float(m["value"]) for m in document["metrics"]}
        )
        title = SETS[name].title
        for run_name, told in document["runs"].items():
            mark = "" if told["complete"] else f", broke off: {told['error']}"
            reasons = dict.fromkeys(why for each in told["degenerate"].values() for why in each)
            mark += f", degenerate: {'; '.join(reasons)}" if reasons else ""
            cells: list[str] = []
            for estimate in ESTIMATES:
                here = estimate in told["estimates"]
                cells += _cells(values, run_name, estimate, name) if here else [""] * 3
            yield f"| {title} | `{run_name}`{mark} | {' | '.join(cells)} |"
            title = ""


def _cells(values: Lookup[float], run: str, estimate: Estimate, name: str) -> list[str]:
    """ATE, NEES and held-out error of an estimate."""
    planar = SETS[name].planar
    keys = ["ate_planar_rmse" if planar else "ate_rmse", "nees_position_planar" if planar else "nees_pose"]
    found = []
    for key, form in zip([*keys, "held_out_median"], (".3f", ".3g", ".2f"), strict=True):
        value = values.find(run, key, estimate)
        found.append("" if value is None else format(value, form))
    return found


def verdicts(found: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """Table of the verdicts of all sets, line by line."""
    yield "| set | faults | unclear |"
    yield "|---|---|---|"
    for name, documents in found.items():
        findings = documents["inspection"]["findings"]
        cells = [
            ", ".join(item["check"] for item in findings if item["verdict"] == verdict)
            for verdict in ("fault", "unclear")
        ]
        yield f"| {SETS[name].title} | {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(main())
