"""Filtered poses against smoothed ones: by how much smoothing moved them, and by how much it may have.

On equal information, let ``f`` be the estimate from the data up to a frame and ``s`` that from all data. An
optimal ``s`` has an error that is uncorrelated with whatever can be computed from the data, ``f - s``
included. So the error of ``f`` is that of ``s`` plus an uncorrelated one of covariance ``P_f - P_s``, and
this is the covariance of their difference (Hausman, *Specification tests in econometrics*, Econometrica 1978,
lemma 2.1). It needs no reference, and is far sharper than ``P_f + P_s``, under which sigmas that are several
times too small pass: of a filter and a smoother the difference itself is of the size of ``P_f``.

``P_f - P_s`` is positive semi-definite if both are of the same problem and linearised alike: a filter cannot
be more certain than the smoother that has its data and more, unless it is overconfident. A frame at which it
is not, by more than ``TOLERANCE`` of ``P_f`` along some direction, is left out and counted. Directions along
which smoothing gains less than that are not tested: nothing but the difference of two roundings would be.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.run import Run
from vislam.evaluation import statistics
from vislam.evaluation.agreement import transported
from vislam.evaluation.normalised import usable
from vislam.evaluation.statistics import Statistic
from vislam.geometry import se3

TOLERANCE = 0.02
"""Share of the filtered variance along a direction: less of it gained is not tested, and as much lost is no
rounding."""
NAME = "smoothing"
"""Name of the statistic."""
_CONVENTION = (
    "log(filtered^-1 smoothed) in P_filtered - P_smoothed, along directions in which smoothing gains more "
    f"than {100.0 * TOLERANCE:g} % of the variance; worlds joined at the first filtered pose"
)


@dataclass(frozen=True)
class SmoothingDifference:
    """Filtered poses of a run against smoothed ones of the same, or of another on equal information.

    Attributes
    ----------
    frame : (n,)
        Frames at which ``P_f - P_s`` is positive semi-definite and gains something along some direction.
    whitened : (n, 6)
        Differences at unit covariance, in axes of the world; what is not tested of them is left out.
    freedom : (n,)
        Directions that are tested.
    indefinite : int
        Frames at which ``P_f - P_s`` is not positive semi-definite, to the tolerance.
    untested : int
        Frames at which smoothing gains too little along all directions, as at the last.
    """

    frame: IntArray
    whitened: Array
    freedom: IntArray
    indefinite: int
    untested: int

    def statistic(self) -> Statistic | None:
        """Average of the squared differences per degree of freedom, 1 if consistent; None without a frame."""
        if not len(self.frame):
            return None
        return Statistic(
            name=NAME,
            value=float(np.sum(self.whitened**2) / self.freedom.sum()),
            freedom=float(self.freedom.mean()),
            samples=len(self.frame),
            effective=statistics.effective_errors(self.whitened),
            convention=_CONVENTION,
        )


def smoothing_difference(filtered: Run, smoothed: Run) -> SmoothingDifference | None:
    """Compare filtered with smoothed poses; None if there is no frame of which both have a covariance.

    Parameters
    ----------
    filtered, smoothed : Run
        On equal information, be it the same run; the second has smoothed poses. Both have the same prior of
        the first pose, so their worlds are joined there, and the first frame tells nothing.
    """
    frame, own, others = np.intersect1d(filtered.frame, smoothed.frame, return_indices=True)
    if len(frame) < 2:
        return None
    before, after = filtered.filtered, smoothed.poses("smoothed")
    start = before.world_T_imu[own[0]] @ se3.inverse(smoothed.filtered.world_T_imu[others[0]])
    pose, cov, after_cov = (
        before.world_T_imu[own],
        before.covariances[own],
        after.covariances[others],
    )
    known = usable(cov) & usable(after_cov)
    known[0] = False
    if not known.any():
        return None
    pose, cov, frame = pose[known], cov[known], frame[known]
    difference = se3.local(pose, (start @ after.world_T_imu[others])[known])
    gain = cov - transported(after_cov[known], difference)
    return _compared(frame, difference, cov, gain, turn=pose[:, :3, :3])


def _compared(
    frame: IntArray, difference: Array, cov: Array, gain: Array, *, turn: Array
) -> SmoothingDifference:
    """Whiten differences ``(n, 6)`` by ``gain``, in axes turned by ``turn`` ``(n, 3, 3)``."""
    level = np.zeros_like(cov)
    level[:, :3, :3] = level[:, 3:, 3:] = turn
    back = level.transpose(0, 2, 1)
    factor = np.linalg.cholesky(level @ cov @ back)
    half = np.linalg.solve(factor, level @ gain @ back)
    share, vectors = np.linalg.eigh(np.linalg.solve(factor, half.transpose(0, 2, 1)))
    tested = share > TOLERANCE
    scale = np.where(tested, 1.0 / np.sqrt(np.where(tested, share, 1.0)), 0.0)
    along = vectors.transpose(0, 2, 1) @ np.linalg.solve(factor, level @ difference[:, :, None])
    whitened = (vectors @ (scale[:, :, None] * along))[:, :, 0]
    definite = share[:, 0] >= -TOLERANCE
    kept = definite & tested.any(axis=1)
    return SmoothingDifference(
        frame[kept],
        whitened[kept],
        tested.sum(axis=1)[kept],
        int(np.count_nonzero(~definite)),
        int(np.count_nonzero(definite & ~tested.any(axis=1))),
    )
