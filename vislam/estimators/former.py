"""Options that the estimators once had, each with what it is called now."""

from collections.abc import Mapping
from typing import Any

from vislam.base.errors import ConfigError

_KERNEL = (
    "the robust kernel is one setting of the whole comparison now, Student's for all estimators; write "
    "kernel: {degrees_of_freedom: 4} beside gate_probability, or in the section of a run for that run alone"
)
_FORMER = {"robust": _KERNEL, "robust_threshold": _KERNEL}


def refuse_former(options: Mapping[str, Any], *, at: str) -> None:
    """Raise a ConfigError that names the remedy if a config section ``at`` has an option of the past."""
    for name in options:
        if name in _FORMER:
            raise ConfigError(f"{at}.{name}: {_FORMER[name]}")
