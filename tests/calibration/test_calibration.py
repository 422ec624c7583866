"""Calibration of simulated drives whose noise is planted, of just the kind that the filter's model has."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.base.errors import ConfigError, DataError, DivergedError
from vislam.calibration import Calibration, calibrate, parameters
from vislam.calibration.parameters import MATCH
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import Dataset
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.estimators.ekf import EkfEstimator
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.repair.inertial import Clock
from vislam.simulation import SimulationConfig
from vislam.simulation.drive import stereo_rig
from vislam.simulation.path import DrivePath
from vislam.simulation.tracks import simulate_tracks

DENSITY = np.array([1e-3, 1e-3, 1e-3, 0.02, 0.03, 0.015])
BIAS = np.array([0.004, -0.003, 0.005, 0.03, -0.02, 0.01])
CLOCK = 0.02
PLANTED = {
    "noise.pixel_sigma_px": 0.3,
    "noise.drift_px": 0.1,
    "noise.matching_bias_px": 0.4,
    "noise.twist_density (gyro)": DENSITY[0],
    "noise.twist_density (forward)": DENSITY[3],
    "noise.twist_density (lateral)": DENSITY[4],
    "noise.twist_density (vertical)": DENSITY[5],
    "data.repair.clock.offset": CLOCK,
}
_SAMPLES = 10
"""Inertial samples a frame."""


def simulated(seed: int, *, frames: int, tracks: float = 25.0, **changes) -> Dataset:
    """A drive that fits the filter's model: the twist is exact but for clock and bias, the motion is noisy.

    Noise of the samples would not do: to move the clock would then move the noise, and averages of shifted
    samples have less of it, which a likelihood takes for evidence.
    """
    values = {"pixel_sigma_px": 0.3, "drift_px": 0.1, "matching_bias_px": 0.4, "density": DENSITY, **changes}
    density = values.pop("density")
    # No track begins so far away that its depth were not normal.
    config = SimulationConfig(frames=frames, tracks_in_view=tracks, depth_max=40.0, **values)
    generator = np.random.default_rng(seed)
    path, rig = DrivePath(config, generator), stereo_rig(config)
    at = config.period / _SAMPLES * np.arange(-2 * _SAMPLES, (frames + 2) * _SAMPLES)
    nothing = Sequence(
        name="planted",
        stamp=config.period * np.arange(frames),
        inertial_stamp=at,
        twist=path.twist(at - CLOCK) + BIAS,
        vertical_velocity=np.full(len(at), np.nan),
        rig=rig,
        offset=np.zeros(frames + 1, np.int64),
        track=np.empty(0, np.int64),
        pixels=np.empty((0, 4)),
        row=np.empty(0, np.int64),
        synthetic=True,
    )
    mean = Clock(offset=CLOCK).apply(nothing).step_means()[0][1:] - BIAS
    noise = np.sqrt(config.period) * density * generator.standard_normal(mean.shape)
    world_T_imu = [np.eye(4)]
    for step in se3.exp(config.period * mean + noise):
        world_T_imu.append(world_T_imu[-1] @ step)
    tracks_seen = simulate_tracks(config, rig, np.array(world_T_imu) @ rig.imu_T_cam, generator)
    sequence = replace(
        nothing,
        offset=tracks_seen.offset,
        track=tracks_seen.track,
        pixels=tracks_seen.pixels,
        row=np.arange(len(tracks_seen.track)),
    )
    return Dataset(sequence, None, ())


def config_of(*, clock: float | None = None, **noise) -> Config:
    """Config with the planted noise, unless changed, and no repair but the clock's."""
    nothing = dict.fromkeys(
        ("duplicated_tracks", "disparity", "interruptions", "consensus", "single_observations")
    )
    steps = RepairConfig(**nothing, clock=None if clock is None else Clock(offset=clock))
    values = {
        "pixel_sigma_px": 0.3,
        "drift_px": 0.1,
        "matching_bias_px": 0.4,
        "twist_density": tuple(DENSITY.tolist()),
        "bias_walk": (0.0,) * 6,
        **noise,
    }
    return Config(
        name="planted",
        data=DataConfig(simulation=SimulationConfig(), repair=steps),
        noise=NoiseConfig(**values),
    )


