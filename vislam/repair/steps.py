"""The list of repairs: their names in the config, their order, and the one loop that applies them."""

from dataclasses import asdict, fields, replace
from typing import Annotated, Any, ClassVar, Protocol, TypeVar

from pydantic import BeforeValidator
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT
from vislam.core.sequence import Repair, Sequence
from vislam.repair.consensus import Consensus
from vislam.repair.inertial import Clock, ImuUnits, NavigationFrameRates, NavigationFrameVelocity
from vislam.repair.mounting import Axes, Baseline, Extrinsic
from vislam.repair.pixels import Disparity, DisparityOffset
from vislam.repair.tracks import DuplicatedTracks, Interruptions, SingleObservations, Thinning

Kind = TypeVar("Kind")


class Step(Protocol):
    """What a repair is: options, and a function from sequence to sequence that adds to the counts."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def apply(self, sequence: Sequence) -> Sequence:
        """Return the repaired sequence."""
        ...


def _switch(value: Any) -> Any:
    """``true`` is a step with its defaults, ``false`` is none."""
    if isinstance(value, bool):
        return {} if value else None
    return value


Switched = Annotated[Kind | None, BeforeValidator(_switch)]
"""A step's options; ``true`` for its defaults, ``false`` or null to leave it out."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class RepairConfig:
    """The repairs in the order in which they are applied."""

    extrinsic: Switched[Extrinsic] = None
    """Read the extrinsic the other way round, whole or in part."""
    axes: Switched[Axes] = None
    """Rotate the extrinsic into the body axes of the velocities."""
    baseline: Switched[Baseline] = None
    """Replace the stereo baseline."""
    imu_units: Switched[ImuUnits] = None
    """Bring raw inertia to rad/s and m/s^2."""
    clock: Switched[Clock] = None
    """Move the inertial stamps to the camera's clock."""
    navigation_frame_velocity: Switched[NavigationFrameVelocity] = None
    """Interpret the third velocity component as the vertical velocity (navigation frame)."""
    navigation_frame_rates: Switched[NavigationFrameRates] = None
    """Rotate rates about level axes (navigation frame) into the body's axes."""
    disparity_offset: Switched[DisparityOffset] = None
    """Correct a constant error of all disparities."""
    duplicated_tracks: Switched[DuplicatedTracks] = DuplicatedTracks()
    """Initialise new landmarks in frames that repeat the pixels of the frame before (re-detected tracks)."""
    disparity: Switched[Disparity] = Disparity()
    """Drop what cannot be a stereo observation, and tracks that start too far away."""
    interruptions: Switched[Interruptions] = Interruptions()
    """Initialise a new landmark where a track was interrupted."""
    consensus: Switched[Consensus] = Consensus()
    """Initialise a new landmark where a track departs from the rigid motion of the others."""
    thinning: Switched[Thinning] = None
    """Keep one track in so many; the steps before have seen them all."""
    single_observations: Switched[SingleObservations] = SingleObservations()
    """Drop tracks observed once only."""


def apply(sequence: Sequence, config: RepairConfig) -> Sequence:
    """Apply the steps that are switched on; the sequence keeps a record of every step, on or off."""
    records = []
    for item in fields(RepairConfig):
        step: Step | None = getattr(config, item.name)
        counts: dict[str, int] = {}
        given = sequence
        if step is not None:
            sequence = step.apply(sequence)
            counts = {key: value for key, value in sequence.counts.items() if key not in given.counts}
        options = {} if step is None else asdict(step)
        before, after = given.observations, sequence.observations
        records.append(Repair(item.name, step is not None, options, counts, before=before, after=after))
    return replace(sequence, repairs=tuple(records))
