"""Inertial data against the camera's own frame-to-frame motion: clock, biases, noise, third component."""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import RigidFit
from vislam.core.sequence import Sequence
from vislam.geometry import se3
from vislam.inspection.finding import Finding, Measured, robust_sigma
from vislam.repair import RepairConfig

_AXES = "xyz"
LAGS_S = np.arange(-0.2, 0.2001, 0.005)
_BLOCKS = 12
_COLUMNS = [0, 1, 2, 3, 3]
_BOTH, _TURNS = slice(0, 4), slice(0, 3)
_SPEEDS = (slice(3, 4), slice(4, 5))
"""Of the mismatch: rates and speed, each of which tells the clock by itself, the speed in two ways."""
_CLOCK_FAULT_S = 0.015
_CLOCK_UNCLEAR_S = 0.02
_CLOCK_FLOOR_S = 0.004
"""Two ways of choosing the tracks move the clock by about so much."""
_RELIABLE = 0.3
"""Share of the variance of a sample that must be motion, not noise, to say what the sample means."""
_FOURTH_DIFFERENCE = np.sqrt(70.0)
"""Standard deviation of a fourth difference of white noise of variance 1."""
_FEWEST_CHANGES = 20
_GAP = 1.5
"""A step, or a distance of samples, this many times the usual one has a gap."""
_TAILS = 4.0
_GATINGS = 20
_ALONG = 0.3
"""A third velocity component above this share of the speed is not that of a vehicle on the ground."""


@dataclass(frozen=True)
class VisionSteps:
    """Motion of the body as the camera sees it, for the frames where it does.

    Attributes
    ----------
    frame : (m,)
    twist : (m, 6)
        Mean twist over the step that ends there [rad/s, m/s].
    sigma : (m, 6)
        Its standard deviation by the fit.
    """

    frame: IntArray
    twist: Array
    sigma: Array


def vision_steps(sequence: Sequence, fits: dict[int, RigidFit]) -> VisionSteps:
    """Body twists of the rigid fits, by the sequence's mounting."""
    frame = np.array(sorted(fits), dtype=np.int64)
    rig = sequence.rig
    motion = np.array([fits[k].next_T_prev for k in frame]).reshape(-1, 4, 4)
    cov = np.array([fits[k].cov for k in frame]).reshape(-1, 6, 6)
    dt = np.diff(sequence.stamp, prepend=np.nan)[frame]
    step = rig.imu_T_cam @ se3.inverse(motion) @ rig.cam_T_imu
    adjoint = se3.adjoint(rig.imu_T_cam)
    variance = np.diagonal(adjoint @ cov @ adjoint.T, axis1=1, axis2=2)
    return VisionSteps(frame, se3.log(step) / dt[:, None], np.sqrt(variance) / dt[:, None])


def check_clock(
    sequence: Sequence, steps: VisionSteps, repair: RepairConfig
) -> tuple[Finding, dict[str, Array]]:
    """Offset of the inertial stamps at which turns and changes of speed of both agree best.

    The noise of a mean over a step depends on how the step lies to the samples: two halves of one sample each
    average it better than one whole. Uncorrected, that draws the offset towards whole periods.
    """
    period = float(np.median(np.diff(sequence.inertial_stamp)))
    noise = sample_noise(sequence)[:4]
    steps = _without_gaps(sequence, steps)
    if len(steps.frame) < _FEWEST_CHANGES:
        text = f"only {len(steps.frame)} steps without a gap show the camera's motion"
        return Finding("clock", "unclear", text, unknown={"data.repair.clock": text}), {}
    cost = np.array([_mismatch(sequence, steps, float(lag), noise=noise, period=period) for lag in LAGS_S])
    whole, error = best_lag(cost[:, :, _BOTH].sum(axis=2))
    measured = Measured.around("clock offset", "s", whole, sigma=error)
    series = {"clock_lag": LAGS_S, "clock_cost": cost[:, :, _BOTH].sum(axis=2).mean(axis=1)}
    now = 0.0 if repair.clock is None else repair.clock.offset
    if error > _CLOCK_UNCLEAR_S or abs(whole) > LAGS_S[-3]:
        text = f"the sequence does not determine the clock offset: {measured}, configured is {now:g} s"
        return Finding("clock", "unclear", text, (measured,), unknown={"data.repair.clock": text}), series
    turns, speed = _contradicting(cost)
    if speed is not None:
        text = (
            f"the rates of turn say {turns:.3f} s, the speed {speed:.3f} s: no clock suits both, and none is "
            f"proposed; configured is {now:g} s"
        )
        return Finding("clock", "unclear", text, (measured,), unknown={"data.repair.clock": text}), series
    return judged_clock("clock", whole, error, now=now), series


