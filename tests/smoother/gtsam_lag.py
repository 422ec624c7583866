"""GTSAM's own fixed-lag smoother as an engine: what ours must agree with."""

from collections.abc import Mapping, Sequence

import gtsam

from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.tree import Reading, solved


class GtsamLag(Reading):
    """``IncrementalFixedLagSmoother``, which eliminates what leaves with each update.

    Ours is exchanged for it by ``monkeypatch.setattr(engine, "FixedLag", GtsamLag)``. Its factors cannot be
    read: steps that need a recovery fail.
    """

    def __init__(self, options: SmootherOptions, parameters: gtsam.ISAM2Params) -> None:
        parameters.enableRelinearization = options.relinearize_every > 0
        parameters.relinearizeSkip = max(options.relinearize_every, 1)
        self._solver = gtsam.IncrementalFixedLagSmoother(options.lag_s, parameters)

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        *,
        stamps: Mapping[int, float],
        newest: Sequence[int],
        in_view: Sequence[int],
        resting: Sequence[int],
        remove: Sequence[int],
    ) -> list[int]:
        """Take a frame."""
        held = self._solver.getFactors()
        remove = [slot for slot in remove if held.exists(slot)]
        solved(self._solver.update, graph, values, dict(stamps), remove)
        return list(self._solver.getISAM2Result().getNewFactorsIndices())

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._solver.getLinearizationPoint()

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables in the window."""
        return solved(self._solver.calculateEstimate)

    def _with(self, *keys: int):
        return self._solver if len(keys) == 1 else self._solver.getISAM2()
