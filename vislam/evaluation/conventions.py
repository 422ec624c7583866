"""Conventions of a trajectory that would fool its scores: noticed, said with the option, never applied.

Each is found by what it predicts: another order of the quaternion must make the attitudes fit, another clock
the positions, and so on. What is said is the error without and with it, on the data at hand.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.stamped import Stamped
from vislam.evaluation.alignment import align
from vislam.evaluation.clock import estimate_offset
from vislam.evaluation.matching import Paired
from vislam.evaluation.statistics import effective_errors
from vislam.geometry import se3, so3

_CLEARLY = 0.5
"""Share of the error that must be left at most for an offer of a clock, a scale or a lever arm ..."""
_ATTITUDES = 0.25
"""... and for one of the attitudes, whose candidates are few and far apart."""
_LEAST_TURN = np.deg2rad(1.0)
"""Spread of attitude errors below which nothing is to be mended, and least turn of a body [rad]."""
_LEAST_SHARE = 80.0
"""Share of rows matched below which it is said [%]."""
_LEAST_OFFSET = 0.1
"""Share of the median step of the sparser side below which a clock offset is none."""
_REACH = 0.75
_SURE = 5.0
"""Standard deviations of the world's rotation by the positions beyond which a turn is the body's."""
_SAME_SCALE = 0.02
_STILL = 1e-9
_ROUNDS = 20
_EXCITED = 1e-3
"""Smallest over largest eigenvalue of the normal matrix of a lever arm that can be told."""
_FEWEST = 10


def noticed(
    pairs: Paired, source: Stamped, own: Stamped, *, reference: Reference, scaled: bool
) -> tuple[str, ...]:
    """Lines on what would fool the scores of a matched trajectory.

    Parameters
    ----------
    pairs : Paired
    source, own : Stamped
        All rows of the reference and of the trajectory.
    reference : Reference
        For its name.
    scaled : bool
        Whether the scale is fitted already.
    """
    found = [*_matched(pairs), *_moment(pairs)]
    if len(pairs) >= _FEWEST:
        scale = [] if scaled else list(_scale(pairs))
        found += [*scale, *_clock(pairs, source, own)]
        # What the scale explains is no lever arm.
        found += _attitudes(_scaled(pairs) if scale else pairs, reference.name)
    return tuple(found)


def _matched(pairs: Paired) -> Iterator[str]:
    if pairs.share < _LEAST_SHARE:
        least = min(pairs.estimate_rows, pairs.reference_rows)
        yield (
            f"only {pairs.share:.0f} % of the rows are matched ({len(pairs)} of {least}): what is left out "
            "is not scored; --max-time-difference, --association or clock_offset=estimate may help"
        )


def _moment(pairs: Paired) -> Iterator[str]:
    """Error that comes from the difference of the stamps alone."""
    if pairs.interpolated or not pairs.estimate.timed or len(pairs) < _FEWEST:
        return
    speed = np.linalg.norm(np.gradient(pairs.reference.position, pairs.reference.stamp, axis=0), axis=1)
    caused = float(np.sqrt(np.mean((speed * pairs.apart) ** 2)))
    error = _rms(_residual(pairs))
    if caused > 0.25 * error and caused > 1e-3 * speed.max():
        yield (
            f"matched stamps are up to {1e3 * pairs.apart.max():.3g} ms apart, which at its speed is "
            f"{caused:.3g} m of the {error:.3g} m of error: --association interpolate"
        )


def _scaled(pairs: Paired) -> Paired:
    """The same with the positions of the trajectory at the scale that fits best."""
    target = pairs.reference.position
    turned = _residual(pairs) + target
    centred, wanted = turned - turned.mean(axis=0), target - target.mean(axis=0)
    scale = float(np.sum(centred * wanted)) / float(np.sum(centred**2))
    own = pairs.estimate
    pose = None
    if own.pose is not None:
        pose = se3.from_rotation_translation(own.pose[:, :3, :3], scale * own.position)
    return replace(pairs, estimate=replace(own, position=scale * own.position, pose=pose))


def _scale(pairs: Paired) -> Iterator[str]:
    rigid = _residual(pairs)
    target = pairs.reference.position
    turned = rigid + target
    centred, wanted = turned - turned.mean(axis=0), target - target.mean(axis=0)
    square = float(np.sum(centred**2))
    if square == 0.0:
        return
    scale = float(np.sum(centred * wanted)) / square
    left = _rms(scale * centred - wanted)
    if abs(scale - 1.0) > _SAME_SCALE and left < _CLEARLY * _rms(rigid) and scale > 0.0:
        yield (
            f"its scale is {1.0 / scale:.3g} of the reference's (error {_rms(rigid):.3g} m, with the scale "
            f"free {left:.3g} m): of a monocular system, alignment=sim3"
        )


def _clock(pairs: Paired, source: Stamped, own: Stamped) -> Iterator[str]:
    # A free scale keeps a monocular trajectory from hiding a clock that is off.
    found = estimate_offset(own, source, reach=_REACH, scaled=True)
    step = max(own.step, source.step)
    if found is None or not np.isfinite(found.before) or found.after > _CLEARLY * found.before:
        return
    if abs(found.value) > _LEAST_OFFSET * step and not found.low < 0.0 < found.high:
        late = "late" if found.value < 0.0 else "early"
        yield (
            f"its clock is {abs(found.value):.3g} s {late}: position error {found.before:.3g} m, "
            f"{found.after:.3g} m with clock_offset={found.value:.4f} "
            f"(95 %: {found.low:.4f} to {found.high:.4f})"
        )


def _attitudes(pairs: Paired, name: str) -> Iterator[str]:
    own, other = pairs.estimate.pose, pairs.reference.pose
    if own is None:
        yield "it has no attitudes: positions alone are scored"
        return
    if _all_same(own):
        yield "all its attitudes are the same, so it is scored as positions alone"
        return
    if other is None or _all_same(other):
        if other is not None:
            yield f"all attitudes of {name} are the same, so it is taken as positions alone"
        return
    yield from _quaternions(pairs, own, other)


def _quaternions(pairs: Paired, own: Array, other: Array) -> Iterator[str]:
    world = _world(pairs)
    turns = own[:, :3, :3]
    spread, body = _spread(world, turns, other[:, :3, :3])
    candidates = {
        "in the order wxyz: quaternion=wxyz (read as xyzw)": _reordered(turns),
        "conjugated, world to body: conjugated=true": turns.transpose(0, 2, 1),
        "in the order wxyz and conjugated: quaternion=wxyz conjugated=true": _reordered(turns).transpose(
            0, 2, 1
        ),
    }
    tried = {text: _spread(world, matrix, other[:, :3, :3])[0] for text, matrix in candidates.items()}
    text = min(tried, key=tried.__getitem__)
    if spread > _LEAST_TURN / 4 and tried[text] < _ATTITUDES * spread:
        yield (
            f"its quaternions look {text} (attitude spread {np.rad2deg(spread):.3g} deg as read, "
            f"{np.rad2deg(tried[text]):.3g} deg so)"
        )
        return
    yield from _inverse(pairs, own)
    yield from _body(pairs, own, other, body, spread)


def _inverse(pairs: Paired, own: Array) -> Iterator[str]:
    turned = se3.inverse(own)
    swapped = replace(pairs, estimate=replace(pairs.estimate, pose=turned, position=turned[:, :3, 3]))
    as_is, inverted = _rms(_residual(pairs)), _rms(_residual(swapped))
    if inverted < _ATTITUDES * as_is:
        yield (
            f"its poses look inverted, world to body (position error {as_is:.3g} m as read, {inverted:.3g} m "
            "inverted): inverted=true"
        )


def _body(pairs: Paired, own: Array, other: Array, body: Array, spread: float) -> Iterator[str]:
    """Say where its body sits on the reference's, by hand-eye calibration with the attitudes of both."""
    angle = float(np.linalg.norm(so3.log(body)))
    if angle > _LEAST_TURN and angle > 3.0 * spread and angle > _SURE * _world_sigma(pairs):
        arm, before, after, excited = _lever_arm(pairs, own)
        arm = arm if excited and after < _CLEARLY * before else np.zeros(3)
        yield (
            f"its body frame is turned by {np.rad2deg(angle):.1f} deg against the reference's: "
            f"{_offer(arm, body)}"
        )
        return
    arm, before, after, excited = _lever_arm(pairs, own)
    length = float(np.linalg.norm(arm))
    if excited and after < _CLEARLY * before and length > 3.0 * after:
        yield (
            f"its point is {length:.3g} m from the reference's (position error {before:.3g} m, {after:.3g} m "
            f"with it): {_offer(arm, np.eye(3))}"
        )