def judged_clock(
    check: str,
    whole: float,
    error: float,
    *,
    now: float,
    sure: float = 4.0,
    unclear: float = _CLOCK_UNCLEAR_S,
    explained: bool = True,
) -> Finding:
    """Finding on an offset of the inertial stamps.

    Parameters
    ----------
    check : str
        Its name.
    whole, error : float
        Offset and its standard deviation [s].
    now : float
        As configured [s].
    sure : float
        Standard deviations by which it must be off to be a fault.
    unclear : float
        Standard deviation above which one that is not off may be [s].
    explained : bool
        Whether at that offset the inertial data follow the camera at all.
    """
    measured = Measured.around("clock offset", "s", whole, sigma=error)
    off, told = abs(whole - now), explained and error <= _CLOCK_UNCLEAR_S
    if told and off > _CLOCK_FAULT_S and off > sure * error:
        text = f"the inertial stamps are late by {measured}, configured is {now:g} s"
        proposal = {"data.repair.clock": {"offset": round(whole, 3)}}
        return Finding(check, "fault", text, (measured,), proposal=proposal)
    if not told or error > unclear:
        reason = "" if explained else ", at no offset do the inertial data follow the camera"
        text = (
            f"the sequence does not determine the clock offset: {measured}{reason}, configured is {now:g} s"
        )
        return Finding(check, "unclear", text, (measured,), unknown={"data.repair.clock": text})
    return Finding(check, "ok", f"{measured}, configured is {now:g} s", (measured,))


def _contradicting(cost: Array) -> tuple[float, float | None]:
    """Lag that the rates ask for, and that of the speed if it is another, whatever the camera's scale."""
    turns, error = best_lag(cost[:, :, _TURNS].sum(axis=2))
    speeds = [best_lag(cost[:, :, part].sum(axis=2)) for part in _SPEEDS]
    told = max(error, *(one for _, one in speeds)) <= _CLOCK_UNCLEAR_S
    off = all(abs(turns - speed) > 4.0 * np.hypot(error, one) for speed, one in speeds)
    return turns, speeds[0][0] if told and off else None


def best_lag(cost: Array, *, depth: float = 0.0) -> tuple[float, float]:
    """Lag of the least mean of a cost ``(l, m)`` of each step at each lag, and its standard deviation.

    Parameters
    ----------
    cost : (l, m)
    depth : float
        Share of the depth of a valley that the parabola through its ground is fitted to, 30 ms to either side
        of the lowest lag at least.
    """
    blocks = [part for part in np.array_split(np.arange(cost.shape[1]), _BLOCKS) if len(part)]
    left_out = np.array([_lowest(np.delete(cost, part, axis=1).mean(axis=1), depth) for part in blocks])
    return _lowest(cost.mean(axis=1), depth), float(np.hypot(jackknife(left_out), _CLOCK_FLOOR_S))


def _without_gaps(sequence: Sequence, steps: VisionSteps) -> VisionSteps:
    """Steps of the usual length with inertial samples at the usual distance all around them.

    Where samples are missing, a line joins those that are there: what lags there is the line.
    """
    at, usual = sequence.inertial_stamp, float(np.median(np.diff(sequence.inertial_stamp)))
    frame_step = np.diff(sequence.stamp, prepend=-np.inf)[steps.frame]
    wide = np.flatnonzero(np.diff(at) > _GAP * usual)
    first = np.searchsorted(at[wide + 1], sequence.stamp[steps.frame] - frame_step + LAGS_S[0])
    last = np.searchsorted(at[wide], sequence.stamp[steps.frame] + LAGS_S[-1])
    kept = (frame_step <= _GAP * float(np.median(np.diff(sequence.stamp)))) & (first >= last)
    return VisionSteps(steps.frame[kept], steps.twist[kept], steps.sigma[kept])


