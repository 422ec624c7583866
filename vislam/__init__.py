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
    "Estimate": "vislam.core.estimator",
    "Estimator": "vislam.core.estimator",
    "Problem": "vislam.core.estimator",
    "Run": "vislam.core.run",
    "Sequence": "vislam.core.sequence",
    "StepRecord": "vislam.core.estimator",
}
_MODULES = ("compare", "evaluate", "inspect", "datasets", "geometry")
"""The first three are commands that can be called as well, the same object whatever is imported first."""

__all__ = [
    "Config",
    "Estimate",
    "Estimator",
    "Outcome",
    "Problem",
    "Run",
    "Sequence",
    "StepRecord",
    "compare",
    "datasets",
    "evaluate",
    "geometry",
    "inspect",
    "load_config",
    "run",
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
