"""Recordings and references: what they hold in memory, and one reader a format."""

from vislam.core.sequence import Frame, Repair, Sequence
from vislam.datasets.course_npz import load_course_npz

__all__ = ["Frame", "Repair", "Sequence", "load_course_npz"]
