"""Simulated sequences with exact truth, in the shape and with the faults of the recorded ones."""

from vislam.simulation.drive import Truth, simulate
from vislam.simulation.settings import SimulationConfig

__all__ = ["SimulationConfig", "Truth", "simulate"]
