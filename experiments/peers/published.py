"""Figures of programs that are not run here."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """What is known of a program on KITTI raw drive 2011_09_26_drive_0001, 97 steps.

    Attributes
    ----------
    name : str
    armse : float
        Position ARMSE of :mod:`experiments.battle` [m].
    seconds : float or None
        CPU time of the whole run on one core of another machine [s]; None where it is not known.
    source : str
    """

    name: str
    armse: float
    seconds: float | None
    source: str


PUBLISHED = (
    Published(
        "MSCKF of Clement et al. (left camera)",
        0.335,
        27.0,
        "the authors' MATLAB code run in GNU Octave, one core of another machine",
    ),
    Published(
        "sliding window of 10 of Clement et al. (left camera)",
        0.339,
        None,
        "result files of The Battle for Filter Supremacy (CRV 2015)",
    ),
)
