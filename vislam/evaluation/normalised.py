"""Errors next to what was claimed of them: NEES of poses, positions and biases, and coverage.

All errors are ``truth - estimate`` in the sense of the filters: for poses ``truth = estimate exp(error)``,
with the covariance on the right of the estimate. Moving the whole world of a run multiplies its poses on the
left and leaves these errors and covariances untouched, so that worlds may be joined at will.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vislam.base.distributions import chi2_below, chi2_quantile
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.reference import Reference
from vislam.core.run import Estimate, Run
from vislam.core.step import TWIST_BIAS
from vislam.core.trajectory import Poses
from vislam.evaluation import statistics
from vislam.evaluation.statistics import Statistic, Whiteness
from vislam.evaluation.weighted_alignment import align_weighted, without_motion
from vislam.geometry import se3, so3

PARTS = {"pose": slice(0, 6), "rotation": slice(0, 3), "position": slice(3, 6)}
"""Parts of a pose error (omega, v) that have a NEES of their own."""
COMPONENTS = ("roll", "pitch", "yaw", "forward", "left", "up")
"""Components of a pose error: turns about the axes of the body, and moves along them."""
PROBABILITIES = np.linspace(0.0, 1.0, 41)
"""Nominal probabilities of a coverage curve."""
MULTIPLES = (1.0, 2.0, 3.0)
"""Of the claimed standard deviation, within which errors are counted."""
_FLOOR = 1e-9
"""A claimed standard deviation below this [rad, m, rad/s, m/s] is no claim, but a zero with rounding."""
_SINGULAR = 1e-12
"""Smallest eigenvalue of a correlation matrix that is more than rounding."""
_ASYMMETRY = 1e-6
"""Largest difference of two correlations that should be the same; with more it is no covariance."""


@dataclass(frozen=True)
class Normalised:
    """Errors of a run and the same errors at unit covariance, if what was claimed of them is true.

    Attributes
    ----------
    name : str
        Of the statistic, for example ``nees_pose``.
    index : (n,)
        Frame, or track of a landmark, of each error.
    error, sigma : (n, d)
        Errors and their claimed standard deviations [rad, m].
    whitened : (n, d)
        ``L^-1 error`` where ``L L^T`` is the claimed covariance, both in axes that stay.
    convention : str
    fitted : bool
        Whether part of the error was fitted away.
    factor : (n, d, d) or None
        ``L``; None where it is not kept.
    """

    name: str
    index: IntArray
    error: Array
    sigma: Array
    whitened: Array
    convention: str
    fitted: bool = False
    factor: Array | None = None

    @property
    def nees(self) -> Array:
        """Normalised squared errors ``(n,)``."""
        return np.asarray(np.sum(self.whitened**2, axis=1))

    def statistic(self) -> Statistic:
        """Average over all."""
        return statistics.of_errors(self.name, self.whitened, convention=self.convention, fitted=self.fitted)

    def scale_gap(self) -> float:
        """Ratio of errors to estimated sigmas, an axis: root of the median NEES over its expected value.

        Medians, so that some bad frames do not count; 1 is expected.
        """
        return float(np.sqrt(np.median(self.nees) / chi2_quantile(0.5, self.whitened.shape[1])))

    def coverage_curve(self, probabilities: Array = PROBABILITIES) -> Array:
        """Share of the NEES within the chi-square quantile of each probability ``(p,)``; equal if sound."""
        within = chi2_below(np.sort(self.nees), self.whitened.shape[1])
        return np.asarray(np.searchsorted(within, probabilities, side="right") / len(within))

    def within(self, multiples: Sequence[float] = MULTIPLES) -> Array:
        """Share ``(m, d)`` of each component within multiples of its claimed standard deviation."""
        apart = np.abs(self.error)
        return np.array([np.mean(apart <= multiple * self.sigma, axis=0) for multiple in multiples])


def pose_errors(
    run: Run, reference: Reference, *, estimate: Estimate | None = None
) -> dict[str, Normalised] | None:
    """Errors of pose, rotation and position, by part; None where either lacks what it takes.

    Parameters
    ----------
    run : Run
    reference : Reference
        With full poses, of any point. Its world is moved so that its first pose is the run's at that frame:
        the errors are those of the motion since then. The covariances are as claimed, with what the run
        was uncertain of at that frame. For a run that measured gravity it is turned about the vertical and
        moved only, so that roll and pitch count; its own z axis is then taken to point up.
    estimate : "filtered" or "smoothed", optional
        Whose poses and covariances; the final one by default.
    """
    frame, own, other = np.intersect1d(run.frame, reference.frame, return_indices=True)
    if reference.pose is None or len(frame) < 2:
        return None
    pose, cov = _at_point(run.poses(estimate), own, reference.imu_T_point)
    parts = PARTS
    if np.isnan(cov[:, :3, :3]).all() and not np.isnan(cov[:, 3:, 3:]).all():
        # Others may give covariances of positions alone.
        parts, cov = {"position": PARTS["position"]}, _with_unit_rotation(cov)
    target = reference.pose[other]
    joined = joint_by_yaw(pose[0], target[0]) if run.upright else pose[0] @ se3.inverse(target[0])
    error = se3.local(pose, joined @ target)
    cov = cov + _of_reference(target, reference)
    level = np.zeros((len(pose), 6, 6))
    level[:, :3, :3] = level[:, 3:, 3:] = pose[:, :3, :3]
    staying, staying_cov = (level @ error[:, :, None])[:, :, 0], level @ cov @ level.transpose(0, 2, 1)
    # What is hardly positive definite may be so no longer in other axes.
    known = usable(cov) & usable(staying_cov)
    # The first error is zero by construction, of an upright run that of heading and position.
    known[0] = False
    if not known.any():
        return None
    error, cov, staying, staying_cov = (part[known] for part in (error, cov, staying, staying_cov))
    convention = (
        f"error = log(estimate^-1 {reference.name}), axes of the body at the reference's point; "
        f"worlds joined at frame {frame[0]}{' by heading and position' if run.upright else ''}; estimated "
        "covariance, right perturbation"
    )
    if reference.sigma or reference.sigma_rotation:
        degrees = np.rad2deg(reference.sigma_rotation)
        convention += f", and of the reference's own {reference.sigma:g} m and {degrees:g} deg"
    return {
        part: Normalised(
            f"nees_{part}",
            frame[known],
            error[:, columns],
            _sigma(cov)[:, columns],
            whiten(staying[:, columns], staying_cov[:, columns, columns]),
            convention,
            factor=np.asarray(np.linalg.cholesky(staying_cov[:, columns, columns]), float),
        )
        for part, columns in parts.items()
    }


def joint_by_yaw(pose: Array, target: Array) -> Array:
    """Turn about z and move ``(4, 4)`` that take a target pose ``(4, 4)`` nearest to another.

    The places become the same; of all turns about z it is the one that leaves the smallest angle.
    """
    between = pose[:3, :3] @ target[:3, :3].T
    heading = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    turn = so3.exp(np.array([0.0, 0.0, heading]))
    return se3.from_rotation_translation(turn, pose[:3, 3] - turn @ target[:3, 3])


def position_errors(
    run: Run,
    reference: Reference,
    *,
    planar: bool,
    reference_sigma: float,
    estimate: Estimate | None = None,
    shared: Array | None = None,
) -> Normalised | None:
    """Errors of the position where the reference has no attitude; None where the run gives no covariance.

    Nobody knows how the worlds lie to each other. The reference is moved to where the NEES is least, so that
    it is not above that of the true motion: values below 1 say nothing, values above 1 accuse. The alignment
    of the least distance would not do: it spreads late errors over the first frames, of which a run is sure.

    Parameters
    ----------
    run : Run
        Levelled, if it is compared in the plane.
    reference : Reference
        Of positions, of any point.
    planar : bool
        Whether to leave the height out.
    reference_sigma : float
        Standard deviation of the reference's own positions [m]; 0 for a truth. The first poses of a run are
        more certain than any survey.
    estimate : "filtered" or "smoothed", optional
        Whose poses and covariances; the final one by default.
    shared : (c, T, 6), optional
        Changes of all poses of the run by one standard deviation of each of some errors that are not in its
        covariances, in the tangent of the pose, on its right [rad, m].
    """
    size = 2 if planar else 3
    frame, own, other = np.intersect1d(run.frame, reference.frame, return_indices=True)
    pose, cov = _at_point(run.poses(estimate), own, reference.imu_T_point)
    turn = pose[:, :3, :3]
    cov_world = (turn @ cov[:, 3:, 3:] @ turn.transpose(0, 2, 1))[:, :size, :size]
    cov_world = cov_world + reference_sigma**2 * np.eye(size)
    changes = _at_places(shared, own, turn, reference.imu_T_point, size)
    total = cov_world + np.einsum("cni,cnj->nij", changes, changes)
    known = usable(total)
    if known.sum() < 3:
        return None
    place, total = pose[known, :size, 3], total[known]
    error = align_weighted(reference.position[other][known, :size], place, total) - place
    changes = without_motion(changes[:, known], place, total)
    cov_world = cov_world[known] + np.einsum("cni,cnj->nij", changes, changes)
    return Normalised(
        "nees_position_" + ("planar" if planar else "aligned"),
        frame[known],
        error,
        _sigma(cov_world),
        whiten(error, cov_world),
        f"error = {reference.name} - position, axes of the run's world; worlds joined by the rigid motion of "
        "least NEES, which takes part of the error out, so that only values above 1 accuse; estimated "
        f"covariance, and {reference_sigma:g} m of the reference's own",
        fitted=True,
        factor=np.asarray(np.linalg.cholesky(cov_world), float),
    )


def bias_errors(run: Run, truth: Array) -> Normalised | None:
    """Errors of the twist bias; None where the run has no standard deviation of it.

    Parameters
    ----------
    run : Run
    truth : (6,) or (T, 6)
        True bias [rad/s, m/s], of at least the frames of the run.
    """
    bias = run.states.get(TWIST_BIAS)
    if bias is None or bias.value.shape[1] != truth.shape[-1]:
        return None
    given = np.isfinite(bias.value) & np.isfinite(bias.sigma)
    known = np.all(given & (bias.sigma > _FLOOR), axis=1)
    if not known.any():
        return None
    true = truth if truth.ndim == 1 else truth[: len(bias.value)]
    error, sigma = (true - bias.value)[known], bias.sigma[known]
    return Normalised(
        "nees_bias",
        np.flatnonzero(known),
        error,
        sigma,
        error / sigma,
        "error = truth - bias at each time, axes of the sensor; standard deviations as claimed, taken for "
        "uncorrelated, since a run gives no more",
    )


def nis_statistic(run: Run) -> Statistic | None:
    """Average NIS of a run per degree of freedom; None where it gives none."""
    nis, dof = run.innovations.nis, run.innovations.dof
    found = dof > 0
    if not found.any():
        return None
    return statistics.of_squares(
        "nis",
        nis[found],
        dof[found].astype(float),
        convention="innovation squared in its claimed covariance, of the observations fused at each frame",
    )


def nis_whiteness(run: Run) -> Whiteness | None:
    """Whether the NIS of a run is white; None where it gives too few."""
    found = run.innovations.dof > 0
    return statistics.whiteness(run.innovations.nis[found], run.innovations.dof[found].astype(float))


def _with_unit_rotation(cov: Array) -> Array:
    """Covariances whose rotation, which is not given, is of unit variance and on its own."""
    whole = np.zeros(cov.shape)
    whole[:, :3, :3], whole[:, 3:, 3:] = np.eye(3), cov[:, 3:, 3:]
    return whole


def _of_reference(target: Array, reference: Reference) -> Array:
    """Covariances ``(n, 6, 6)`` that the reference's own uncertainty adds to the errors of joined worlds.

    With the reference ``target exp(n)`` and the worlds joined at the first pose, the error of pose k is
    ``e_k + n_k - Ad(rel^-1) n_0`` to first order, where ``rel`` is the motion from the first pose to it: what
    the first pose of the reference is off by, its turn above all, is carried along.
    """
    own = np.diag(np.repeat([reference.sigma_rotation**2, reference.sigma**2], 3))
    if not own.any():
        return np.zeros((len(target), 6, 6))
    carried = se3.adjoint(se3.inverse(target) @ target[0])
    return np.asarray(own + carried @ own @ carried.transpose(0, 2, 1))


def usable(cov: Array) -> BoolArray:
    """Which covariances ``(n, d, d)`` are given, symmetric, and more than zero and rounding."""
    size = cov.shape[-1]
    diagonal = np.diagonal(cov, axis1=-2, axis2=-1)
    given = np.isfinite(cov).all(axis=(1, 2)) & (diagonal > _FLOOR**2).all(axis=1)
    known: BoolArray = np.asarray(given, np.bool_)
    safe = np.where(known[:, None, None], cov, np.eye(size))
    sigma = _sigma(safe)
    correlation = safe / (sigma[:, :, None] * sigma[:, None, :])
    symmetric = np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2)) < _ASYMMETRY
    return np.asarray(known & symmetric & _definite(correlation), np.bool_)


def _definite(correlation: Array) -> BoolArray:
    """Which correlations ``(n, d, d)`` are positive definite: by one factorisation, if all of them are."""
    try:
        np.linalg.cholesky(correlation - _SINGULAR * np.eye(correlation.shape[-1]))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(correlation)[:, 0] > _SINGULAR, np.bool_)
    return np.ones(len(correlation), np.bool_)


def whiten(error: Array, cov: Array) -> Array:
    """Errors ``(n, d)`` at unit covariance, by the Cholesky factors of covariances ``(n, d, d)``."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(cov), error[:, :, None])[:, :, 0])


def _at_point(poses: Poses, row: IntArray, imu_T_point: Array) -> tuple[Array, Array]:
    """Poses of a point of the body, and their covariances on the right."""
    if np.array_equal(imu_T_point, np.eye(4)):
        return poses.world_T_imu[row], poses.covariances[row]
    move = se3.adjoint(se3.inverse(imu_T_point))
    return poses.world_T_imu[row] @ imu_T_point, move @ poses.covariances[row] @ move.T


def _at_places(shared: Array | None, row: IntArray, turn: Array, imu_T_point: Array, size: int) -> Array:
    """Changes of the positions of a point of the body ``(c, n, size)``, in the axes of the world."""
    if shared is None:
        return np.zeros((0, len(row), size))
    at_point = shared[:, row] @ se3.adjoint(se3.inverse(imu_T_point)).T
    return np.asarray(np.einsum("nij,cnj->cni", turn, at_point[:, :, 3:])[:, :, :size])


def _sigma(cov: Array) -> Array:
    return np.asarray(np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1)))
