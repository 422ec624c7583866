"""Residuals of tracks carried over one frame, by where the point is and how the camera moves.

Under the recorded motion less its bias, and under the tracks' own: what a robust rigid motion of each frame
takes up, an error of rotation or velocity among it, shows in the first alone; what it does not, as a
disparity offset, in both.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.sequence import Sequence
from vislam.core.shared_residuals import SharedResiduals

QUANTITIES = (
    "disparity [px]",
    "column [px]",
    "row [px]",
    "speed [m/s]",
    "yaw rate [rad/s]",
    "pitch rate [rad/s]",
)
"""What the residuals are shown by; the rates are those about the camera's y and x axes."""
CHANNELS = ("column", "disparity", "row")
_BINS, _BLOCKS, _DRAWS, _SEED = 8, 20, 200, 0


@dataclass(frozen=True)
class Profile:
    """Mean residuals [px] in bins of each of :data:`QUANTITIES`, as many observations in each.

    Attributes
    ----------
    at : (6, bins)
        Mean of the quantity in each bin.
    recorded, own : (6, bins, 3, 3)
        By quantity, bin and channel: mean, and the ends of its 95 % interval by a block bootstrap.
    """

    at: Array
    recorded: Array
    own: Array

    def far(self) -> str:
        """Residuals of the farthest bin under the recorded motion, in words."""
        parts = [
            f"{CHANNELS[channel]} {mean:+.3f} px ({low:+.3f} to {high:+.3f})"
            for channel, (mean, low, high) in enumerate(self.recorded[0, 0])
            if channel != 1
        ]
        return f"the farthest eighth of the tracks is off the recorded motion by {', '.join(parts)} a frame"


def profiles(sequence: Sequence, found: SharedResiduals, bias: Array) -> Profile:
    """Profiles of the residuals of a recording.

    Parameters
    ----------
    sequence : Sequence
    found : SharedResiduals
    bias : (6,)
        Of the recorded twist, taken out of the residuals under it.
    """
    means, _ = sequence.step_means()
    rates = means[:, :3] @ sequence.rig.imu_T_cam[:3, :3]
    speed = np.linalg.norm(means[:, 3:], axis=1)
    z = sequence.z[found.row]
    quantities = (
        z[:, 0] - z[:, 1],
        z[:, 0],
        z[:, 2],
        *(values[found.frame] for values in (speed, rates[:, 1], rates[:, 0])),
    )
    edges = np.unique(found.frame)
    block = np.searchsorted(edges, found.frame) * min(_BLOCKS, len(edges)) // len(edges)
    recorded = (found.residual - found.by_twist @ bias) * found.spread
    own = found.own * found.spread
    at, tables = [], []
    for values in quantities:
        which = _bins(values)
        at.append(np.bincount(which, values, _BINS) / np.maximum(np.bincount(which, minlength=_BINS), 1))
        both = np.concatenate([recorded, own], axis=1)
        tables.append(_means(both, found.weight, which, block))
    table = np.array(tables)
    return Profile(np.array(at), table[:, :, :3], table[:, :, 3:])


def _bins(values: Array) -> IntArray:
    """Bin of each value, by its rank."""
    order = np.argsort(values, kind="stable")
    out = np.empty(len(values), dtype=np.int64)
    out[order] = np.arange(len(values)) * _BINS // max(len(values), 1)
    return out


def _means(values: Array, weight: Array, which: IntArray, block: IntArray) -> Array:
    """Weighted means ``(bins, c, 3)`` of ``values (m, c)`` in bins, with their intervals."""
    blocks = int(block.max()) + 1
    cell = block * _BINS + which
    total = np.bincount(cell, weight, blocks * _BINS).reshape(blocks, _BINS)
    sums = np.stack(
        [np.bincount(cell, weight * column, blocks * _BINS).reshape(blocks, _BINS) for column in values.T],
        axis=2,
    )
    chosen = np.random.default_rng(_SEED).integers(0, blocks, (_DRAWS, blocks))
    drawn = sums[chosen].sum(axis=1) / np.maximum(total[chosen].sum(axis=1), 1e-12)[:, :, None]
    mean = sums.sum(axis=0) / np.maximum(total.sum(axis=0), 1e-12)[:, None]
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    return np.stack([mean, low, high], axis=2)