def _offer(arm: Array, body: Array) -> str:
    quaternion = Rotation.from_matrix(body).as_quat()
    values = ", ".join(f"{value:.5g}" for value in (*arm, *quaternion))
    return f"body_T_point: [{values}]"


def _lever_arm(pairs: Paired, own: Array) -> tuple[Array, float, float, bool]:
    """Place of the reference's point in the body, the error without and with it [m], whether it can be told.

    Alternating least squares of the world's motion and of the arm: both are linear given the other.
    """
    target = pairs.reference.position
    size = target.shape[1]
    before = _rms(_residual(pairs))
    arm = np.zeros(3)
    turns = own[:, :3, :3]
    centred = turns - turns.mean(axis=0)
    normal = np.einsum("nij,nik->jk", centred, centred) / len(own)
    values = np.linalg.eigvalsh(normal)
    after = before
    for _ in range(_ROUNDS):
        point = own[:, :3, 3] + turns @ arm
        rotation, translation = align(point[:, :size], target)
        if size == 2:
            break
        # target = A (p + R arm) + t, centred over the rows.
        wanted = (target - translation) @ rotation - own[:, :3, 3]
        arm = np.linalg.lstsq(centred.reshape(-1, 3), (wanted - wanted.mean(axis=0)).reshape(-1), rcond=1e-9)[
            0
        ]
        point = own[:, :3, 3] + turns @ arm
        rotation, translation = align(point, target)
        after = _rms(point @ rotation.T + translation - target)
    return arm, before, after, bool(values[0] > _EXCITED)


