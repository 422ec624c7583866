"""In which convention the covariances of others are: as given, or by which makes the errors most probable.

Every convention of :mod:`vislam.geometry.pose_covariance` gives another density for the same errors, and all
maps between them have determinant 1. So the mean log-density of the errors at hand can be compared
between them: it is a proper score (Gneiting and Raftery, JASA 2007, section 4.1), highest in expectation for
the right one. Where the two best are closer than the noise of that mean, nothing is told apart.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from vislam.base.types import Array
from vislam.evaluation.normalised import usable, whiten
from vislam.evaluation.statistics import effective_errors
from vislam.geometry import se3
from vislam.geometry.pose_covariance import FRAMES, ORDERS, CovarianceConvention, to_right

_USUAL = CovarianceConvention("position_first", "right")
"""Taken where nothing is said and nothing can be told apart: that of smfeval's bare files."""
_SURE = 2.0
"""Standard errors by which the best convention must lead the next."""
_FEWEST = 10
_CAP = 50.0
"""Largest squared error per component that enters the comparison, so that no single pose decides it."""


@dataclass(frozen=True)
class Covariances:
    """Covariances of a trajectory file.

    Attributes
    ----------
    raw : (n, 6, 6)
        As the file has them; NaN where it has none, or none of the rotation.
    file_pose : (n, 4, 4)
        The poses that they stand beside in the file.
    body_pose : (n, 4, 4)
        The same poses as they are scored.
    inverted : bool
        Whether these are the inverse.
    moved : (4, 4)
        Where the body that is scored sits on that of the file.
    convention : CovarianceConvention or None
        As format or options say; None: it is to be found.
    """

    raw: Array
    file_pose: Array
    body_pose: Array
    inverted: bool
    moved: Array
    convention: CovarianceConvention | None

    @property
    def position_only(self) -> bool:
        """Whether it has covariances of positions alone."""
        return bool(np.isnan(self.raw[:, :3, :3]).all() and not np.isnan(self.raw[:, 3:, 3:]).all())

    def ours(self, convention: CovarianceConvention, scale: float = 1.0) -> Array:
        """Covariances ``(n, 6, 6)`` as (omega, v) on the right of the poses that are scored."""
        if self.position_only:
            back = self.body_pose[:, :3, :3].transpose(0, 2, 1)
            cov = np.full(self.raw.shape, np.nan)
            cov[:, 3:, 3:] = scale**2 * back @ self.raw[:, 3:, 3:] @ back.transpose(0, 2, 1)
            return cov
        cov = to_right(self.file_pose, self.raw, convention)
        if self.inverted:
            # (T exp(xi))^-1 = exp(-xi) T^-1 = T^-1 exp(-Ad(T) xi)
            turn = se3.adjoint(self.file_pose)
            cov = turn @ cov @ turn.transpose(0, 2, 1)
        move = se3.adjoint(se3.inverse(self.moved))
        cov = move @ cov @ move.T
        if scale != 1.0:
            factor = np.repeat([1.0, scale], 3)
            cov = cov * factor[:, None] * factor
        return np.asarray(cov)

    def chosen(
        self, matched: Array, stamp: Array, target: Array | None, *, scale: float
    ) -> tuple[Array, list[str]]:
        """Covariances in the convention that is given, or that fits best, and what is to be said of it.

        Parameters
        ----------
        matched : (m,)
            Stamps of the rows that have a reference [s].
        stamp : (n,)
            Of all rows [s].
        target : (m, 4, 4) or None
            Poses of the reference at the former.
        scale : float
            By which the positions were multiplied.
        """
        if self.position_only:
            return self.ours(_USUAL, scale), ["covariances of the positions alone, axes of the world"]
        scores = self._scores(matched, stamp, target, scale)
        given = self.convention
        if not scores:
            used = given or _USUAL
            return self.ours(used, scale), [f"covariances read as {used}; nothing to tell the convention by"]
        ranked = sorted(scores, key=lambda one: -float(np.mean(scores[one])))
        best = ranked[0]
        if given is None:
            lead, noise = _lead(scores[best], scores[_USUAL])
            sure = best == _USUAL or lead > _SURE * noise
            used = best if sure else _USUAL
            return self.ours(used, scale), [_found(used, ranked, scores, sure=sure)]
        lead, noise = _lead(scores[best], scores[given])
        told = [f"covariances read as {given}"]
        if best != given and lead > _SURE * noise and lead > 1.0:
            told.append(
                f"read as {best} they would fit better, by {lead:.1f} nats a pose: "
                f"cov_order={best.order} cov_frame={best.frame}"
            )
        return self.ours(given, scale), told

    def _scores(
        self, matched: Array, stamp: Array, target: Array | None, scale: float
    ) -> dict[CovarianceConvention, Array]:
        """Log-density of the errors under each convention, up to a constant."""
        row = np.flatnonzero(np.isin(stamp, matched))
        if target is None or len(row) < _FEWEST or len(row) != len(target):
            return {}
        pose = self.body_pose[row].copy()
        pose[:, :3, 3] *= scale
        error = se3.local(pose, pose[0] @ se3.inverse(target[0]) @ target)[1:]
        found = {}
        for order, frame in product(ORDERS, FRAMES):
            convention = CovarianceConvention(order, frame)
            cov = self.ours(convention, scale)[row[1:]]
            known = usable(cov)
            if known.all():
                square = np.sum(whiten(error, cov) ** 2, axis=1)
                determinant = np.linalg.slogdet(cov)[1]
                found[convention] = -0.5 * (np.minimum(square, 6 * _CAP) + determinant)
        return found if len(found) == len(ORDERS) * len(FRAMES) else {}


def _lead(one: Array, other: Array) -> tuple[float, float]:
    """Mean by which one score leads another, and its standard error."""
    apart = one - other
    spread = float(np.std(apart))
    if spread == 0.0:
        return float(np.mean(apart)), 0.0
    count = effective_errors(((apart - apart.mean()) / spread)[:, None])
    return float(np.mean(apart)), spread / float(np.sqrt(count))


def _found(
    used: CovarianceConvention,
    ranked: list[CovarianceConvention],
    scores: dict[CovarianceConvention, Array],
    *,
    sure: bool,
) -> str:
    best = ", ".join(f"{one} {np.mean(scores[one]):.1f}" for one in ranked[:3])
    why = "fits best" if sure else "is usual; the data do not tell them apart"
    return f"covariances read as {used}, which {why} (mean log-density of the errors: {best})"
