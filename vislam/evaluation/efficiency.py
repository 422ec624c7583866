"""Efficiency of an estimate: its errors over the bound (:mod:`vislam.evaluation.bound`).

The squared error of one drive is a matter of luck: of the drift of its heading there is one draw. What the
linear estimator that attains the bound errs by on the same noise has the same luck, and its expected square
is the bound itself. So the excess of an estimate's squared error over that one's, in parts of the bound, has
the expectation of ``squared error / bound - 1`` and a small part of its variance.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.bound import Bound
from vislam.core.reference import Reference
from vislam.core.run import Estimate, Run
from vislam.geometry import se3

PARTS = {"rotation": slice(0, 3), "position": slice(3, 6)}


@dataclass(frozen=True)
class Efficiency:
    """Errors of the poses relative to the first, and their lower bound.

    Attributes
    ----------
    frame : (n,)
    error : (n, 6)
        (omega, v), on the right of the true poses [rad, m].
    attained : (n, 6)
        The same of the linear estimator that attains the bound.
    least : (n, 6, 6)
        The bound.
    """

    frame: IntArray
    error: Array
    attained: Array
    least: Array

    def ratio(self, part: str) -> float:
        """Squared error of the rotations, or the positions, over the bound, both summed over the drive."""
        return float(np.sum(self.error[:, PARTS[part]] ** 2) / self._bound(part))

    def excess(self, part: str) -> float:
        """How much more it is than that of who attains the bound on the same noise, in parts of the bound."""
        own, other = self.error[:, PARTS[part]], self.attained[:, PARTS[part]]
        return float((np.sum(own**2) - np.sum(other**2)) / self._bound(part))

    def least_sigma(self, part: str) -> Array:
        """Root of the least mean squared error at each frame ``(n,)`` [rad or m]."""
        return np.sqrt(np.einsum("nii->n", self.least[:, PARTS[part], PARTS[part]]))

    def length(self, part: str) -> Array:
        """Length of the error at each frame ``(n,)`` [rad or m]."""
        return np.linalg.norm(self.error[:, PARTS[part]], axis=1)

    def metrics(self) -> Iterator[tuple[str, float, str, str]]:
        """Key, value, unit and convention of each number."""
        for part in PARTS:
            told = "of the motion since the first frame, summed over the drive"
            yield f"bound_ratio_{part}", self.ratio(part), "1", f"squared error over the bound, {told}"
            told = "less that of the linear estimator that attains the bound on the same noise"
            yield f"bound_excess_{part}", 100.0 * self.excess(part), "%", f"squared error {told}"

    def _bound(self, part: str) -> float:
        return float(np.sum(self.least_sigma(part) ** 2))


def efficiency(
    run: Run, reference: Reference | None, bound: Bound | None, estimate: Estimate
) -> Efficiency | None:
    """Hold an estimate against the bound; None where there is none."""
    if bound is None or reference is None or reference.pose is None:
        return None
    pose = run.poses(estimate).world_T_imu
    frame = run.frame[1:]
    if not len(frame):
        return None
    target = reference.pose[run.frame]
    error = se3.local(se3.inverse(target[0]) @ target, se3.inverse(pose[0]) @ pose)[1:]
    least, attained = getattr(bound, estimate), getattr(bound, f"{estimate}_error")
    return Efficiency(frame, error, attained[frame], least[frame])
