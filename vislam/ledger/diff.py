"""Two entries side by side: what differs in config, data, code and figures."""

from collections.abc import Mapping
from typing import Any

from vislam.base.yaml_text import parse_yaml
from vislam.evaluation.metric import METRICS
from vislam.ledger.entries import Entry, is_synthetic
from vislam.report.table import Table

_DATA = ("name", "digest", "reference", "reference_limits")
_NONE = "-"


def differences(one: Entry, other: Entry) -> dict[str, Table]:
    """A table for each of config, data, code and figures, with the rows in which two entries differ."""
    config, data = (_config(one), _config(other)), (_data(one), _data(other))
    return {
        "config": _apart(*config),
        "data": _apart(*data),
        "code": _apart(one.provenance, other.provenance),
        "figures": _figures(one, other),
    }


def _config(entry: Entry) -> dict[str, Any]:
    """Values of the effective config by dotted path."""
    path = entry.folder / "config.yaml"
    tree = parse_yaml(path.read_text("utf-8")) if path.is_file() else entry.document.get("config", {})
    return dict(_flat(tree, ()))


def _flat(value: Any, path: tuple[str, ...]) -> list[tuple[str, Any]]:
    if isinstance(value, Mapping) and value:
        return [item for key, inner in value.items() for item in _flat(inner, (*path, str(key)))]
    return [(".".join(path), value)]


def _data(entry: Entry) -> dict[str, Any]:
    found = entry.document.get("dataset")
    if not isinstance(found, Mapping):
        return {"name": entry.data}
    return {**{key: found.get(key) for key in _DATA}, "synthetic": is_synthetic(found)}


def _apart(one: Mapping[str, Any], other: Mapping[str, Any]) -> Table:
    keys = [key for key in dict.fromkeys([*one, *other]) if one.get(key, _NONE) != other.get(key, _NONE)]
    rows = [[key, str(one.get(key, _NONE)), str(other.get(key, _NONE))] for key in keys]
    return Table(("what", "first", "second"), rows)


def _figures(one: Entry, other: Entry) -> Table:
    """Metrics that have a name of their own, where both have them and they differ as they are shown."""
    rows = []
    for name in one.metrics:
        spec = METRICS.get(next((part for part in name.split(".")[1:] if part in METRICS), ""))
        if spec is None or name not in other.metrics:
            continue
        first, second = (f"{entry.metrics[name]:.{spec.digits}f}" for entry in (one, other))
        if first != second:
            change = other.metrics[name] - one.metrics[name]
            share = f" ({100.0 * change / abs(one.metrics[name]):+.1f} %)" if one.metrics[name] else ""
            rows.append([f"{name} [{spec.unit or '1'}]", first, second, f"{change:+.{spec.digits}f}{share}"])
    return Table(("what", "first", "second", "change"), rows)
