"""Axes of the rates: those of the body, or level ones that turn with its heading only.

Rates about level axes (OXTS: forward, left and up) are those of the body, rotated by its roll and pitch.
Which of the two a recording has is seen where it turns while it is tilted. Three models are fitted to the
turns that the camera sees, each with a constant bias: rates about the body's axes, the same with a constant
rotation that the mounting may be off by, and rates about level axes. The last two are alike while the tilt
does not change.

Costs are those of Cauchy's loss, which for small residuals is their sum of squares in standard deviations, so
that the difference of two is twice the logarithm of a likelihood ratio.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from vislam.base.types import Array, IntArray
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.motion import VisionSteps
from vislam.repair import RepairConfig
from vislam.repair.inertial import Tilt

_CHECK = "axes of the rates"
_PATH = "data.repair.navigation_frame_rates"
_LOSS_SCALE = 2.385
"""Of Cauchy's loss, 95 % efficient for Gaussian residuals (Holland and Welsch 1977)."""
_CLEARLY = 25.0
"""Difference of two costs beyond which one model is believed in place of the other: five sigma."""
_BIAS, _MOUNT, _TILT = np.arange(0, 3), np.arange(3, 6), np.arange(6, 8)
_SIZE = 8
_UNITS = np.repeat([1e-3, 1e-2, 1e-2], [3, 3, 2])
"""Usual sizes of a bias [rad/s], of what a mounting is off by and of a tilt [rad]."""
_FEWEST = 20


@dataclass(frozen=True)
class Fit:
    """Outcome of a model.

    Attributes
    ----------
    cost : float
    bias, mount : (3,)
        Bias of the rates [rad/s] and what the mounting is off by [rad]; zeros where it is not fitted.
    tilt : (2,)
        Roll and pitch at the first sample [rad]; zeros where they are not fitted.
    tilt_sigma : (2,)
        Their standard deviations [rad].
    """

    cost: float
    bias: Array
    mount: Array
    tilt: Array
    tilt_sigma: Array


def check_rate_axes(sequence: Sequence, steps: VisionSteps, repair: RepairConfig) -> Finding:
    """Whether the rates are about the body's axes or about level ones, by the turns that the camera sees.

    Parameters
    ----------
    sequence : Sequence
        Rates as recorded, clock and mounting as they are to be used.
    steps : VisionSteps
    repair : RepairConfig
        What is configured.
    """
    if len(steps.frame) < _FEWEST:
        text = f"only {len(steps.frame)} steps show the camera's turns"
        return Finding(_CHECK, "unclear", text, unknown={_PATH: f"{text}; as configured"})
    problem = _Problem(sequence, steps)
    body, turned, level = problem.fit(), problem.fit(mount=True), problem.fit(tilt=True)
    configured = repair.navigation_frame_rates is not None
    over_body, over_turned = body.cost - level.cost, turned.cost - level.cost
    counts = {"level_over_body": over_body, "level_over_turned": over_turned}
    turn = ", ".join(f"{1e3 * angle:.0f}" for angle in turned.mount)
    if over_body < _CLEARLY or over_turned < -_CLEARLY:
        text = "about the body's axes, as the camera sees them"
        if body.cost - turned.cost > _CLEARLY:
            text += f", but for a constant rotation by ({turn}) mrad"
        elif over_body > -_CLEARLY:
            text += f", or the tilt is too small to matter (twice the log likelihood ratio {over_body:.1f})"
        if configured and min(-over_body, -over_turned) > _CLEARLY:
            text = f"configured as rates about level axes, they are {text}"
            return Finding(_CHECK, "fault", text, counts=counts, proposal={_PATH: None})
        return Finding(_CHECK, "ok", text, counts=counts)
    tilt = tuple(
        Measured.around(name, "rad", float(value), sigma=float(sigma))
        for name, value, sigma in zip(("roll", "pitch"), level.tilt, level.tilt_sigma, strict=True)
    )
    found = f"about level axes, with {tilt[0]}, {tilt[1]} at the first sample"
    if over_turned < _CLEARLY:
        text = (
            f"either {found}, or about axes off by a constant ({turn}) mrad: the camera's turns speak for "
            f"these against the body's axes, twice the log likelihood ratio {over_body:.0f} and "
            f"{body.cost - turned.cost:.0f}, but for neither against the other; read as configured"
        )
        return Finding(_CHECK, "unclear", text, tilt, counts, unknown={_PATH: text})
    text = (
        f"{found}: the camera's turns speak for it against the body's axes and against axes off by a "
        f"constant ({turn}) mrad, twice the log likelihood ratio {over_body:.0f} and {over_turned:.0f}"
    )
    if configured:
        return Finding(_CHECK, "ok", text, tilt, counts)
    return Finding(_CHECK, "fault", text, tilt, counts, proposal={_PATH: _setting(level)})


def _setting(level: Fit) -> dict[str, object]:
    roll, pitch = (round(float(value), 4) for value in level.tilt)
    return {"roll": roll, "pitch": pitch, "bias": [round(float(value), 5) for value in level.bias]}


class _Problem:
    """The camera's turns and what the recorded rates make of them."""

    def __init__(self, sequence: Sequence, steps: VisionSteps) -> None:
        self._sequence, self._steps = sequence, steps
        self._sigma = steps.sigma[:, :3]
        point = np.zeros(_SIZE)
        point[: _TILT[0]] = self._solution(np.r_[_BIAS, _MOUNT]).x
        spread = 1.4826 * np.median(np.abs(self._residuals(point, level=False)), axis=0)
        self._sigma = self._sigma * np.maximum(1.0, spread)

    def fit(self, *, mount: bool = False, tilt: bool = False) -> Fit:
        """Fit a model by Cauchy's loss; the bias is always free."""
        free = np.r_[_BIAS, _MOUNT if mount else [], _TILT if tilt else []].astype(int)
        solution = self._solution(free)
        point, sigma = np.zeros(_SIZE), np.zeros(_SIZE)
        point[free] = solution.x
        sigma[free] = np.sqrt(np.diagonal(np.linalg.pinv(solution.jac.T @ solution.jac)))
        return Fit(2.0 * float(solution.cost), point[_BIAS], point[_MOUNT], point[_TILT], sigma[_TILT])

    def _solution(self, free: IntArray) -> OptimizeResult:
        def residuals(values: Array) -> Array:
            point = np.zeros(_SIZE)
            point[free] = values
            return self._residuals(point, level=_TILT[0] in free).ravel()

        scale = _UNITS[free]
        return least_squares(
            residuals, np.zeros(len(free)), loss="cauchy", f_scale=_LOSS_SCALE, x_scale=scale
        )

    def _residuals(self, point: Array, *, level: bool) -> Array:
        """Residuals ``(m, 3)`` of the turns, in standard deviations."""
        sequence = self._sequence
        rates = sequence.twist[:, :3] - point[_BIAS]
        if level:
            roll, pitch = point[_TILT]
            tilt = Tilt.integrated(rates, sequence.inertial_stamp, roll=roll, pitch=pitch)
            rates = tilt.in_body(rates)
        twist = np.column_stack([rates, sequence.twist[:, 3:]])
        means = replace(sequence, twist=twist).step_means()[0][self._steps.frame, :3]
        means = means + np.cross(means, point[_MOUNT])
        return np.asarray((self._steps.twist[:, :3] - means) / self._sigma)
