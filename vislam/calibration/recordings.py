"""The recordings that a calibration looks at: the first frames of one, and others read as it is."""

from dataclasses import replace

from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig
from vislam.comparison.open import Dataset


def first_frames_of(dataset: Dataset, frames: int | None) -> Dataset:
    """Dataset with the first frames only, its held-out tracks too; whole for None.

    Raises
    ------
    DataError
        If these are fewer than two.
    """
    if frames is None:
        return dataset
    sequence, held = dataset.sequence, dataset.held_out
    if frames < 2:
        raise DataError(f"{sequence.name}: the first {frames} frames are too few, at least 2 are needed")
    held = None if held is None else held.first(frames)
    return replace(dataset, sequence=sequence.first(frames), held_out=held)


def other_recording(data: DataConfig, file: str) -> DataConfig:
    """Section that reads another file, whose format is told by its content, with the same repairs."""
    return replace(
        data,
        file=file,
        source=None,
        packaged=None,
        simulation=None,
        inertial=None,
        redraw_inertial=None,
        reference=None,
    )