def off() -> Config:
    """Where the searches start: every level some way off, the clock unknown."""
    density = DENSITY * [1.4, 1.4, 1.4, 1.4, 0.7, 1.4]
    return config_of(
        pixel_sigma_px=0.4, drift_px=0.15, matching_bias_px=0.6, twist_density=tuple(density.tolist())
    )


def only(*names: str):
    """Parameters whose names end like that."""
    return [item for item in parameters(inertial=True) if item.name.endswith(names)]


def deviations(result: Calibration) -> dict[str, float]:
    """Errors over claimed standard deviations, in the searched scale; of the biases too."""
    found = {}
    for item in result.parameters:
        searched = item.parameter.searched
        sigma = (searched(item.high) - searched(item.value)) / 1.96
        error = searched(item.value) - searched(PLANTED[item.parameter.name])
        found[item.parameter.name] = error / sigma if item.needed else np.inf
    bias = (result.bias - BIAS) / result.bias_sigma
    return {**found, **{f"bias {index}": float(value) for index, value in enumerate(bias)}}


def ratio(run) -> float:
    return float(run.innovations.nis.sum() / run.innovations.dof.sum())


@pytest.fixture(scope="module")
def known_clock() -> Calibration:
    """One short drive, all levels and the biases."""
    names = [item for item in parameters(inertial=True) if "clock" not in item.name]
    return calibrate(off_with_clock(), with_clock(simulated(1, frames=60)), names)


def off_with_clock() -> Config:
    start = off()
    return replace(start, data=config_of(clock=CLOCK).data)


def with_clock(dataset: Dataset) -> Dataset:
    return replace(dataset, sequence=Clock(offset=CLOCK).apply(dataset.sequence))


@pytest.mark.slow
def test_planted_levels_and_biases_are_found(known_clock):
    errors = deviations(known_clock)
    assert set(errors) == set(PLANTED) - {"data.repair.clock.offset"} | {f"bias {i}" for i in range(6)}
    assert max(np.abs(list(errors.values()))) < 4.0, errors


@pytest.mark.slow
def test_innovations_are_as_large_as_claimed_afterwards(known_clock):
    assert 0.9 < ratio(known_clock.after) < 1.1
    assert abs(ratio(known_clock.before) - 1.0) > 0.1


@pytest.mark.slow
def test_the_config_holds_what_was_found(known_clock):
    for item in known_clock.parameters:
        assert item.parameter.read(known_clock.config) == pytest.approx(item.value, rel=1e-9)
        assert item.parameter.read(off_with_clock()) == pytest.approx(item.before, rel=1e-9)
        assert item.low < item.value < item.high
    # Nothing stands still, and what the camera says of the bias becomes no prior.
    assert known_clock.config.noise.bias_mean == off().noise.bias_mean
    assert known_clock.config.noise.bias_sigma == off().noise.bias_sigma


@pytest.mark.slow
def test_what_was_planted_predicts_blocks_that_were_left_out_better(known_clock):
    assert known_clock.best is not None
    assert known_clock.best.predicted.total > 2.0 * known_clock.best.predicted.sigma
    assert known_clock.rejected == ""


@pytest.mark.slow
def test_nothing_else_was_searched(known_clock):
    # Nothing but noise was searched.
    assert replace(known_clock.config, noise=off().noise) == off_with_clock()


@pytest.mark.slow
def test_a_planted_clock_offset_is_found():
    dataset = simulated(2, frames=60)
    result = calibrate(config_of(), dataset, only("clock.offset"))
    (clock,) = (item for item in result.parameters if item.parameter.name == "data.repair.clock.offset")
    sigma = (clock.high - clock.value) / 1.96
    assert abs(clock.value - CLOCK) < 4.0 * sigma
    assert sigma < CLOCK
    assert result.config.data.repair.clock.offset == clock.value


@pytest.mark.slow
def test_noise_of_piecewise_constant_steps_is_found():
    """The other way round: the motion is exact, and each step's twist has noise of its own."""
    dataset = simulated(3, frames=45, density=np.zeros(6))
    whole = Clock(offset=CLOCK).apply(dataset.sequence).step_means()[0][1:]
    dt = np.diff(dataset.sequence.stamp)[:, None]
    noise = DENSITY / np.sqrt(dt) * np.random.default_rng(4).standard_normal(whole.shape)
    stamp, twist = piecewise_constant(dataset.sequence.stamp, whole + noise)
    sequence = replace(
        dataset.sequence, inertial_stamp=stamp, twist=twist, vertical_velocity=np.full(len(stamp), np.nan)
    )
    start = replace(off().noise, pixel_sigma_px=0.3, drift_px=0.1, matching_bias_px=0.4)
    chosen = only("(gyro)", "(forward)", "(lateral)", "(vertical)")
    result = calibrate(replace(off(), noise=start), replace(dataset, sequence=sequence), chosen)
    errors = deviations(result)
    assert max(np.abs(list(errors.values()))) < 4.0, errors


