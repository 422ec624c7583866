"""Errors that all tracks share: which calibration parameters the residuals of the whole recording ask for.

The parameters are taken in one after the other, that first which explains most beside those before it, as
long as one is significant: a wrong one explains part of what another leaves, too, so that each alone would be
found where any is.
"""

from collections.abc import Sequence as Items
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.rigid_fit import RigidFit
from vislam.core.sequence import Sequence
from vislam.core.shared_fit import PooledFit, pooled
from vislam.core.shared_residuals import SHARED, SharedResiduals, shared_residuals, twist_rates
from vislam.inspection.finding import Finding, Measured, Verdict
from vislam.inspection.motion import sample_noise
from vislam.inspection.shared_profile import Profile, profiles
from vislam.models.shared_errors import SIZES, UNITS, prior_name

_SIGNIFICANT = 4.0
"""Standard deviations from 0 at which a parameter is found."""
_ALIKE = 0.9
"""Correlation of two estimates above which the data do not tell them apart."""
_NOISY = 0.5
"""Share of noise in the rates of change of the twist above which they tell no clock."""
_LEAST_SIGMA = 1e-9


@dataclass(frozen=True)
class _Scale:
    """What an error of a parameter is held against.

    Attributes
    ----------
    floor : float
        What the estimate is off by whatever its interval says: the disparities that it rests on are noisy
        themselves, which in simulated drives with a stereo-matching bias of 0.8 px moves it by that much.
    unclear : float
        Standard deviation above which nothing is said of it.
    """

    floor: float
    unclear: float


_SCALES = {
    "camera_rotation": _Scale(5e-4, 5e-3),
    "disparity_offset": _Scale(0.03, 0.25),
    "principal_point": _Scale(0.5, 5.0),
    "focal_scale": _Scale(5e-3, 1.5e-2),
    "baseline_scale": _Scale(8e-3, 2e-2),
    "clock": _Scale(3e-3, 1e-2),
    "velocity_direction": _Scale(5e-4, 5e-3),
}
_BIASES = tuple(f"{kind} bias {axis}" for kind in ("gyro", "velocity") for axis in "xyz")


@dataclass(frozen=True)
class Judged:
    """One parameter.

    Attributes
    ----------
    name : str
    value, sigma : (q,)
        Beside those that were found.
    verdict : str
        ``found``, ``not found`` or ``unclear``.
    alone, beside : float
        Share of the residual variance that it explains alone, and beside all others.
    """

    name: str
    value: Array
    sigma: Array
    verdict: str
    alone: float
    beside: float

    @property
    def measured(self) -> tuple[Measured, ...]:
        """Its components."""
        return tuple(
            Measured.around(
                component,
                UNITS.get(self.name, ""),
                float(value),
                sigma=float(np.hypot(sigma, _SCALES[self.name].floor)),
            )
            for component, value, sigma in zip(_named(self.name), self.value, self.sigma, strict=True)
        )


def check_shared_errors(
    sequence: Sequence,
    fits: dict[int, RigidFit],
    *,
    density: tuple[float, ...],
    bias_mean: tuple[float, ...],
    bias_sigma: tuple[float, ...],
    priors: dict[str, float],
) -> tuple[Finding, dict[str, Array]]:
    """Which of the shared parameters the residuals ask for, and by how much.

    Parameters
    ----------
    sequence : Sequence
        Mended by what the checks before it have found.
    fits : dict of int to RigidFit
    density : (6,)
        White noise of the twist [rad/sqrt(s), m/sqrt(s)].
    bias_mean, bias_sigma : (6,)
        Configured prior of the twist bias.
    priors : dict
        Configured standard deviations of the shared parameters, by their names in the section ``noise``.
    """
    found = shared_residuals(sequence, fits)
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    sigma = np.maximum(np.array(bias_sigma), _LEAST_SIGMA)
    # A density of 0 would leave no step any error of its own.
    white = np.maximum(np.array(density), _LEAST_SIGMA)
    fit = pooled(found, dt=dt, density=white, bias_mean=np.array(bias_mean), bias_sigma=sigma)
    noisy = _rate_noise(sequence, found) > _NOISY
    judged, together = judge(fit, noisy=("clock",) if noisy else ())
    seen = profiles(sequence, found, fit.fit([]).bias)
    finding = _finding(judged, together, seen, priors=priors)
    series = {"shared_at": seen.at, "shared_recorded": seen.recorded, "shared_own": seen.own}
    return finding, series


def judge(fit: PooledFit, *, noisy: tuple[str, ...] = ()) -> tuple[list[Judged], "Together"]:
    """Verdict on each parameter.

    Parameters
    ----------
    fit : PooledFit
    noisy : tuple of str
        Names of parameters whose derivatives are mostly noise: nothing is said of them.
    """
    columns = _columns()
    usable = [name for name in SHARED if name not in noisy]
    chosen: list[str] = []
    while True:
        best, most = "", 0.0
        for name in usable:
            if name not in chosen:
                explained = fit.explained(_of([*chosen, name], columns))
                if explained > most and _significant(fit, [*chosen, name], columns):
                    best, most = name, explained
        if not best:
            break
        chosen.append(best)
    everything = fit.explained(_of(usable, columns))
    judged = []
    for name, own in columns.items():
        others = _of([one for one in chosen if one != name], columns)
        found = fit.fit([*others, *own])
        value, sigma = found.value[len(others) :], found.sigma[len(others) :]
        verdict = "found" if name in chosen else "unclear"
        if name in usable and name not in chosen and np.all(sigma <= _SCALES[name].unclear):
            verdict = "not found"
        rest = fit.explained(_of([one for one in usable if one != name], columns))
        judged.append(Judged(name, value, sigma, verdict, fit.explained(own), everything - rest))
    return judged, Together(everything, fit.explained(_of(chosen, columns)), _alike(fit, usable, columns))