def _mismatch(sequence: Sequence, steps: VisionSteps, lag: float, *, noise: Array, period: float) -> Array:
    """Squares ``(m, 5)`` of each step's mismatch at a lag, over their scale, less what noise adds.

    In three rates, in the speed ahead, and in that with the camera's scale left free: where the speed only
    rises or falls, an error of the scale looks like a lag.
    """
    means = replace(sequence, clock_offset=lag).step_means()[0][steps.frame, :4]
    residual = steps.twist[:, :4] - means
    residual = residual - np.median(residual, axis=0)
    speed = means[:, 3] - means[:, 3].mean()
    share = float(speed @ residual[:, 3]) / max(float(speed @ speed), 1e-12)
    residual = np.column_stack([residual, residual[:, 3] - share * speed])
    noise = noise[_COLUMNS]
    scale = np.maximum(1.4826 * np.median(np.abs(residual), axis=0), 1e-9)
    residual = np.clip(residual, -4.0 * scale, 4.0 * scale)
    # Weights of three samples in the mean over a step that begins a fraction behind the first of them.
    fraction = (lag / period) % 1.0
    weights = np.array([0.5 * (1.0 - fraction) ** 2, 0.5 + fraction - fraction**2, 0.5 * fraction**2])
    added = noise**2 * (weights @ weights)
    spread = np.maximum(steps.sigma[:, _COLUMNS].mean(axis=0) ** 2 + 0.5 * noise**2, 1e-12)
    return np.asarray((residual**2 - added) / spread)


def sample_noise(sequence: Sequence) -> Array:
    """Standard deviation ``(6,)`` of white noise in samples of a smooth motion [rad/s, m/s]."""
    return np.asarray(1.4826 * np.median(np.abs(_noise_of_samples(sequence)), axis=0))


def _noise_of_samples(sequence: Sequence) -> Array:
    """Fourth differences ``(n, 6)`` of the samples, with the standard deviation of one sample.

    Over a gap a difference has the motion in it: those are left out, unless too few are without one.
    """
    step = np.diff(sequence.inertial_stamp)
    wide = step > _GAP * np.median(step)
    even = ~np.any(np.lib.stride_tricks.sliding_window_view(wide, 4), axis=1) if len(wide) > 3 else wide[:0]
    fourth = np.diff(sequence.twist, n=4, axis=0) / _FOURTH_DIFFERENCE
    return fourth[even] if np.count_nonzero(even) >= _FEWEST_CHANGES else fourth


def _lowest(curve: Array, depth: float) -> float:
    """Lag of the lowest value, by the parabola through the points around it."""
    at = int(np.argmin(curve))
    high = np.flatnonzero(curve > curve[at] + depth * np.ptp(curve))
    first = int(max(high[high < at], default=-1)) + 1
    last = int(min(high[high > at], default=len(curve)))
    near = slice(max(0, min(first, at - 6)), min(len(curve), max(last, at + 7)))
    bend, slope, _ = np.polyfit(LAGS_S[near] - LAGS_S[at], curve[near], 2)
    shift = 0.0 if bend <= 0 else -slope / (2.0 * bend)
    return float(LAGS_S[at] + np.clip(shift, -0.03, 0.03))


