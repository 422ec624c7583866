"""Recordings and references: what they hold in memory, and one reader a format."""

from vislam.data.course_npz import load_course_npz
from vislam.data.sequence import Frame, Repair, Sequence

__all__ = ["Frame", "Repair", "Sequence", "load_course_npz"]
