"""Shared fixtures: simulated problems, and the recorded files where they are."""

import logging
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

_TOLD = 2.0
"""A fast test that takes longer is told [s of CPU]."""
_spent: dict[str, float] = {}


def pytest_addoption(parser):
    parser.addoption(
        "--most-cpu",
        type=float,
        metavar="SECONDS",
        help="fail if a test takes more CPU than that, workers' too",
    )


def pytest_collection_modifyitems(items):
    """Long ones first, so that no worker has one of them left when the others are done."""
    items.sort(key=lambda item: not ({"statistical", "slow"} & item.keywords.keys()))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """One stretch of the list for each worker, so that few fixtures are made twice; who is done helps."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


def _cpu() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    before = _cpu()
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu", _cpu() - before))


def pytest_runtest_logreport(report):
    if report.when == "teardown":
        _spent[report.nodeid] = dict(report.user_properties).get("cpu", 0.0)


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("--most-cpu") is not None:
        for name, seconds in sorted(_spent.items(), key=lambda item: -item[1]):
            if seconds > _TOLD:
                terminalreporter.write_line(f"{seconds:.1f} s of CPU: {name}")


def pytest_sessionfinish(session):
    most = session.config.getoption("--most-cpu")
    if most is not None and max(_spent.values(), default=0.0) > most and session.exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


SHORT = SimulationConfig(
    frames=25,
    tracks_in_view=25,
    pixel_sigma_px=0.3,
    drift_px=0.1,
    matching_bias_px=0.4,
    duplication_probability=0.1,
    gyro_bias=(0.003, -0.002, 0.004),
    gyro_sigma=0.002,
    velocity_sigma=0.02,
)


@pytest.fixture(autouse=True)
def _loggers_warn():
    """A command that ran in this process may have left the loggers at errors only."""
    logging.disable(logging.NOTSET)
    logging.getLogger().setLevel(logging.WARNING)


@pytest.fixture(autouse=True, scope="session")
def one_thread() -> Iterator[None]:
    """Small matrices: more threads of the linear algebra only get in each other's way."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def short_config() -> Config:
    """Twenty-five simulated frames with the noise that the estimators assume."""
    root = np.sqrt(SHORT.period)
    density = [SHORT.gyro_sigma * root] * 3 + [SHORT.velocity_sigma * root] * 3
    return Config(
        name="short",
        data=DataConfig(simulation=SHORT, repair=RepairConfig(consensus=None)),
        noise=NoiseConfig(
            pixel_sigma_px=0.3, drift_px=0.1, matching_bias_px=0.4, twist_density=tuple(density)
        ),
        # Each test says itself which observations are left out.
        common_set_from=(),
    )


@pytest.fixture(scope="session")
def short(short_config: Config) -> Dataset:
    return open_dataset(short_config.data, seed=3)


def plain_motion(config: Config) -> Config:
    """The same of whose motion nothing but the twist is known, as the references of the tests take it."""
    return replace(config, noise=replace(config.noise, vertical_velocity=None, acceleration_density=None))


def recorded(name: str) -> Path:
    """Path of a recorded file; skips the test, visibly, where it is missing."""
    folder = Path(os.environ.get("VISLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (folder / name).is_file():
        pytest.skip(f"recorded file {name} is not there (VISLAM_DATA)")
    return folder / name


def from_first(pose: np.ndarray) -> np.ndarray:
    """Poses relative to the first one, which is where every estimator starts."""
    return se3.inverse(pose[0]) @ pose