def check_inertial_noise(
    sequence: Sequence,
    *,
    density: tuple[float, ...],
    seen: tuple[Sequence, VisionSteps] | None = None,
    heave: bool = False,
) -> Finding:
    """White noise of the inertial samples at most: their fourth differences, free of a smooth drive.

    Parameters
    ----------
    sequence : Sequence
        Velocities as recorded.
    density : (6,)
        As configured.
    seen : (Sequence, VisionSteps), optional
        Velocities as they are to be used, and the camera's. Across the direction of travel it is not the
        noise of the samples that counts but how far a body is from what they say: side slip, and heave where
        the vertical velocity is taken to be 0.
    heave : bool
        Whether the vertical velocity is taken to be 0 without a camera to say how far it is from that; then
        it may be all that was recorded.
    """
    measured = _sample_densities(sequence)
    known = [i for i in range(6) if measured[i].value > 0.0]
    if not known:
        text = "too few samples, or samples that do not change"
        unknown = {"noise.twist_density": f"{text}; as configured"}
        return Finding("inertial noise", "unclear", text, unknown=unknown)
    text = "at most " + "; ".join(str(measured[i]) for i in known)
    values = [measured[i].value if i in known else density[i] for i in range(6)]
    if seen is not None:
        rates = _rates(*seen)
        text = f"{text}; rates are {_listed(rates)} rad/sqrt(s) off those that the camera sees"
        values[:3] = np.fmax(rates, values[:3]).tolist()
        across = _across(*seen)
        text = f"{text}; against the camera {across[0]:.3g} and {across[1]:.3g} m/sqrt(s) across the travel"
        used = _sample_densities(seen[0])
        values[4:] = [
            float(np.fmax(used[i].value, across[i - 4])) or measured[i].value or density[i] for i in (4, 5)
        ]
    if heave:
        period = float(np.median(np.diff(sequence.inertial_stamp)))
        values[5] = max(values[5], float(np.sqrt(period * np.mean(sequence.twist[:, 5] ** 2))))
    rounded = [float(f"{value:.2g}") for value in values]
    off = [i for i in known if i < 4 and not density[i] / 5.0 <= measured[i].value <= density[i] * 5.0]
    if off:
        listed = ", ".join(f"{measured[i].name} is configured as {density[i]:g}" for i in off)
        proposal = {"noise.twist_density": rounded}
        return Finding("inertial noise", "fault", f"{listed}, but {text}", measured, proposal=proposal)
    return Finding("inertial noise", "ok", text, measured, settings={"noise.twist_density": rounded})


def _sample_densities(sequence: Sequence) -> tuple[Measured, ...]:
    period = float(np.median(np.diff(sequence.inertial_stamp)))
    fourth = _noise_of_samples(sequence) * np.sqrt(period)
    names = [f"gyro density {a}" for a in _AXES] + [f"velocity density {a}" for a in _AXES]
    units = ["rad/sqrt(s)"] * 3 + ["m/sqrt(s)"] * 3
    return tuple(robust_sigma(fourth[:, i], name=names[i], unit=units[i]) for i in range(6))


def _rates(sequence: Sequence, steps: VisionSteps) -> Array:
    """White part of what rates are off those that the camera sees, less the fit's, as densities ``(3,)``.

    Samples can be far quieter than they are right: an instrument that smooths, or whose stamps jitter, has
    errors that fourth differences do not see. Tails count, as an estimator that takes the noise for Gaussian
    has none. NaN of too few steps.
    """
    means, _ = sequence.step_means()
    dt = np.diff(sequence.stamp, prepend=np.nan)[steps.frame]
    root = np.sqrt(dt)[:, None]
    off = ((means[steps.frame] - steps.twist) * root)[:, :3]
    change = np.diff(off, axis=0)[np.diff(steps.frame) == 1] / np.sqrt(2.0)
    if len(change) < _FEWEST_CHANGES:
        return np.full(3, np.nan)
    seen = np.array([_with_tails(change[:, i]) for i in range(3)])
    fit = np.median(steps.sigma[:, :3] * root, axis=0)
    return np.sqrt(np.maximum(seen**2 - fit**2, 0.0))


def _with_tails(values: Array) -> float:
    """Standard deviation of the core of a series and of the tails that are part of it."""
    values = values - np.median(values)
    sigma = 1.4826 * float(np.median(np.abs(values)))
    for _ in range(_GATINGS):
        inside = values[np.abs(values) <= _TAILS * sigma]
        sigma = float(np.sqrt(np.mean(inside**2))) if len(inside) else sigma
    return sigma


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


def _across(sequence: Sequence, steps: VisionSteps) -> Array:
    """White part of what the camera sees beside the recorded lateral and vertical velocity, as densities.

    The camera's own noise is in it.
    """
    means, _ = sequence.step_means()
    root = np.sqrt(np.diff(sequence.stamp, prepend=np.nan)[steps.frame])[:, None]
    difference = ((means[steps.frame] - steps.twist) * root)[:, 4:]
    change = np.diff(difference, axis=0)[np.diff(steps.frame) == 1]
    if len(change) < _FEWEST_CHANGES:
        return np.full(2, np.nan)
    return np.asarray(1.4826 * np.median(np.abs(change - np.median(change, axis=0)), axis=0) / np.sqrt(2.0))


