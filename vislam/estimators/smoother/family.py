"""The variants of the smoother: one name each, the same smoother with other options."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from vislam.base import settings
from vislam.base.errors import ConfigError
from vislam.core.estimator import Problem
from vislam.estimators.former import current
from vislam.estimators.smoother.incremental import SmootherEstimator
from vislam.estimators.smoother.options import SmootherOptions
from vislam.models import shared_errors

VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "isam2": {},
    # The textbook's pose graph: with the bias, which is of the order of the drift, assumed known.
    "isam2_between": {"motion": "between"},
    "isam2_norelin": {"relinearize_every": 0, "relinearize_beyond": None, "final": "as_is"},
    # What leaves the lag is read for the last time, so it is solved to the end: a change that is left alone
    # as small would stay. It is relinearised where one step corrects much of the trajectory, and no more
    # often: beside a marginal, what is wrong in view is believed the more, the better it is linearised.
    "fixed_lag": {
        "lag_s": 3.0,
        "relinearize_every": 0,
        "relinearize_beyond": "far",
        "wildfire_threshold": 0.0,
    },
    "batch": {"final": "batch", "final_iterations": 10},
    # The same optimum by our own linear algebra.
    "batch_schur": {"final": "batch", "final_iterations": 10, "optimiser": "schur"},
    "batch_gnc": {"final": "gnc", "final_iterations": 10},
}
"""What each variant sets; its config section may set the rest, or these again."""


def _not_known(name: str, problem: Problem) -> bool:
    return name in problem.shared()


_BETWEEN_LACKS: Mapping[str, Callable[[Problem], bool]] = {
    **{f"{shared_errors.prior_name(name)} to 0": partial(_not_known, name) for name in shared_errors.SIZES},
    "acceleration_density to null": lambda problem: problem.noise.acceleration is not None,
}
"""What motion: between has no variables for, each by its remedy."""


def _variant(name: str, problem: Problem, options: Mapping[str, Any]) -> SmootherEstimator:
    """Build a variant from a problem and the options of its config section."""
    at = f"estimators.{name}"
    parsed = settings.parse(SmootherOptions, {**VARIANTS[name], **current(options, at=at)}, at=at)
    if problem.imu is not None and parsed.motion == "between":
        raise ConfigError(
            f"estimators.{name}: motion: between is a step of the recorded twist, and the motion of the "
            "comparison is imu; leave the run out"
        )
    if problem.imu is not None and shared_errors.CAMERA_ROTATION in problem.shared():
        raise ConfigError(
            f"estimators.{name}: by raw inertia a smoother has no camera rotation as a variable; set "
            "noise.camera_rotation_sigma to 0, or compare filters only"
        )
    asked = [name for name, wanted in _BETWEEN_LACKS.items() if wanted(problem)]
    if parsed.motion == "between" and asked:
        raise ConfigError(
            f"estimators.{name}: motion: between has no variables but poses, landmarks and heights; "
            f"set noise.{asked[0]}, or motion to bias"
        )
    _refuse_halves(name, problem, parsed)
    return SmootherEstimator(problem, parsed)


def _refuse_halves(name: str, problem: Problem, options: SmootherOptions) -> None:
    """Refuse what has no meaning for the two factors of an observation where pixels have shared errors."""
    pixels = [error for error in shared_errors.OF_PIXELS if error in problem.shared()]
    if pixels and options.optimiser == "schur":
        raise ConfigError(
            f"estimators.{name}: optimiser: schur has observations of a known calibration; with "
            f"{pixels[0].replace('_', ' ')} estimated set it to gtsam, or "
            f"noise.{shared_errors.prior_name(pixels[0])} to 0"
        )
    weighed = "kernel" if problem.kernel is not None else ""
    if not options.plain:
        weighed = f"estimators.{name}.final" if options.final == "gnc" else f"estimators.{name}.factors"
    if pixels and weighed:
        raise ConfigError(
            f"estimators.{name}: with {pixels[0].replace('_', ' ')} estimated, GTSAM has two factors for an "
            f"observation, which {weighed} would weigh each by itself; set it to its plain value, or "
            f"noise.{shared_errors.prior_name(pixels[0])} to 0"
        )


build_isam2 = partial(_variant, "isam2")
build_between = partial(_variant, "isam2_between")
build_norelin = partial(_variant, "isam2_norelin")
build_fixed_lag = partial(_variant, "fixed_lag")
build_batch = partial(_variant, "batch")
build_schur = partial(_variant, "batch_schur")
build_gnc = partial(_variant, "batch_gnc")
