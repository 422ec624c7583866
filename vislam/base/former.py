"""Former names of configuration keys, accepted for one version: each is replaced by the new one and noted."""

import logging
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

from vislam.base.errors import ConfigError

_log = logging.getLogger(__name__)

_SIMULATION = {
    "match_px": "matching_bias_px",
    "match_share": "matching_bias_share",
    "levelled_velocity": "navigation_frame_velocity",
    "stale_probability": "duplication_probability",
}
RENAMED: Mapping[str, str] = {
    "frozen_by": "common_set_from",
    "ladder": "ablation_chain",
    "noise.match_px": "noise.matching_bias_px",
    "noise.climb": "noise.vertical_velocity",
    "data.repair.levelled_velocity": "data.repair.navigation_frame_velocity",
    "data.repair.stale_tracks": "data.repair.duplicated_tracks",
    "data.repair.single_sightings": "data.repair.single_observations",
    **{
        f"{section}.{former}": f"{section}.{new}"
        for section in ("data.simulation", "data.source")
        for former, new in _SIMULATION.items()
    },
}
"""Dotted paths of former keys, and of what they are called now; the last part is what changes."""
METRICS: Mapping[str, str] = {
    "yaw_information_gained": "spurious_yaw_information",
    "position_information_gained": "spurious_position_information",
    "parting_frame": "divergence_frame",
}
"""Former keys of metrics, and what they are called now."""
CONFIGS: Mapping[str, str] = {"ladder": "ablation_chain"}
"""Former names of shipped configs, and what they are called now."""


def renamed(tree: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Replace former keys of a configuration by the new ones, and note them in one line.

    Dotted paths that are keys themselves, as in ``study.grid``, are replaced alike.

    Parameters
    ----------
    tree : mapping
        Plain data of a configuration.
    where : str
        File that it is from.

    Raises
    ------
    ConfigError
        If a section has both the former and the new name of a key.
    """
    former: dict[str, str] = {}
    out = _renamed(tree, where, (), former)
    note(former, where)
    return out


def renamed_path(dotted: str) -> str:
    """Dotted path of a key, or of one below it, by its new name; a former one is noted."""
    new = _new_path(dotted)
    if new != dotted:
        note({dotted: new}, "")
    return new


def metric_key(key: Any) -> Any:
    """Key of a metric by its new name; a former one is noted."""
    if not isinstance(key, str) or key not in METRICS:
        return key
    note({key: METRICS[key]}, "")
    return METRICS[key]


def note(former: Mapping[str, str], where: str) -> None:
    """Note, once, that former names were accepted, each with its new one; nothing if there are none."""
    if former:
        _note(tuple(former.items()), where)


@cache
def _note(former: Iterable[tuple[str, str]], where: str) -> None:
    listed = ", ".join(f"{old} is now called {new}" for old, new in former)
    names = "names" if len(tuple(former)) > 1 else "name"
    at = f"{where}: " if where else ""
    _log.warning("%s%s; this version takes the former %s, too", at, listed, names)


def _renamed(
    tree: Mapping[str, Any], where: str, above: tuple[str, ...], former: dict[str, str]
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        new = _new_key(key, above)
        if new != key:
            if new in tree:
                raise ConfigError(f"{where}: {key} is the former name of {new}: give one of them")
            former[".".join((*above, str(key)))] = new
        out[new] = _renamed(value, where, (*above, str(new)), former) if isinstance(value, dict) else value
    return out


def _new_key(key: Any, above: tuple[str, ...]) -> Any:
    """Key of a mapping at a path; one that is no text is left to the parser to reject."""
    if not isinstance(key, str):
        return key
    if above[:1] == ("study",):
        return _new_path(key)
    new = RENAMED.get(".".join((*above, key)))
    return key if new is None else new.rpartition(".")[2]


def _new_path(dotted: str) -> str:
    for former, new in RENAMED.items():
        if dotted == former or dotted.startswith(f"{former}."):
            return new + dotted.removeprefix(former)
    return dotted
