"""Which tracks follow the rigid motion of the rest from one frame to the next."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.core.rigid_fit import FEWEST, RigidFit, fit_rigid
from vislam.frontend.settings import FrontEndConfig
from vislam.geometry import se3
from vislam.models import StereoRig

_FLOOR_PX, _SHARE = 0.1, 0.02
"""Spread of a step: floor plus share of the disparity [px]; only its shape matters."""
_DRAWS = 100
_AGREE_PX = 3.0
"""Reprojection within which a track agrees with a drawn motion [px]."""
_ENOUGH = 0.6
"""Share of agreeing tracks at which the predicted motion needs no draws."""


@dataclass(frozen=True)
class Agreement:
    """What the tracks agree on.

    Attributes
    ----------
    next_T_prev : (4, 4)
        Motion of the rectified left camera.
    keeps : (n,)
        Which tracks follow it.
    """

    next_T_prev: Array
    keeps: BoolArray


def agree(
    rig: StereoRig,
    before: Array,
    after: Array,
    *,
    guess: Array,
    config: FrontEndConfig,
    rng: np.random.Generator,
) -> Agreement | None:
    """Fit the motion that most tracks follow; None if there are too few for one.

    The fit starts from the guess, or, if that leaves too many tracks off, from the best of motions by three
    tracks each (Fischler and Bolles 1981; Kabsch 1976 for the motion).

    Parameters
    ----------
    rig : StereoRig
    before, after : (n, 3)
        Measurements (uL, uR, v) of the tracks in both frames, disparities above zero [px].
    guess : (4, 4)
        Motion of the camera as predicted.
    config : FrontEndConfig
    rng : Generator
    """
    if len(before) < FEWEST:
        return None
    points = rig.back_project(before)
    spread = np.repeat(_FLOOR_PX + _SHARE * (before[:, :1] - before[:, 1:2]), 3, axis=1)
    fit = fit_rigid(rig, points, after, spread=spread, guess=guess)
    if _agreeing(rig, fit.next_T_prev, points, after) < _ENOUGH * len(points):
        start = _drawn(rig, points, after, rng=rng)
        if _agreeing(rig, start, points, after) > _agreeing(rig, fit.next_T_prev, points, after):
            fit = fit_rigid(rig, points, after, spread=spread, guess=start)
    return Agreement(fit.next_T_prev, _followers(fit, config))


def _followers(fit: RigidFit, config: FrontEndConfig) -> BoolArray:
    """Tracks near the fitted motion, in its own spread or in pixels."""
    off = np.linalg.norm(fit.residual, axis=1)
    off_px = np.linalg.norm(fit.residual * fit.spread, axis=1)
    return np.asarray((off <= config.consensus) | (off_px <= config.consensus_px))


def _agreeing(rig: StereoRig, next_T_prev: Array, points: Array, after: Array) -> int:
    return int(np.sum(_near(rig, next_T_prev[None], points, after)))


def _near(rig: StereoRig, next_T_prev: Array, points: Array, after: Array) -> BoolArray:
    """Mask ``(k, n)`` of the tracks that agree with each of motions ``(k, 4, 4)``."""
    moved = np.einsum("kij,nj->kni", next_T_prev[:, :3, :3], points) + next_T_prev[:, None, :3, 3]
    ahead = moved[..., 2] > rig.nearest * 0.1
    moved[..., 2] = np.where(ahead, moved[..., 2], 1.0)
    off = np.abs(rig.project(moved) - after).max(axis=-1)
    return np.asarray(ahead & (off < _AGREE_PX))


def _drawn(rig: StereoRig, points: Array, after: Array, *, rng: np.random.Generator) -> Array:
    """Best of motions by three tracks each, ``(4, 4)``."""
    chosen = np.argpartition(rng.random((_DRAWS, len(points))), 2, axis=1)[:, :3]
    motions = _kabsch(points[chosen], rig.back_project(after)[chosen])
    return np.asarray(motions[int(np.argmax(_near(rig, motions, points, after).sum(axis=1)))])


def _kabsch(one: Array, other: Array) -> Array:
    """Rigid motions ``(k, 4, 4)`` that take points ``(k, m, 3)`` onto others, least squares."""
    mean, mean_other = one.mean(axis=1), other.mean(axis=1)
    cross = np.einsum("kmi,kmj->kij", other - mean_other[:, None], one - mean[:, None])
    u, _, vt = np.linalg.svd(cross)
    proper = np.repeat(np.eye(3)[None], len(one), axis=0)
    proper[:, 2, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = u @ proper @ vt
    return se3.from_rotation_translation(rotation, mean_other - (rotation @ mean[..., None])[..., 0])
