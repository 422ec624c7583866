"""Filter or smoother, on my data? EKF and factor-graph stereo visual-inertial SLAM, compared.

``vislam compare ds3`` is the main job; from Python, :func:`vislam.compare`, :func:`vislam.run`,
:func:`vislam.evaluate` and :func:`vislam.inspect` do the same and write nothing unless asked.
``vislam.geometry`` states the conventions; ``vislam.core.estimator`` is the interface of all estimators.
"""

from importlib import import_module
from typing import Any

_PUBLIC = {
    "run": "vislam.api",
    "Outcome": "vislam.api",
    "load_config": "vislam.api",
    "Config": "vislam.comparison.config",
    "Estimator": "vislam.core.estimator",
    "Problem": "vislam.core.estimator",
    "Frame": "vislam.core.frame",
    "Run": "vislam.core.run",
    "Sequence": "vislam.core.sequence",
    "Final": "vislam.core.step",
    "State": "vislam.core.step",
    "Step": "vislam.core.step",
    "Landmarks": "vislam.core.trajectory",
    "Poses": "vislam.core.trajectory",
}
_MODULES = ("compare", "evaluate", "inspect", "datasets", "geometry", "testing")
"""The first three are commands that can be called as well, the same object whatever is imported first."""

__all__ = [
    "Config",
    "Estimator",
    "Final",
    "Frame",
    "Landmarks",
    "Outcome",
    "Poses",
    "Problem",
    "Run",
    "Sequence",
    "State",
    "Step",
    "compare",
    "datasets",
    "evaluate",
    "geometry",
    "inspect",
    "load_config",
    "run",
    "testing",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: the import of the package alone costs nothing."""
    if name in _MODULES:
        return import_module(f"vislam.{name}")
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'vislam' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Names that there are, loaded or not."""
    return sorted({*globals(), *__all__})
