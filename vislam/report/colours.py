"""One colour for each estimator, the same on every page: of a comparison, a study, a ledger."""

import hashlib
from collections.abc import Iterable

# Okabe and Ito's colours, which the colour-blind can tell apart; then some of Tol's, and a grey.
COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"),
    *("#332288", "#999933", "#882255", "#6E7781", "#44AA99", "#AA4466"),
)
"""Colours by index; ``page.css`` has the same as ``--c0``, ``--c1``, ... for light and for dark paper."""
_OWN = {
    "isam2": 0,
    "ekf": 1,
    "ekf_invariant": 2,
    "eks": 3,
    "fixed_lag": 4,
    "ekf_fej": 5,
    "batch": 6,
    "stereo_vo": 7,
    "isam2_between": 8,
    "dead_reckoning": 9,
    "ekf_track_states": 10,
    "report_ekf": 11,
}
"""Of the estimators that are often seen together; any other has one by its name."""


def colour_indices(names: Iterable[str]) -> dict[str, int]:
    """Index in ``COLOURS`` of each name.

    A name has its own colour wherever it is shown. Where two on one page would have the same, the later one
    takes the next that is free.
    """
    names = list(names)
    found = {name: _OWN[name] for name in names if name in _OWN}
    taken = set(found.values())
    for name in names:
        if name in found:
            continue
        first = int.from_bytes(hashlib.sha256(name.encode(errors="surrogatepass")).digest()[:4]) % len(
            COLOURS
        )
        order = [(first + step) % len(COLOURS) for step in range(len(COLOURS))]
        found[name] = next((index for index in order if index not in taken), first)
        taken.add(found[name])
    return {name: found[name] for name in names}


def colours(names: Iterable[str]) -> dict[str, str]:
    """Colour of each name, ``#rrggbb``."""
    return {name: COLOURS[index] for name, index in colour_indices(names).items()}
