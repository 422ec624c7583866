"""Former options of the estimators: renamed ones are accepted for one version, others name their remedy."""

from collections.abc import Mapping
from typing import Any

from vislam.base import former
from vislam.base.errors import ConfigError

_KERNEL = (
    "the robust kernel is one setting of the whole comparison now, Student's for all estimators; write "
    "kernel: {degrees_of_freedom: 4} beside gate_probability, or in the section of a run for that run alone"
)
_WITHDRAWN = {"robust": _KERNEL, "robust_threshold": _KERNEL}
RENAMED = {
    "finished": "marginalised_landmarks",
    "start_clearance": "initialisation_snr",
    "max_waiting_views": "max_pending_observations",
    "max_rescues": "max_recoveries",
}
"""Former names of options, and what they are called now."""
RENAMED_VALUES = {
    "error": {"first_estimates": "fej"},
    "landmarks": {"disparity": "anchored_uvd"},
    "marginalised_landmarks": {"as_left": "filtered"},
}
"""Former values by the option, and what they are called now."""


def current(
    options: Mapping[str, Any],
    *,
    at: str,
    names: Mapping[str, str] = RENAMED,
    values: Mapping[str, Mapping[str, str]] = RENAMED_VALUES,
) -> dict[str, Any]:
    """Options of a config section ``at`` by their new names and values; former ones are noted.

    Raises
    ------
    ConfigError
        If an option was withdrawn, with the remedy, or is given by both its names.
    """
    noted: dict[str, str] = {}
    out: dict[str, Any] = {}
    for name, value in options.items():
        if name in _WITHDRAWN:
            raise ConfigError(f"{at}.{name}: {_WITHDRAWN[name]}")
        new = names.get(name, name)
        if new != name:
            if new in options:
                raise ConfigError(f"{at}: {name} is the former name of {new}: give one of them")
            noted[name] = new
        out[new] = value
        known = values.get(new, {})
        if isinstance(value, str) and value in known:
            out[new] = known[value]
            noted[f"{new}: {value}"] = known[value]
    former.note(noted, at)
    return out
