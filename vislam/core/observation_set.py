"""The common observation set: what estimators are given so that they differ by inference alone."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vislam.base.types import BoolArray
from vislam.core import sequence as data
from vislam.core.run import Run

_DIGITS = 12


@dataclass(frozen=True)
class CommonSet:
    """The observations that every one of some estimators fused.

    Attributes
    ----------
    by : tuple of str
        Those estimators, in the order in which they ran.
    exempt : tuple of str
        Runs that are given all observations nevertheless.
    kept : (n,)
        Which observations of the sequence are on the list.
    digest : str
        Hash of the data and of the list.
    """

    by: tuple[str, ...]
    exempt: tuple[str, ...]
    kept: BoolArray
    digest: str

    @classmethod
    def of(
        cls, sequence: data.Sequence, kept: BoolArray, *, by: tuple[str, ...], exempt: tuple[str, ...] = ()
    ) -> "CommonSet":
        """Freeze the observations of a mask ``(n,)``."""
        # A row of the recording and its track say which observation it is, whatever the repairs left out.
        parts = (
            sequence.digest.encode(),
            sequence.row[kept].tobytes(),
            sequence.track[kept].tobytes(),
        )
        digest = hashlib.sha256(b"|".join(parts)).hexdigest()[:_DIGITS]
        return cls(by, exempt, kept, digest)

    def not_fused(self, runs: Mapping[str, Run]) -> dict[str, int]:
        """How many observations of the list each run that is bound to it did not fuse."""
        return {
            name: int(np.count_nonzero(self.kept & ~run.used))
            for name, run in runs.items()
            if name not in self.exempt
        }

    def record(self) -> dict[str, object]:
        """Plain data for JSON."""
        kept = int(np.count_nonzero(self.kept))
        return {"digest": self.digest, "kept": kept, "of": len(self.kept), "by": list(self.by)}

    def tell(self, runs: Mapping[str, Run]) -> str:
        """Describe in a few sentences what the set is and which runs fused all of it."""
        said = [
            f"Common observation set {self.digest}: {int(self.kept.sum())} of {len(self.kept)} "
            f"observations, which {_listed(self.by)} fused and whose tracks were observed again; no "
            "estimator gates for itself."
        ]
        left = [
            f"{name} {count}"
            for name, count in self.not_fused(runs).items()
            if count and not runs[name].blind
        ]
        said.append(f"Not fused of it: {_listed(left)}." if left else "All of it was fused by every run.")
        given_all = [name for name in runs if name in self.exempt]
        if given_all:
            said.append(f"Given all observations instead: {_listed(given_all)}.")
        return " ".join(said)


def _listed(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)
