"""Repairs of a recording: named steps, each switched in the config, each counting what it did.

What is wrong with such recordings is described in ``docs/guides/inspect_and_calibrate.md``;
``python -m vislam.inspect`` finds which of the steps a recording needs.
"""

from vislam.repair.steps import RepairConfig, apply

__all__ = ["RepairConfig", "apply"]