def check_third_component(sequence: Sequence, steps: VisionSteps, repair: RepairConfig) -> Finding:
    """Whether the third velocity component is the body's own, as the camera sees it, or the vertical one.

    Parameters
    ----------
    sequence : Sequence
        The third component as recorded.
    """
    means, _ = sequence.step_means()
    recorded, seen = means[steps.frame, 5], steps.twist[:, 5]
    noise = float(sample_noise(sequence)[5])
    # A step averages two samples or more, which halves the variance of their noise.
    variance = float(np.var(recorded))
    reliable = max(0.0, 1.0 - 0.5 * noise**2 / variance) if variance > 0 else 0.0
    slope = _slope(recorded, seen, forward=means[steps.frame, 3], reliable=reliable)
    climbed = np.trapezoid(sequence.twist[:, 5], sequence.inertial_stamp)
    told = f"the camera sees {slope} of the third velocity component in the body's own z"
    counts = {"height_m": float(climbed), "reliable_share": reliable}
    levelled = repair.navigation_frame_velocity is not None
    if reliable < _RELIABLE or slope.sigma > 0.2:
        text = (
            f"body or navigation-frame velocity is undecided: {100 * (1 - reliable):.0f} % is noise, {told}"
        )
        return _third_unclear(sequence, text, (slope,), counts)
    if slope.value < 0.5:
        text = f"{told}: it is the vertical velocity, its integral gives {climbed:+.1f} m of height"
        if levelled:
            return Finding("third velocity component", "ok", text, (slope,), counts)
        proposal = {"data.repair.navigation_frame_velocity": True}
        return Finding("third velocity component", "fault", text, (slope,), counts, proposal)
    text = f"{told}: it is the body's own"
    if not levelled:
        return Finding("third velocity component", "ok", text, (slope,), counts)
    proposal = {"data.repair.navigation_frame_velocity": False}
    return Finding("third velocity component", "fault", text, (slope,), counts, proposal)


def third_component_unseen(sequence: Sequence) -> Finding:
    """Finding where the camera shows too little of its motion."""
    return _third_unclear(sequence, "not looked at: too few steps show the camera's motion", (), {})


def _third_unclear(
    sequence: Sequence, text: str, measured: tuple[Measured, ...], counts: dict[str, float]
) -> Finding:
    """Take the safe reading: a vehicle on the ground hardly moves along its own z, whatever is recorded."""
    path, check = "data.repair.navigation_frame_velocity", "third velocity component"
    velocity = sequence.twist[:, 3:]
    third = float(np.sqrt(np.mean(velocity[:, 2] ** 2)))
    speed = float(np.sqrt(np.mean(np.sum(velocity**2, axis=1))))
    if third > _ALONG * speed:
        share = f"{third:.2g} of {speed:.2g} m/s"
        reason = f"{text}; it is {share}, too much for a vehicle on the ground: as configured"
        return Finding(check, "unclear", reason, measured, counts, unknown={path: reason})
    reason = f"{text}; read as the vertical velocity, which is safe on the ground"
    return Finding(check, "unclear", reason, measured, counts, settings={path: True}, unknown={path: reason})


def _slope(recorded: Array, seen: Array, *, forward: Array, reliable: float) -> Measured:
    """Share of the recorded component that is seen, misalignment with the direction of travel taken out."""
    parts = np.array_split(np.arange(len(recorded)), _BLOCKS)

    def fit(rows: IntArray) -> float:
        columns = np.column_stack([recorded[rows], forward[rows], np.ones(len(rows))])
        weight = np.ones(len(rows))
        for _ in range(10):
            solution = np.linalg.lstsq(columns * weight[:, None], seen[rows] * weight, rcond=None)[0]
            residual = np.abs(seen[rows] - columns @ solution)
            weight = 1.0 / np.sqrt(np.maximum(residual, 1e-3 + 1.5 * np.median(residual)))
        return float(solution[0]) / max(reliable, 0.05)

    everything = np.arange(len(recorded))
    whole = fit(everything)
    left_out = np.array([fit(np.setdiff1d(everything, part)) for part in parts if len(part)])
    return Measured.around("share", "", whole, sigma=float(jackknife(left_out)))
