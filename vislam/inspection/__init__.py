"""What is wrong with a recording, found in the data alone: no reference, no estimator."""

from vislam.inspection.checks import inspect_sequence
from vislam.inspection.finding import Finding, Inspection, Measured

__all__ = ["Finding", "Inspection", "Measured", "inspect_sequence"]
