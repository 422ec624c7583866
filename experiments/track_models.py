"""What errors of the tracks are: alternatives to tracks that err each for itself, by their likelihood.

``python -m experiments.track_models CONFIG...`` runs ``eks`` on recordings with errors that all tracks of a
frame share beside those that each has (:data:`MODELS`), all on one common observation set, and prints by how
much the log likelihood of the innovations rises, with its standard error by blocks of time. Each innovation
is predicted from the frames before it, so nothing has been fitted to what it is scored on. Beside it are the
error and the scale gap of the smoothed poses, where there is a reference.

* ``common drift``: the image as a whole walks randomly while a track is followed, by so many pixels a frame
  in column and row; a track that starts has none of it.
* ``common noise``: an error common to all observations of a frame, independent from frame to
  frame (the principal point jumps).
* ``walking image``: the image walks for all tracks, new ones too (the principal point walks).
* ``walking mount``: the same by a rotation of the cameras in the body.
* ``more drift``: no shared error, the drift of each track is that much larger.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from vislam.base.shipped import find_config
from vislam.base.types import IntArray
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.comparison.compare import compare
from vislam.comparison.results import Results
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.linear import Move
from vislam.estimators.ekf.measurement import View
from vislam.estimators.ekf.state import JointState
from vislam.evaluation import Evaluation, evaluate
from vislam.models.shared_errors import CAMERA_ROTATION, PRINCIPAL_POINT

BLOCKS = 20
_SMALL = 1e-6
"""Prior of what is to walk, or to jump, from a known start."""
_OPTIONS = EkfOptions(error="invariant", landmarks="anchored_uvd", smoothed=True, gate=False)


@dataclass(frozen=True)
class Model:
    """Shared errors beside a config's own noise, as options of :func:`build`.

    Attributes
    ----------
    common_drift, common_noise : float
        Standard deviations a frame [px].
    image_walk, mount_walk : float
        Densities of random walks [px/sqrt(s), rad/sqrt(s)].
    more_drift : float
        Factor on the drift that each track has.
    """

    common_drift: float = 0.0
    common_noise: float = 0.0
    image_walk: float = 0.0
    mount_walk: float = 0.0
    more_drift: float = 1.0


MODELS: Mapping[str, Model] = {
    "each for itself": Model(),
    **{f"common drift, {level:g} px": Model(common_drift=level) for level in (0.05, 0.1, 0.2)},
    **{f"common noise, {level:g} px": Model(common_noise=level) for level in (0.05, 0.1, 0.2)},
    **{f"walking image, {level:g} px": Model(image_walk=level) for level in (0.1, 0.3, 1.0)},
    **{f"walking mount, {1e3 * level:g} mrad": Model(mount_walk=level) for level in (1e-4, 5e-4)},
    **{f"more drift, {share:g} times": Model(more_drift=share) for share in (1.5, 2.0)},
}


class SharedTrackErrors(EkfEstimator):
    """``eks`` with errors that all tracks of a frame share.

    Parameters
    ----------
    problem : Problem
    model : Model
    """

    def __init__(self, problem: Problem, model: Model) -> None:
        walks = {PRINCIPAL_POINT: model.image_walk, CAMERA_ROTATION: model.mount_walk}
        walks = {name: walk for name, walk in walks.items() if walk > 0.0}
        noise = replace(problem.track_noise, drift=model.more_drift * problem.track_noise.drift)
        super().__init__(
            replace(
                problem,
                track_noise=noise,
                principal_point_sigma=_SMALL if model.image_walk or model.common_noise else 0.0,
                camera_rotation_sigma=_SMALL if model.mount_walk else 0.0,
                shared_walk=walks,
            ),
            replace(_OPTIONS, track_errors="states"),
        )
        self._model = model

    def _add_drift(self, state: JointState, view: View, slots: IntArray) -> None:
        super()._add_drift(state, view, slots)
        if self._model.common_drift and len(slots):
            step = view.drift_step(self._model.common_drift)
            rows = state.layout.size + state.layout.landmark * slots[:, None] + np.arange(3)
            rows, stacked = rows.ravel(), step.reshape(-1, 2)
            state.cov[np.ix_(rows, rows)] += stacked @ stacked.T
        if self._model.common_noise:
            point = state.layout[PRINCIPAL_POINT]
            transition, noise = np.eye(state.layout.size), np.zeros((state.layout.size, state.layout.size))
            transition[point, point] = 0.0
            noise[point, point] = self._model.common_noise**2 * np.eye(2)
            state.nav = transition @ state.nav
            jump = Move(transition)
            jump.forward(state.cov, noise)
            if state.steps is not None:
                state.steps.append(jump)


def build(problem: Problem, model: Model) -> SharedTrackErrors:
    """Build the estimator of a model, for ``estimator: experiments.track_models:build``."""
    return SharedTrackErrors(problem, model)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table for each config."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("config", nargs="+")
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder of the results")
    options = parser.parse_args(arguments)
    print("| recording | errors of the tracks | log likelihood | ATE [m] | gap, position | gap, pose |")
    print("|---|---|---:|---:|---:|---:|")
    for name in options.config:
        results = _run(find_config(name) or Path(name), options.out)
        for line in lines(results.runs, evaluate(results.runs, results.record)):
            print(f"| {results.record.name} | {line}", flush=True)
    return 0


def _run(path: Path, out: Path) -> Results:
    """All models on a recording."""
    runs = {
        name.replace(",", "").replace(" ", "_").replace(".", "p"): {
            "estimator": "experiments.track_models:build",
            **asdict(model),
        }
        for name, model in MODELS.items()
    }
    config = configuration.with_estimators(configuration.load(path), runs)
    config = replace(config, common_set_from=("ekf_invariant",))
    folder = compare(
        config,
        out=out,
        data_dir=None,
        config_dir=path.parent,
        allow_substitute=False,
        progress=Terminal(),
        report=False,
    ).folder
    return Results.load(folder)


def lines(runs: Mapping[str, Run], evaluation: Evaluation) -> Iterator[str]:
    """Cells of each run; the first is what the others are held against."""
    base = next(iter(runs.values())).innovations.log_likelihood
    for title, run in zip(MODELS, runs.values(), strict=True):
        if not run.complete:
            yield f"{title} | {run.log.error} | | | |"
            continue
        gain = np.nan_to_num(run.innovations.log_likelihood - base)
        blocks = np.array([block.sum() for block in np.array_split(gain, BLOCKS)])
        error = blocks.std(ddof=1) * np.sqrt(BLOCKS)
        figures = [_first(evaluation, run.name, keys) for keys in _KEYS]
        yield f"{title} | {gain.sum():+.0f} ± {error:.0f} | {' | '.join(figures)} |"


_KEYS = (
    ("ate_rmse", "ate_planar_rmse"),
    ("scale_gap_position", "scale_gap_position_planar"),
    ("scale_gap_pose",),
)
"""Of the smoothed poses, the first of each that a reference allows."""


def _first(evaluation: Evaluation, name: str, keys: Sequence[str]) -> str:
    found = (evaluation.value(name, key, "smoothed") for key in keys)
    return next((f"{value:.3g}" for value in found if value is not None), "")


if __name__ == "__main__":
    sys.exit(main())
