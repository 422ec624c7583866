"""Agreement of two runs within their estimated covariances, without a reference.

Let both be consistent, with errors ``e_a`` and ``e_b`` of covariances ``P_a`` and ``P_b``. Their difference
has ``P_a + P_b - C - C^T``, where ``C`` is the unknown covariance between the errors. What holds of it:

- Whatever ``C``, it is at most ``2 (P_a + P_b)``, and along any direction at most ``(sigma_a + sigma_b)^2``.
- If the two err alike, ``C + C^T >= 0``, it is at most ``P_a + P_b``. Sharing the data, they do as a rule.
- If b is optimal for all that a has seen, as a smoother is next to the filter of the same model, ``C = P_b``
  and it is ``P_a - P_b``.

One scale serves all pairs here: ``P_a + P_b``. It is generous in the second case and more so in the third,
for which :mod:`vislam.evaluation.smoothing` has the sharp test. A distance beyond its chi-square bound says
that at least one run claims too much. One within it says nothing of the truth: both may err alike.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.distributions import chi2_quantile, chi2_upper_quantile
from vislam.base.types import Array, IntArray
from vislam.core.run import Estimate, Run
from vislam.evaluation.normalised import COMPONENTS, usable, whiten
from vislam.geometry import se3

_STAYS = 10
"""Frames over which runs that have parted must stay so for the most part."""


@dataclass(frozen=True)
class Certainty:
    """Ratio of the estimated variances of two runs' poses, in the median over frames.

    Attributes
    ----------
    overall : float
        Variance that the first claims over that of the second: geometric mean over all directions.
    smallest, largest : float
        The same along the directions in which it is smallest and largest.
    smallest_along, largest_along : str
        Components closest to these directions in most frames, of ``COMPONENTS``.
    """

    overall: float
    smallest: float
    largest: float
    smallest_along: str
    largest_along: str


@dataclass(frozen=True)
class Agreement:
    """Two runs pose by pose, their worlds joined at the first.

    Attributes
    ----------
    estimates : two of "filtered" and "smoothed"
        Estimate of each run that was compared.
    frame : (n,)
        Frames of which both give a covariance.
    difference : (n, 6)
        ``log(a^-1 b)`` (omega, v), in the axes of the body of the first run [rad, m].
    squared : (n,)
        Squared Mahalanobis distance with ``P_a + P_b``.
    ratios : (n, 6)
        Generalised eigenvalues of ``(P_a, P_b)``, ascending: variance claimed by the first over that claimed
        by the second along the directions in which the two covariances are diagonal at once.
    along : (n, 6)
        Component, index in ``COMPONENTS``, closest to each of these directions.
    """

    estimates: tuple[Estimate, Estimate]
    frame: IntArray
    difference: Array
    squared: Array
    ratios: Array
    along: IntArray

    @property
    def per_freedom(self) -> float:
        """Mean squared distance per degree of freedom.

        Two consistent runs are expected to have 1 at most if they err alike, and 2 at most in any case.
        """
        return float(self.squared.mean()) / 6.0

    def share_beyond(self, probability: float = 0.95) -> float:
        """Share of the frames at which the distance is beyond the chi-square quantile of a probability."""
        return float(np.mean(self.squared > chi2_quantile(probability, 6)))

    def divergence(self, alarm: float = 0.01) -> int | None:
        """First frame from which the estimates diverge, for good; None if they never do.

        The squared distance exceeds the bound that consistent runs exceed at any frame at all with
        probability ``alarm`` at most, by Bonferroni's inequality. That it does so in most of the next few
        frames too leaves out a single bad pose, from which both went on together.
        """
        beyond = self.squared > chi2_upper_quantile(alarm / len(self.squared), 6)
        counted = np.concatenate([[0], np.cumsum(beyond)])
        start = np.arange(len(beyond))
        stop = np.minimum(start + _STAYS, len(beyond))
        stays = beyond & (2 * (counted[stop] - counted[start]) > stop - start)
        return int(self.frame[np.argmax(stays)]) if stays.any() else None

    def certainty(self) -> Certainty:
        """Summarise the ratio of the estimated variances."""
        smallest, largest = np.median(self.ratios[:, [0, -1]], axis=0)
        overall = np.exp(np.median(np.mean(np.log(self.ratios), axis=1)))
        along = [COMPONENTS[np.bincount(self.along[:, k]).argmax()] for k in (0, -1)]
        return Certainty(float(overall), float(smallest), float(largest), along[0], along[1])


def shared_estimates(one: Run, other: Run) -> tuple[Estimate, ...]:
    """Estimates of the trajectory that both runs have: only these are compared as equals."""
    return tuple(estimate for estimate in one.estimates if estimate in other.estimates)


def agreement(
    one: Run,
    other: Run,
    *,
    estimates: tuple[Estimate, Estimate] | None = None,
    considered: bool = False,
) -> Agreement | None:
    """Compare two runs pose by pose; None if there is no frame of which both give a covariance.

    The first frame is left out: its difference is zero by construction. So are frames in which the runs are
    so far apart that nothing is left of a covariance where the other run is.

    Parameters
    ----------
    one, other : Run
        Compared on the frames that both have.
    estimates : two of "filtered" and "smoothed", optional
        Estimate of each; by default the same of both, the last that they share.
    considered : bool
        Whether the errors that both share are added: with changes ``s_a`` and ``s_b`` by the same cause, the
        difference has ``P_a + P_b + sum (s_a - s_b)(s_a - s_b)^T``, and what acts on both alike cancels. None
        if they have not considered the same.
    """
    if considered and not _same_causes(one, other):
        return None
    if estimates is None:
        shared = shared_estimates(one, other)[-1]
        estimates = (shared, shared)
    frame, own, others = np.intersect1d(one.frame, other.frame, return_indices=True)
    chosen = [run.poses(estimate) for run, estimate in zip((one, other), estimates, strict=True)]
    first, first_cov = chosen[0].world_T_imu[own], chosen[0].covariances[own]
    second, second_cov = chosen[1].world_T_imu[others], chosen[1].covariances[others]
    if len(frame) < 2:
        return None
    known = usable(first_cov) & usable(second_cov)
    known[0] = False
    second = first[0] @ se3.inverse(second[0]) @ second
    difference = se3.local(first[known], second[known])
    here = transported(second_cov[known], difference)
    kept = usable(here)
    known[known] = kept
    if not known.any():
        return None
    difference, here = difference[kept], here[kept]
    first_cov = first_cov[known]
    total = first_cov + here
    if considered:
        by_cause = [
            _changes(run, estimate)[:, rows[known]]
            for run, estimate, rows in zip((one, other), estimates, (own, others), strict=True)
        ]
        jacobian = np.linalg.inv(se3.right_jacobian(difference))
        by_cause[1] = (jacobian @ by_cause[1][..., None])[..., 0]
        total = total + _summed(by_cause[0] - by_cause[1])
        first_cov, here = first_cov + _summed(by_cause[0]), here + _summed(by_cause[1])
    ratios, along = compared(first_cov, here)
    return Agreement(
        estimates,
        frame[known],
        difference,
        np.sum(whiten(difference, total) ** 2, axis=1),
        ratios,
        along,
    )


def _same_causes(one: Run, other: Run) -> bool:
    """Whether two runs have considered the same errors."""
    if one.considered is None or other.considered is None:
        return False
    return one.considered.cause == other.considered.cause


def _changes(run: Run, estimate: Estimate) -> Array:
    """Changes ``(c, T, 6)`` of the poses of an estimate of a run that has considered some errors."""
    assert run.considered is not None
    return run.considered.of(smoothed=estimate == "smoothed")


def _summed(change: Array) -> Array:
    """Covariances ``(n, 6, 6)`` of changes ``(c, n, 6)``."""
    return np.asarray(np.einsum("cti,ctj->tij", change, change))


def transported(cov: Array, difference: Array) -> Array:
    """Covariances on the right of poses ``b``, as covariances of ``log(a^-1 truth)``.

    With ``d = log(a^-1 b)`` and ``truth = b exp(e_b)`` the error of ``a`` is ``d + J^-1 e_b`` to first order
    in ``e_b``, J the right Jacobian at ``d``: Barfoot, *State Estimation for Robotics* (2017), section 7.1.5.

    Parameters
    ----------
    cov : (n, 6, 6)
    difference : (n, 6)
        ``d``.
    """
    jacobian = np.linalg.inv(se3.right_jacobian(difference))
    return np.asarray(jacobian @ cov @ jacobian.transpose(0, 2, 1))


def compared(first: Array, second: Array) -> tuple[Array, IntArray]:
    """Generalised eigenvalues of pairs of covariances, and the components that go with them.

    ``first v = lambda second v``: the error ``v^T e`` has ``lambda`` times the variance in the first. It goes
    with the component with which it is most correlated, by the second; that has no units.

    Parameters
    ----------
    first, second : (n, d, d)

    Returns
    -------
    ratios, along : (n, d)
        Eigenvalues, ascending, and index of the component of each.
    """
    factor = np.linalg.cholesky(second)
    half = np.linalg.solve(factor, first)
    ratios, vectors = np.linalg.eigh(np.linalg.solve(factor, half.transpose(0, 2, 1)))
    sigma = np.sqrt(np.diagonal(second, axis1=1, axis2=2))
    along = np.abs(factor @ vectors / sigma[:, :, None]).argmax(axis=1)
    # None is below zero but by rounding, where the first claims next to nothing of what the second does.
    return np.maximum(ratios, np.finfo(float).eps), along
