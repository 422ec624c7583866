"""Shared fixtures: simulated problems, and the recorded files where they are."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

SHORT = SimulationConfig(
    frames=25,
    tracks_in_view=25,
    pixel_sigma_px=0.3,
    drift_px=0.1,
    match_px=0.4,
    stale_probability=0.1,
    gyro_bias=(0.003, -0.002, 0.004),
    gyro_sigma=0.002,
    velocity_sigma=0.02,
)


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
        noise=NoiseConfig(pixel_sigma_px=0.3, drift_px=0.1, match_px=0.4, twist_density=tuple(density)),
    )


@pytest.fixture(scope="session")
def short(short_config: Config) -> Dataset:
    return open_dataset(short_config.data, seed=3)


def recorded(name: str) -> Path:
    """Path of a recorded file; skips the test, visibly, where it is missing."""
    folder = Path(os.environ.get("VISLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (folder / name).is_file():
        pytest.skip(f"recorded file {name} is not there (VISLAM_DATA)")
    return folder / name


def from_first(pose: np.ndarray) -> np.ndarray:
    """Poses relative to the first one, which is where every estimator starts."""
    return se3.inverse(pose[0]) @ pose
