"""Checks of the estimator protocol, for the tests of an estimator of your own."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vislam.base.errors import ContractError
from vislam.base.types import Array, BoolArray
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.estimator import Build, find
from vislam.core.run import Run
from vislam.estimators.loop import run
from vislam.simulation.settings import SimulationConfig

_SAME = 1e-9


def check_estimator(
    build: Build | str, options: Mapping[str, Any] | None = None, *, frames: int = 16, seed: int = 0
) -> Run:
    """Run an estimator over a short simulated sequence in several ways, and compare the results.

    Shapes, rotations and covariances are checked at each step, as in every comparison. Beyond that:

    * two runs give the same results;
    * it is causal: its step at a frame does not change when later frames are left out;
    * it does not fuse rejected observations.

    Parameters
    ----------
    build : callable or str
        As a config names it, or the function itself.
    options : mapping, optional
        Of the config's section.
    frames : int
        Length of the sequence.
    seed : int
        Seed of the sequence.

    Returns
    -------
    Run
        The run over the whole sequence.

    Raises
    ------
    ContractError
        States the violation in one line.

    Examples
    --------
    >>> from vislam.testing import check_estimator
    >>> check_estimator("dead_reckoning").complete
    True
    """
    simulation = SimulationConfig(frames=frames, tracks_in_view=20)
    config = Config(
        name="check",
        data=DataConfig(simulation=simulation),
        noise=NoiseConfig(pixel_sigma_px=simulation.pixel_sigma_px),
        seed=seed,
    )
    dataset = open_dataset(config.data, seed=seed, data_dir=None, allow_stand_in=True)
    whole = _run(build, options, config, dataset)
    again = _run(build, options, config, dataset)
    _refuse_other("two runs over the same drive differ", whole, again, frames=frames)
    half = frames // 2
    shortened = replace(dataset, sequence=dataset.sequence.first(half))
    shorter = _run(build, options, config, shortened)
    _refuse_other("later frames change what it says at a frame", whole, shorter, frames=half)
    usable = np.ones(dataset.sequence.observations, bool)
    usable[::3] = False
    count = int(np.count_nonzero(_run(build, options, config, dataset, usable=usable).used & ~usable))
    if count:
        raise ContractError(f"fused {count} observations that are not usable (frame.stereo.usable)")
    return whole


def _run(
    build: Build | str,
    options: Mapping[str, Any] | None,
    config: Config,
    dataset: Dataset,
    *,
    usable: BoolArray | None = None,
) -> Run:
    builder = find(build) if isinstance(build, str) else build
    estimator = builder(make_problem(config, dataset), dict(options or {}))
    sigma = pixel_sigma(config, dataset)
    found = run(estimator, dataset.sequence, sigma, name="checked", usable=usable)
    if not found.complete:
        raise ContractError(found.log.error)
    return found


def _refuse_other(what: str, one: Run, other: Run, *, frames: int) -> None:
    theirs = _reported(other)
    for name, mine in _reported(one).items():
        same = _same(mine[:frames], theirs.get(name, np.full_like(mine, np.nan))[:frames])
        if not same.all():
            raise ContractError(f"frame {int(np.argmin(same))}: {what} ({name})")


def _same(first: Array, second: Array) -> BoolArray:
    """At which frames ``(T,)`` two reports ``(T, ...)`` are the same, but for rounding."""
    if first.shape != second.shape:
        return np.zeros(len(first), bool)
    close = np.isclose(first, second, rtol=_SAME, atol=_SAME, equal_nan=True)
    return np.asarray(close.reshape(len(first), -1).all(axis=1))


def _reported(run: Run) -> dict[str, Array]:
    """What a run reported at each frame, by name."""
    states = {f"states.{name}": state.value for name, state in run.states.items()}
    poses = {"pose": run.filtered.world_T_imu, "pose_cov": run.filtered.covariances}
    return {**poses, "nis": run.innovations.nis, **states}