def _world(pairs: Paired) -> Array:
    """Rotation of the trajectory's world to the reference's, by the positions."""
    target = pairs.reference.position
    rotation = align(pairs.estimate.position[:, : target.shape[1]], target)[0]
    full = np.eye(3)
    full[: len(rotation), : len(rotation)] = rotation
    return full


def _world_sigma(pairs: Paired) -> float:
    """Standard deviation of that rotation about the axis along which the positions say least of it [rad]."""
    residual = _residual(pairs)
    centred = pairs.reference.position - pairs.reference.position.mean(axis=0)
    centred = np.column_stack([centred, np.zeros((len(centred), 3 - centred.shape[1]))])
    cross = so3.hat(centred)
    information = np.linalg.eigvalsh(np.einsum("nij,nik->jk", cross, cross))[0]
    if information <= 0.0:
        return float("inf")
    variance = float(np.mean(residual**2)) * len(residual) / effective_errors(residual)
    return float(np.sqrt(variance / information))


def _spread(world: Array, turns: Array, target: Array) -> tuple[float, Array]:
    """RMS of the attitude errors about their mean [rad], and that mean: the turn between the two bodies."""
    apart = (world @ turns).transpose(0, 2, 1) @ target
    mean = Rotation.from_matrix(apart).mean().as_matrix()
    return _rms(so3.log(mean.T @ apart)), mean


def _reordered(turns: Array) -> Array:
    """Rotations of the same four numbers in the order w x y z."""
    quaternion = Rotation.from_matrix(turns).as_quat()
    found: Array = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix()
    return found


def _residual(pairs: Paired) -> Array:
    """Position errors after rigid alignment, ``(m, d)`` [m]."""
    target = pairs.reference.position
    own = pairs.estimate.position[:, : target.shape[1]]
    rotation, translation = align(own, target)
    return np.asarray(own @ rotation.T + translation - target)


def _all_same(pose: Array) -> bool:
    return bool(np.abs(pose[:, :3, :3] - pose[0, :3, :3]).max() <= _STILL)


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
