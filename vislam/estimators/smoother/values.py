"""Parts of the values of a graph."""

from collections.abc import Iterable

import gtsam


def only(values: gtsam.Values, keys: Iterable[int]) -> gtsam.Values:
    """Those of the values that have one of these keys."""
    wanted = set(keys)
    return without(values, [key for key in list(values.keys()) if key not in wanted])


def without(values: gtsam.Values, keys: Iterable[int]) -> gtsam.Values:
    """All values but those of these keys."""
    found = gtsam.Values(values)
    for key in keys:
        found.erase(key)
    return found
