"""What a model of motion is to the filter: blocks of the navigation state, a step, what is measured.

The filter knows of its navigation state only the pose and, for the camera, the offset of the disparities.
Every other block belongs to the model of motion, which predicts it and may measure it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.core.step import State
from vislam.estimators.ekf.layout import NavLayout
from vislam.models import shared_errors


@dataclass(frozen=True)
class Block:
    """Prior of a block of the navigation state; ``sigma (m,)`` are its standard deviations."""

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class Propagation:
    """What a step makes of the navigation state.

    Attributes
    ----------
    prev_T_next : (4, 4)
        The motion of the pose.
    change : (d,)
        What is added to the other blocks; of the pose it is not used.
    transition, noise : (d, d)
        F and Q of the error.
    """

    prev_T_next: Array
    change: Array
    transition: Array
    noise: Array


@dataclass(frozen=True)
class Measurement:
    """A measurement of the navigation state alone.

    Attributes
    ----------
    innovation : (m,)
    by_nav : (m, d)
    variance : (m,)
    """

    innovation: Array
    by_nav: Array
    variance: Array


class Motion(Protocol):
    """A model of motion."""

    @property
    def states(self) -> tuple[str, ...]:
        """Blocks that are reported at each frame."""
        ...

    @property
    def information(self) -> Mapping[str, str]:
        """Information about it that an estimator reports."""
        ...

    def blocks(self) -> Mapping[str, Block]:
        """Blocks that it needs behind the pose, with their priors."""
        ...

    def first(self, layout: NavLayout, nav: Array, frame: Frame) -> Array:
        """Mean ``(d,)`` of the navigation state at the first frame, from that of the priors."""
        ...

    def propagate(self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame) -> Propagation:
        """Step to a frame from pose ``(4, 4)`` and navigation state ``nav (d,)`` at the one before."""
        ...

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """What is measured at a frame besides the tracks."""
        ...

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """Direction ``(3,)`` of up in the world, if it is known better than by the z axis."""
        ...


def reported(motion: Motion, layout: NavLayout, nav: Array, cov: Array) -> dict[str, State]:
    """What a step reports of the navigation state beside the pose: also the errors that all tracks share.

    Parameters
    ----------
    motion : Motion
    layout : NavLayout
    nav : (d_nav,)
    cov : (d, d)
        Covariance of the whole state, the navigation state first.
    """
    names = [*motion.states, *(name for name in shared_errors.SIZES if name in layout)]
    variance = cov.diagonal()
    return {name: State(nav[layout[name]].copy(), np.sqrt(variance[layout[name]])) for name in names}
