"""The camera's place in the body, by what turning adds to its velocity.

A camera at l in a body that turns at omega and moves at v moves at v + omega x l. Seen velocity and turn are
the camera's own; a scale of the velocity, a misalignment and a constant bias are fitted beside l.
"""

from dataclasses import replace

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import RigidFit
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.mounting import Candidate, extrinsic_setting, mounted

_CHECK = "lever arm"
_BLOCKS = 12
_FLOOR = 0.015
"""Share of the scene's depth by which l may be off: from afar a turn and a shift look alike."""
_CLEARLY = 12.25
"""Difference of squared Mahalanobis distances by which one reading must be nearer: 3.5 sigma."""
_ALIKE = 0.5
"""Readings this near to each other, in shares of the floor, need not be told apart."""
_ITERATIONS = 10
_RIDGE = 1e-6


def check_lever_arm(
    cut: Sequence, timed: Sequence, fits: dict[int, RigidFit], reading: Candidate
) -> tuple[Finding, Candidate]:
    """Whether the stored translation is the camera's place in the body or that of the inverse.

    Parameters
    ----------
    cut : Sequence
        Extrinsic as the file has it.
    timed : Sequence
        With the clock as it was found, that the fits are of.
    fits : dict of int to RigidFit
    reading : Candidate
        How the mounting is read so far.

    Returns
    -------
    Finding
    Candidate
        The reading with the translation that fits.
    """
    readings = {way: replace(reading, translation=way) for way in ("stored", "inverse")}
    places = {way: mounted(cut, item).rig.imu_T_cam[:3, 3] for way, item in readings.items()}
    points = timed.rig.back_project(timed.z)
    floor = _FLOOR * float(np.median(points[:, 2]))
    apart = float(np.linalg.norm(places["stored"] - places["inverse"]))
    if apart < _ALIKE * floor:
        return Finding(_CHECK, "ok", f"both readings of the translation agree to {apart:.2g} m"), reading
    lever, cov = _lever_arm(timed, fits)
    cov = cov + floor**2 * np.eye(3)
    sigma = np.sqrt(np.diagonal(cov))
    measured = tuple(
        Measured.around(f"camera's {axis}", "m", float(value), sigma=float(one))
        for axis, value, one in zip("xyz", lever, sigma, strict=True)
    )
    off = {way: float((lever - place) @ np.linalg.solve(cov, lever - place)) for way, place in places.items()}
    nearer = min(off, key=off.__getitem__)
    told = (
        f"{', '.join(str(item) for item in measured)}; the translation read as stored says "
        f"({_listed(places['stored'])}), as inverse ({_listed(places['inverse'])})"
    )
    if abs(off["stored"] - off["inverse"]) < _CLEARLY:
        text = f"the turns do not tell where the camera is: {told}"
        reason = f"its translation, stored or inverse: {told}; read as {reading.translation}"
        unknown = {"data.repair.extrinsic": reason}
        return Finding(_CHECK, "unclear", text, measured, unknown=unknown), reading
    if nearer == reading.translation:
        return Finding(_CHECK, "ok", f"as configured, {nearer}: {told}", measured), reading
    text = f"the translation is configured as {reading.translation}, the turns fit {nearer}: {told}"
    proposal = {"data.repair.extrinsic": extrinsic_setting(readings[nearer])}
    return Finding(_CHECK, "fault", text, measured, proposal=proposal), readings[nearer]


def _listed(place: Array) -> str:
    return ", ".join(f"{value:.2f}" for value in place)


def _lever_arm(sequence: Sequence, fits: dict[int, RigidFit]) -> tuple[Array, Array]:
    """Place of the camera ``(3,)`` in the body axes and its covariance by a jackknife over blocks."""
    frame = np.array(sorted(fits), dtype=np.int64)
    dt = np.diff(sequence.stamp, prepend=np.nan)[frame]
    motion = se3.inverse(np.array([fits[k].next_T_prev for k in frame]))
    camera = se3.log(motion) / dt[:, None]
    turn = sequence.rig.imu_T_cam[:3, :3]
    omega, seen = camera[:, :3] @ turn.T, camera[:, 3:] @ turn.T
    means, _ = sequence.step_means()
    velocity = means[frame, 3:]
    # Columns: lever arm, constant, and what goes along with the speed.
    speed = velocity[:, :1, None] * np.eye(3)
    columns = np.concatenate([so3.hat(omega), np.broadcast_to(np.eye(3), speed.shape), speed], axis=2)
    excess = seen - velocity

    everything = np.arange(len(frame))
    whole, information = _robust(columns, excess, everything)
    parts = [part for part in np.array_split(everything, _BLOCKS) if len(part)]
    left_out = np.array([_robust(columns, excess, np.setdiff1d(everything, part))[0] for part in parts])
    deviation = left_out - left_out.mean(axis=0)
    spread = (len(parts) - 1) / len(parts) * deviation.T @ deviation
    # What no turn shows is the same in every block: the fit's own covariance knows that it was not seen.
    return whole[:3], spread[:3, :3] + np.linalg.inv(information + _RIDGE * np.eye(9))[:3, :3]


def _robust(columns: Array, excess: Array, rows: IntArray) -> tuple[Array, Array]:
    """Solution ``(9,)`` of least squares that weigh large residuals down (Cauchy), and its information."""
    design, target = columns[rows].reshape(-1, 9), excess[rows].reshape(-1)
    weight, solution = np.ones(len(target)), np.zeros(9)
    for _ in range(_ITERATIONS):
        solution = np.asarray(
            np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)[0], float
        )
        residual = (target - design @ solution).reshape(-1, 3)
        scale = 1.5 * np.median(np.abs(residual), axis=0) + 1e-6
        weight = (1.0 / scale / np.sqrt(1.0 + (residual / (2.0 * scale)) ** 2)).reshape(-1)
    weighted = design * weight[:, None]
    return solution, weighted.T @ weighted
