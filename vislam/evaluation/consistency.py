"""Whether a run's covariances tell how far off its poses are: NEES, its average over runs, 3-sigma coverage.

The error of a pose is that of the filters, on the right: ``truth = estimate exp(error)``. For an estimator
that is linear and right about its noise, ``error^T cov^-1 error`` (the normalised estimation error squared,
NEES) is chi-square distributed. Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and
Navigation* (2001), section 5.4.2.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, t

from vislam.base.types import Array
from vislam.core.run import Run
from vislam.geometry import se3

PARTS = {"pose": slice(0, 6), "rotation": slice(0, 3), "position": slice(3, 6)}
"""Parts of a pose error (omega, v) that have a NEES of their own."""
COMPONENTS = ("roll", "pitch", "yaw", "forward", "left", "up")
"""Components of a pose error: turns about the axes of the body, and moves along them."""


@dataclass(frozen=True)
class Consistency:
    """Errors of the poses of a run, and what the run claimed of them.

    Attributes
    ----------
    error, sigma : (T, 6)
        Errors (omega, v) on the right and their claimed standard deviations [rad, m].
    nees : dict of str to (T,)
        Normalised squared error of each of ``PARTS``.
    """

    error: Array
    sigma: Array
    nees: dict[str, Array]


@dataclass(frozen=True)
class Average:
    """A NEES per degree of freedom averaged over runs; 1 is expected.

    Attributes
    ----------
    value : (T,)
        At each time.
    low, high : float
        Interval in which a consistent estimator's is, at one time, with the stated probability.
    overall : float
        Mean over all times.
    overall_low, overall_high : float
        Confidence interval of that mean by Student's distribution of the runs' own means: runs are
        independent of each other, the times of a run are not.
    """

    value: Array
    low: float
    high: float
    overall: float
    overall_low: float
    overall_high: float

    @property
    def share_inside(self) -> float:
        """Share of the times at which the average is inside its interval."""
        return float(np.mean((self.value >= self.low) & (self.value <= self.high)))


def consistency(run: Run, truth: Array, *, causal: bool = False) -> Consistency:
    """Compare the poses of a run, as known in the end or at their own time, with the true ones.

    Parameters
    ----------
    run : Run
        With covariances.
    truth : (T, 4, 4)
        True poses of the body in the run's world.
    causal : bool
        Whether to take the poses as they were known at their own time.
    """
    poses, cov = (run.world_T_imu_causal, run.pose_cov_causal) if causal else (run.world_T_imu, run.pose_cov)
    error = se3.local(poses, truth[: len(poses)])
    return Consistency(
        error=error,
        sigma=np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1)),
        nees={name: nees(error[:, part], cov[:, part, part]) for name, part in PARTS.items()},
    )


def nees(error: Array, cov: Array) -> Array:
    """Normalised squared errors ``(...)`` of errors ``(..., d)`` and covariances ``(..., d, d)``."""
    return np.asarray(np.einsum("...i,...i->...", error, np.linalg.solve(cov, error[..., None])[..., 0]))


def average_interval(*, freedom: int, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided interval of a consistent estimator's average NEES per degree of freedom."""
    tail = 0.5 * (1.0 - probability)
    total = runs * freedom
    return float(chi2.ppf(tail, total)) / total, float(chi2.ppf(1.0 - tail, total)) / total


def average(values: Array, *, freedom: int, probability: float = 0.95) -> Average:
    """Average NEES over independent runs, per degree of freedom.

    Parameters
    ----------
    values : (runs, T)
        NEES of at least two runs.
    freedom : int
        Degrees of freedom of each.
    probability : float
        Of both intervals.
    """
    runs = len(values)
    low, high = average_interval(freedom=freedom, runs=runs, probability=probability)
    each = values.mean(axis=1) / freedom
    half = float(t.ppf(0.5 * (1.0 + probability), runs - 1) * each.std(ddof=1) / np.sqrt(runs))
    overall = float(each.mean())
    return Average(values.mean(axis=0) / freedom, low, high, overall, overall - half, overall + half)


def coverage(error: Array, sigma: Array, *, multiple: float = 3.0) -> Array:
    """Share ``(d,)`` of errors ``(..., d)`` within a multiple of their standard deviations ``(..., d)``."""
    inside = np.abs(error) <= multiple * sigma
    return np.asarray(inside.reshape(-1, error.shape[-1]).mean(axis=0))