@dataclass(frozen=True)
class Together:
    """What all parameters explain, what those found do, and which the data do not tell apart."""

    explained: float
    by_found: float
    alike: tuple[tuple[str, str, float], ...]


def _columns() -> dict[str, list[int]]:
    """Columns of each parameter."""
    out, first = {}, 0
    for name, axes in SHARED.items():
        out[name] = list(range(first, first + len(axes)))
        first += len(axes)
    return out


def _of(names: list[str], columns: dict[str, list[int]]) -> list[int]:
    return [column for name in names for column in columns[name]]


def _significant(fit: PooledFit, names: list[str], columns: dict[str, list[int]]) -> bool:
    """Whether a component of the last of these parameters is told from 0 beside the others."""
    found, scale = fit.fit(_of(names, columns)), _SCALES[names[-1]]
    last = slice(-len(columns[names[-1]]), None)
    error = np.hypot(found.sigma[last], scale.floor)
    return bool(np.any((np.abs(found.value[last]) > _SIGNIFICANT * error) & (error <= scale.unclear)))


def _alike(
    fit: PooledFit, usable: list[str], columns: dict[str, list[int]]
) -> tuple[tuple[str, str, float], ...]:
    """Strongest pair of components of two parameters, or of one and the bias, whose estimates go together.

    Each pair of parameters is fitted by itself, beside the bias.
    """
    pairs = []
    for index, one in enumerate(usable):
        names, here = _named(one), len(columns[one])
        alone = fit.fit(columns[one]).correlation[:here, here:]
        pairs.append(_strongest(names, _BIASES, alone))
        for other in usable[index + 1 :]:
            both = fit.fit(_of([one, other], columns)).correlation
            pairs.append(_strongest(names, _named(other), both[:here, here : here + len(columns[other])]))
    return tuple(pair for pair in pairs if abs(pair[2]) > _ALIKE)


def _strongest(rows: Items[str], columns: Items[str], correlation: Array) -> tuple[str, str, float]:
    """Names and value of the largest correlation of a table."""
    row, column = np.unravel_index(int(np.argmax(np.abs(correlation))), correlation.shape)
    return rows[int(row)], columns[int(column)], float(correlation[row, column])


def _named(name: str) -> list[str]:
    """Components in words."""
    return [f"{name.replace('_', ' ')}{axis}" for axis in SHARED[name]]


def _rate_noise(sequence: Sequence, found: SharedResiduals) -> float:
    """Share of noise in what the residuals would tell the clock by."""
    rates = twist_rates(sequence)[found.frame]
    by = found.by_twist * np.sqrt(found.weight)[:, None, None]
    whole = float(np.sum(np.einsum("mij,mj->mi", by, rates) ** 2))
    step = np.diff(sequence.stamp, prepend=np.inf)[found.frame]
    # A difference of two samples at most has twice the variance of one.
    variance = 2.0 * (sample_noise(sequence) / step[:, None]) ** 2
    added = float(np.einsum("mij,mij,mj->", by, by, variance))
    return added / max(whole, np.finfo(float).tiny)


def _finding(judged: list[Judged], together: Together, seen: Profile, *, priors: dict[str, float]) -> Finding:
    """One finding: a fault where an error is found that the configured prior does not hold."""
    found = [item for item in judged if item.verdict == "found"]
    open_ = [item for item in found if _beyond(item, priors)]
    unknown = {f"noise.{prior_name(item.name)}": _advice(item) for item in open_ if item.name in SIZES}
    verdict: Verdict = "fault" if open_ else "ok"
    if not found and any(item.verdict == "unclear" for item in judged):
        verdict = "unclear"
    counts = {f"explained_by_{item.name}_alone": item.alone for item in judged}
    counts |= {f"explained_by_{item.name}_beside_others": item.beside for item in judged}
    counts |= {"explained_by_all": together.explained, "explained_by_found": together.by_found}
    return Finding(
        "shared errors",
        verdict,
        "; ".join(_told(judged, together, seen)),
        tuple(one for item in judged for one in item.measured),
        counts,
        unknown=unknown,
    )


def _beyond(item: Judged, priors: dict[str, float]) -> bool:
    """Whether an error is more than twice its configured standard deviation."""
    known = priors.get(prior_name(item.name), 0.0) if item.name in SIZES else 0.0
    return float(np.max(np.abs(item.value))) > 2.0 * known


def _advice(item: Judged) -> str:
    """Standard deviation that an error found is one of, which is not proposed.

    As a state of an estimator it can be a worse model than none, where the residuals have another cause that
    looks alike: held-out tracks decide.
    """
    size = float(np.max(np.hypot(item.value, item.sigma)))
    return f"{size:.2g} would hold what the residuals ask for; try it against held-out tracks, or consider it"


def _told(judged: list[Judged], together: Together, seen: Profile) -> list[str]:
    told = []
    for item in judged:
        if item.verdict == "found":
            listed = ", ".join(str(one) for one in item.measured)
            told.append(f"FOUND {listed}: {100.0 * item.alone:.1f} % of the residual variance alone")
    for verdict in ("not found", "unclear"):
        names = [item.name.replace("_", " ") for item in judged if item.verdict == verdict]
        if names:
            told.append(f"{verdict.upper()} {', '.join(names)}")
    told.append(
        f"together they explain {100.0 * together.explained:.1f} % of the residual variance, those found "
        f"{100.0 * together.by_found:.1f} %"
    )
    if together.alike:
        pairs = ", ".join(f"{a} from {b} ({value:+.2f})" for a, b, value in together.alike)
        told.append(f"the data do not tell {pairs}")
    told.append(seen.far())
    return told
