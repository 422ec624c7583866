"""A trajectory from elsewhere as it is scored: on stamps of its own, with the reference at these."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.run import Run


@dataclass(frozen=True)
class OwnClock:
    """What a trajectory from elsewhere is scored by.

    Attributes
    ----------
    run : Run
        Its rows; its frames count them.
    reference : Reference
        The rows of it, or interpolated ones, that belong to rows of the run.
    timed : bool
        Whether the stamps are times.
    facts : mapping of str to float
        Metrics of how it was matched, by their key.
    points : (m, 3) or None
        Of its map, in its world [m].
    told : tuple of str
        How it was read and matched.
    noticed : tuple of str
        What would fool the scores, each with the option that answers it.
    """

    run: Run
    reference: Reference
    timed: bool = True
    facts: Mapping[str, float] = field(default_factory=dict)
    points: Array | None = None
    told: tuple[str, ...] = ()
    noticed: tuple[str, ...] = ()
