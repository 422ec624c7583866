"""Score of the noise levels by the backward pass, against finite differences of the likelihood."""

from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.test_calibration import BIAS, CLOCK, config_of, simulated
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, VerticalVelocityConfig
from vislam.comparison.open import Dataset
from vislam.estimators import loop
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.scores import LEVELS, levels
from vislam.repair.inertial import Clock

FRAMES = 12
SMALL = 1e-3
"""Where all noise is this share of what is usual, a filter's likelihood has no linearisation to speak of."""
OPTIONS = EkfOptions(
    error="invariant",
    landmarks="anchored_uvd",
    marginalised_landmarks="filtered",
    track_errors="states",
    gate=False,
)
WRITES = {
    0: lambda noise, factor: replace(noise, pixel_sigma_px=factor * noise.pixel_sigma_px),
    1: lambda noise, factor: replace(noise, drift_px=factor * noise.drift_px),
    **{
        2 + axis: lambda noise, factor, axis=axis: replace(
            noise, twist_density=_times(noise.twist_density, axis, factor)
        )
        for axis in (0, 5)
    },
    **{
        8 + axis: lambda noise, factor, axis=axis: replace(
            noise, acceleration_density=_times(noise.acceleration_density, axis, factor)
        )
        for axis in (1, 3)
    },
    14: lambda noise, factor: replace(
        noise,
        vertical_velocity=replace(noise.vertical_velocity, walk=factor * noise.vertical_velocity.walk),
    ),
}
"""How each level is changed in a config, by its place among the levels."""


def _times(values, axis, factor):
    return tuple(value * (factor if at == axis else 1.0) for at, value in enumerate(values))


def run(config: Config, dataset: Dataset, *, scored: bool = False, options: EkfOptions = OPTIONS):
    problem = make_problem(config, dataset)
    solver = EkfEstimator(problem, options, scored=scored)
    found = loop.run(
        solver, dataset.sequence, pixel_sigma(config, dataset), name="ekf", blas_threads=config.blas_threads
    )
    assert found.complete
    return solver, found


@pytest.fixture(scope="module")
def drive() -> Dataset:
    dataset = simulated(
        3,
        frames=FRAMES,
        tracks=6.0,
        pixel_sigma_px=0.3 * SMALL,
        drift_px=0.1 * SMALL,
        matching_bias_px=0.4 * SMALL,
        density=SMALL * np.array([1e-3, 1e-3, 1e-3, 0.02, 0.03, 0.015]),
    )
    sequence = dataset.sequence
    climbing = np.full(len(sequence.inertial_stamp), 0.01 * SMALL)
    sequence = replace(sequence, vertical_velocity=climbing)
    return replace(dataset, sequence=Clock(offset=CLOCK).apply(sequence))


def small(**noise) -> Config:
    """Levels that are off by tens of percent, each in its own way, with the shared errors as states."""
    return config_of(
        clock=CLOCK,
        pixel_sigma_px=0.4 * SMALL,
        drift_px=0.07 * SMALL,
        matching_bias_px=0.4 * SMALL,
        twist_density=tuple(SMALL * np.array([2e-3, 1e-3, 3e-3, 0.02, 0.02, 0.02])),
        bias_mean=tuple(BIAS.tolist()),
        bias_sigma=(0.01 * SMALL,) * 6,
        bias_walk=(1e-4 * SMALL,) * 6,
        camera_rotation_sigma=1e-3 * SMALL,
        velocity_direction_sigma=1e-3 * SMALL,
        **{"clock_sigma": 1e-3 * SMALL, **noise},
    )


SMOOTH = {
    "acceleration_density": tuple(SMALL * np.array([0.3, 0.2, 0.4, 2.0, 0.5, 0.5])),
    "vertical_velocity": VerticalVelocityConfig(walk=5.0 * SMALL, tilt_sigma=0.05 * SMALL),
}


@pytest.mark.parametrize("noise", [{}, SMOOTH])
def test_score_is_the_derivative_of_the_likelihood(drive, noise):
    config = small(**noise)
    solver, found = run(config, drive, scored=True)
    score = solver.scores(FRAMES).levels
    assert score.shape == (FRAMES, LEVELS)
    used = levels(make_problem(config, drive)) > 0.0
    checked = 0
    for place, write in WRITES.items():
        if not used[place]:
            assert not score[:, place].any()
            continue
        h = 1e-3
        values = [
            run(replace(config, noise=write(config.noise, np.exp(sign * h))), drive)[1].innovations
            for sign in (1.0, -1.0)
        ]
        slope = (values[0].log_likelihood.sum() - values[1].log_likelihood.sum()) / (2.0 * h)
        scale = np.abs(score[:, place]).sum()
        assert abs(score[:, place].sum() - slope) < 1e-3 * scale, place
        checked += 1
    assert checked == (len(WRITES) if noise else 4)
    assert np.isfinite(found.innovations.log_likelihood).all()


@pytest.mark.parametrize("noise", [{}, SMOOTH])
def test_score_of_the_recorded_motion_is_the_derivative_by_it(drive, noise):
    """By a clock, which moves all samples; what it changes the noise of a step by is no part of it."""
    config = small(**{**noise, "clock_sigma": 0.0})
    solver, _ = run(config, drive, scored=True)
    by_input = solver.scores(FRAMES).inputs
    h, values, means = 1e-6, [], []
    for sign in (1.0, -1.0):
        moved = replace(drive, sequence=Clock(offset=CLOCK + sign * h).apply(drive.sequence))
        values.append(run(config, moved)[1].innovations.log_likelihood.sum())
        means.append(np.nan_to_num(np.column_stack(moved.sequence.step_means())))
    slope = (values[0] - values[1]) / (2.0 * h)
    found = by_input * (means[0] - means[1]) / (2.0 * h)
    assert found.sum() == pytest.approx(slope, abs=2e-2 * np.abs(found).sum())
