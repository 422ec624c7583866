"""The filter as a whole: against the batch, what it fuses when, the world, lags and the kernel."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.smoother.drives import ate, drive, gap, member
from vislam import load_config
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find
from vislam.core.frame import Frame
from vislam.estimators.loop import run
from vislam.estimators.msckf import MsckfEstimator, MsckfOptions, build
from vislam.evaluation.normalised import pose_errors
from vislam.geometry import se3
from vislam.models.kernel import Kernel
from vislam.testing import check_estimator

FORMS = ("standard", "fej", "invariant")


def made(config, dataset, *, kernel=None, **options):
    problem = replace(make_problem(config, dataset), kernel=kernel)
    estimator = MsckfEstimator(problem, MsckfOptions(**options))
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="msckf")
    assert found.complete, found.log.traceback
    return found


def faint(scale):
    """A drive whose errors, and what is stated of them, are small: the smaller, the more linear it is."""
    config, dataset = drive(
        seed=3, frames=20, pixel=0.3 * scale, gyro=0.002 * scale, velocity=0.02 * scale, tracks_in_view=20
    )
    noise = config.noise
    small = {
        name: tuple(scale * value for value in getattr(noise, name))
        for name in ("bias_sigma", "bias_walk", "first_pose_sigma")
    }
    return replace(config, noise=replace(noise, **small)), dataset


@pytest.mark.parametrize("form", FORMS)
def test_with_all_poses_kept_it_is_the_batch_but_for_linearisation(form):
    """The difference is of second order in the noise: a tenth of the noise leaves a hundredth of it."""
    apart = {}
    for scale in (0.1, 0.01):
        config, dataset = faint(scale)
        found = made(config, dataset, window=100, gate=False, error=form)
        batch = member("batch", config, dataset, marginals="poses")
        assert np.array_equal(found.used, batch.used)
        turned, apart[scale] = gap(found.smoothed.world_T_imu, batch.smoothed.world_T_imu)
        assert turned < 1e-6
        sigma = np.sqrt(np.diagonal(batch.smoothed.cov[-1]))
        assert np.allclose(np.sqrt(np.diagonal(found.smoothed.cov[-1])), sigma, rtol=0.02 * scale)
    # 2e-7 m where the standard deviation is 2e-4 m.
    assert apart[0.01] < 1e-6
    assert apart[0.01] < apart[0.1] / 30.0


@pytest.mark.parametrize("options", [{"error": form} for form in FORMS] + [{"window": 4, "max_length": 3}])
def test_it_keeps_the_contract(options):
    check_estimator("msckf", options)


def test_observations_are_fused_with_their_track(short, short_config):
    """None before its track ends; with a gate that nothing passes, all are gated."""
    problem = make_problem(short_config, short)
    estimator = MsckfEstimator(problem, MsckfOptions(window=5, max_length=3))
    sequence, sigma = short.sequence, pixel_sigma(short_config, short)
    age = {}
    for frame in sequence.frames(sigma, np.ones(sequence.observations, bool)):
        assert isinstance(frame, Frame)
        age = {track: age.get(track, 0) + 1 for track in frame.stereo.track.tolist()}
        step = estimator.process(frame)
        third = np.array([age[track] % 3 == 0 for track in frame.stereo.track.tolist()])
        assert np.array_equal(step.used | step.gated, third)
    found = made(short_config, short)
    assert not (found.used & found.gated).any()
    never = replace(short_config, gate_probability=1e-12)
    refused = made(never, short)
    assert not refused.used.any()
    assert refused.log.counts["tracks_rejected"] > 0
    assert refused.gated.mean() > 0.9
    assert made(never, short, gate=False).used.mean() > 0.9


def test_only_the_standard_form_gains_information_about_the_world(short, short_config):
    gained = {
        form: made(short_config, short, error=form).innovations.spurious_information.sum(axis=0)
        for form in FORMS
    }
    assert (gained["standard"] > 1e-3).all()
    assert (gained["fej"] < 1e-9).all()
    assert (gained["invariant"] < 1e-9).all()


def test_a_longer_window_is_nearer_to_the_batch():
    config, dataset = drive(seed=3, frames=30, tracks_in_view=20)
    batch = member("batch", config, dataset).smoothed.world_T_imu
    off = [gap(made(config, dataset, window=w).smoothed.world_T_imu, batch)[1] for w in (2, 8, 29)]
    assert off[0] > off[1] > off[2]
    assert ate(made(config, dataset).filtered.world_T_imu, dataset) < 0.1


BLOCKS = {
    "vertical velocity": {"vertical_velocity": VerticalVelocityConfig()},
    "smooth motion": {"acceleration_density": (0.1, 0.1, 0.1, 1.0, 1.0, 1.0)},
    "clock": {"clock_sigma": 0.02},
    "direction": {"velocity_direction_sigma": 0.01},
    "offset": {"disparity_offset_sigma_px": 0.3},
    "camera rotation": {"camera_rotation_sigma": 0.003},
    "principal point": {"principal_point_sigma_px": 2.0},
    "focal scale": {"focal_scale_sigma": 0.002},
}


@pytest.mark.parametrize("block", BLOCKS)
def test_every_block_of_the_state_is_that_of_the_ekf(block, short, short_config):
    """With all poses kept it is as sure of the last pose as the EKF is, and agrees with it."""
    config = replace(short_config, noise=replace(short_config.noise, **BLOCKS[block]))
    level = replace(short.sequence, vertical_velocity=np.zeros(len(short.sequence.vertical_velocity)))
    dataset = replace(short, sequence=level)
    ekf = find("eks")(make_problem(config, dataset), {"gate": False})
    other = run(ekf, level, pixel_sigma(config, dataset), name="eks").smoothed
    found = made(config, dataset, window=30, gate=False).smoothed
    sigma = np.sqrt(np.diagonal(other.cov[-1]))
    assert np.allclose(np.sqrt(np.diagonal(found.cov[-1])), sigma, rtol=0.1)
    assert (np.abs(se3.local(other.world_T_imu[-1], found.world_T_imu[-1])) < 0.5 * sigma).all()


def test_lags_are_read_from_the_window(short, short_config):
    asked = replace(short_config, lags=(0, 2, 24), lag_cov_every=1)
    found = made(asked, short, window=6)
    lagged = dict(found.lagged)
    assert np.array_equal(lagged[0].world_T_imu, found.filtered.world_T_imu)
    assert np.array_equal(lagged[0].cov, found.filtered.cov)
    # A pose that has left the window is what it was then.
    assert np.array_equal(lagged[24].world_T_imu, found.smoothed.world_T_imu)
    assert np.array_equal(
        made(short_config, short, window=6).filtered.world_T_imu, found.filtered.world_T_imu
    )


def test_a_kernel_bears_what_the_gaussian_does_not(short, short_config):
    pixels = short.sequence.pixels.copy()
    pixels[::20] += 20.0
    broken = replace(short, sequence=replace(short.sequence, pixels=pixels))
    plain = made(short_config, broken, gate=False)
    robust = made(short_config, broken, gate=False, kernel=Kernel(4.0))
    assert robust.log.counts["reweightings_not_converged"] == 0
    assert robust.innovations.dof.sum() == 0
    assert ate(robust.filtered.world_T_imu, short) < 0.5 * ate(plain.filtered.world_T_imu, short)


def test_a_kernel_of_light_tails_is_none(short, short_config):
    nearly = made(short_config, short, gate=False, kernel=Kernel(1e7))
    assert (
        gap(nearly.filtered.world_T_imu, made(short_config, short, gate=False).filtered.world_T_imu)[1] < 1e-5
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 0}, "window"),
        ({"window": 3, "min_length": 5}, "min_length must be at most window [+] 1 = 4, got 5"),
        ({"min_length": 4, "max_length": 3}, "max_length must be at least min_length, 4, got 3"),
        ({"windows": 3}, "windows"),
    ],
)
def test_options_that_cannot_be_are_a_line(options, message, short, short_config):
    with pytest.raises(ConfigError, match=message):
        build(make_problem(short_config, short), options)


DRAWN = {"frames": 80, "tracks_in_view": 20}


def last_nees(seed, *, share=1.0, **options):
    """NEES of the last pose of a drive whose noise and bias are drawn as stated, and NIS with its degrees."""
    config = load_config("efficiency", **{f"data__simulation__{key}": value for key, value in DRAWN.items()})
    dataset = open_dataset(config.data, seed=seed)
    estimator = MsckfEstimator(make_problem(config, dataset), MsckfOptions(window=10, **options))
    found = run(estimator, dataset.sequence, share * pixel_sigma(config, dataset), name="msckf")
    errors = pose_errors(found, dataset.reference, estimate="filtered")
    return errors["pose"].nees[-1], found.innovations.nis.sum(), found.innovations.dof.sum()


@pytest.mark.statistical
@pytest.mark.parametrize("form", ["fej", "invariant"])
def test_it_is_consistent_over_many_drives(form):
    """Sums of NEES and NIS are chi-square numbers; one test in a thousand would fail by chance."""
    nees, nis, dof = np.sum([last_nees(seed, error=form) for seed in range(30)], axis=0)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * 30)
    assert low < nees < high
    # The gate takes 0.27 % of the tracks, those with the largest residuals.
    low, high = chi2.ppf([0.0005, 0.9995], dof)
    assert 0.99 * low < nis < high


@pytest.mark.statistical
def test_noise_that_is_stated_too_small_is_seen():
    nees, nis, dof = np.sum([last_nees(seed, share=0.6) for seed in range(30)], axis=0)
    assert nees > chi2.ppf(0.9995, 6 * 30)
    assert nis > chi2.ppf(0.9995, dof)