@pytest.mark.slow
@pytest.mark.parametrize("factor", [3.0, 1.0 / 3.0])
def test_pixel_noise_three_times_off_is_brought_back(factor):
    dataset = with_clock(simulated(5, frames=40))
    start = config_of(clock=CLOCK, pixel_sigma_px=factor * 0.3)
    result = calibrate(start, dataset, only("pixel_sigma_px", "drift_px"))
    assert result.config.noise.pixel_sigma_px == pytest.approx(0.3, rel=0.1)
    assert abs(deviations(result)["noise.pixel_sigma_px"]) < 4.0
    assert 0.9 < ratio(result.after) < 1.1
    assert not 0.8 < ratio(result.before) < 1.2


@pytest.mark.slow
def test_side_slip_that_is_not_there_is_said_not_to_be_needed():
    density = DENSITY * [1.0, 1.0, 1.0, 1.0, 0.0, 1.0]
    dataset = with_clock(simulated(6, frames=40, density=density))
    result = calibrate(config_of(clock=CLOCK), dataset, only("(lateral)"))
    lateral = result.parameters[0]
    assert not lateral.needed
    assert lateral.value == pytest.approx(lateral.parameter.lowest)
    assert lateral.low == 0.0


def test_without_observations_there_is_nothing_to_calibrate_on():
    dataset = simulated(7, frames=5)
    nothing = dataset.sequence.select(np.zeros(dataset.sequence.observations, bool))
    with pytest.raises(DataError, match="no stereo observation is left"):
        calibrate(config_of(), replace(dataset, sequence=nothing), parameters())


def test_a_filter_that_does_not_finish_is_an_error(monkeypatch):
    def failing(self, frame):
        raise DivergedError("covariance lost, smallest variance -1")

    monkeypatch.setattr(EkfEstimator, "process", failing)
    with pytest.raises(DivergedError, match=r"the filter did not finish.*covariance lost"):
        calibrate(config_of(), simulated(8, frames=5), parameters())


@pytest.mark.statistical
def test_intervals_cover_what_was_planted_about_as_often_as_they_say():
    """Of 156 intervals of 95 % 143 did, 92 %: 78 of 84 of levels and clock, 65 of 72 of biases.

    That of the match, which is a fixed point and no maximum, did 11 times in 12, its mean 1 % too low.
    """
    covered: dict[str, list[bool]] = {}
    levels = []
    for seed in range(20, 32):
        result = calibrate(off(), simulated(seed, frames=80), parameters(inertial=True))
        assert 0.93 < ratio(result.after) < 1.07 or result.best is None
        for name, deviation in deviations(result).items():
            covered.setdefault(name, []).append(abs(deviation) < 1.96)
        levels += [one.value for one in result.parameters if one.parameter is MATCH]
    match = covered.pop("noise.matching_bias_px")
    assert len(covered) == 7 + 6
    assert len(match) == 12
    rates = {name: float(np.mean(hits)) for name, hits in covered.items()}
    biases = np.concatenate([hits for name, hits in covered.items() if name.startswith("bias")])
    others = np.concatenate([hits for name, hits in covered.items() if not name.startswith("bias")])
    pooled = np.concatenate([biases, others])
    # Intervals that covered three times in four would get there once in a thousand times.
    assert pooled.mean() >= 0.85, rates
    assert np.mean(match) >= 0.5
    assert min(rates.values()) >= 0.5, rates
    assert np.mean(levels) == pytest.approx(PLANTED["noise.matching_bias_px"], rel=0.15)


def test_raw_inertia_that_is_not_there_says_so():
    dataset = simulated(1, frames=4)
    config = Config(name="a", data=DataConfig(file="x.npz"), motion="imu")
    with pytest.raises(ConfigError, match="needs an accelerometer and a gyro"):
        calibrate(config, dataset, parameters(config))
