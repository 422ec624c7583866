"""Problems as they stand when iSAM2 has taken the last frame, of all that a graph may hold."""

from dataclasses import replace
from functools import cache

from tests import inertial
from tests.smoother.drives import drive
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import KernelConfig, LandmarksConfig, SharedWalkConfig, VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.loop import run
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions

SMOOTH = (0.09, 0.09, 0.05, 0.3, 0.2, 0.2)
CASES = {
    "short": {"loss_probability": 0.4},
    "long": {"loss_probability": 0.0, "depth_min": 20.0, "speed": 2.0},
    "all_that_is_estimated": {"navigation_frame_velocity": True, "hills_m": 10.0},
    "kernel": {"outlier_probability": 0.05},
    "constant": {"loss_probability": 0.2},
    "walking": {"loss_probability": 0.2},
    "seen_again": {"path": "circuit", "laps": 2, "landmarks": "recognised", "field_per_metre": 0.3},
    "inertial": {},
}
MORE = {
    "all_that_is_estimated": {
        "vertical_velocity": VerticalVelocityConfig(walk=0.02),
        "acceleration_density": SMOOTH,
        "velocity_direction_sigma": 0.02,
    },
    "constant": {"clock_sigma": 0.01, "camera_rotation_sigma": 0.01, "velocity_direction_sigma": 0.02},
    "walking": {
        "clock_sigma": 0.01,
        "camera_rotation_sigma": 0.01,
        "shared_walk": SharedWalkConfig(clock=0.001, camera_rotation=0.001),
    },
}


@cache
def ended(name, frames=22):
    """The problem of a drive, and an estimate of it that is not relinearised in the end."""
    if name == "inertial":
        config, dataset = inertial.drive()
    else:
        config, dataset = drive(seed=5, frames=frames, tracks_in_view=15, **CASES[name])
    if name == "seen_again":
        config = replace(config, data=replace(config.data, landmarks=LandmarksConfig(kept="always")))
        dataset = open_dataset(config.data, seed=5)
    if name == "all_that_is_estimated":
        data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
        config = replace(config, data=data)
        dataset = open_dataset(data, seed=5)
    config = replace(config, noise=replace(config.noise, **MORE.get(name, {})))
    if name == "kernel":
        config = replace(config, kernel=KernelConfig())
    kept = []

    class Kept(SmootherEstimator):
        def _finish(self, drive):
            kept.append((drive, super()._finish(drive)))
            return kept[-1][1]

    estimator = Kept(make_problem(config, dataset), SmootherOptions(final="as_is"))
    assert run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2").complete
    return kept[0]
