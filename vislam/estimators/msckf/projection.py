"""Tracks as constraints between the poses that saw them, their landmarks eliminated.

Of a track with whitened residuals r of its V observations, linear in the error x of the poses and f of the
landmark,

    r = H_x x + H_f f + n,    n ~ N(0, 1),

Householder reflections Q bring H_f to triangular form. Their last ``3 V - 3`` rows see no landmark,

    r_o = H_o x + n_o,    n_o ~ N(0, 1),

which is the projection onto the left null space of H_f (Mourikis and Roumeliotis, ICRA 2007, eqs. 23 and 24).
The same is left of the track when its landmark is marginalised with a prior of no information.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.estimators.ekf.measurement import Camera
from vislam.estimators.msckf.pending import Packed
from vislam.estimators.msckf.window import Window
from vislam.geometry import se3, so3
from vislam.models import StereoRig
from vislam.models.triangulation import triangulate

POINT = 3
"""Size of a landmark."""


@dataclass(frozen=True)
class Constraints:
    """Linearised tracks, all observations whitened; rows of observations that are not there are 0.

    Attributes
    ----------
    by_point : (n, 3V, 3)
        H_f.
    by_state : (n, 3V, d)
        H_x.
    residual : (n, 3V)
        r.
    points_world : (n, 3)
        Where the landmarks are linearised [m].
    solved : (n,)
        Which tracks have a landmark in front of all their cameras; the others' numbers have no meaning.
    """

    by_point: Array
    by_state: Array
    residual: Array
    points_world: Array
    solved: BoolArray

    def part(self, mask: BoolArray) -> "Constraints":
        """Those tracks that a mask ``(n,)`` has."""
        return Constraints(
            self.by_point[mask],
            self.by_state[mask],
            self.residual[mask],
            self.points_world[mask],
            self.solved[mask],
        )


@dataclass(frozen=True)
class Projected:
    """Tracks after the reflections: the first three rows of each determine its landmark, the rest poses.

    Attributes
    ----------
    by_state : (n, 3V, d)
        ``Q^T H_x``.
    residual : (n, 3V)
        ``Q^T r``.
    reflectors : (3, n, 3V)
        Unit vectors v of the reflections ``1 - 2 v v^T``, in the order in which they were taken.
    """

    by_state: Array
    residual: Array
    reflectors: Array

    def distances(self, cov: Array) -> Array:
        """Squared Mahalanobis distance ``(n,)`` of each r_o, the state having a covariance ``(d, d)``."""
        h, r = self.by_state[:, POINT:], self.residual[:, POINT:]
        spread = h @ cov @ h.transpose(0, 2, 1)
        spread += np.eye(spread.shape[1])
        return np.einsum("ni,ni->n", r, np.linalg.solve(spread, r[:, :, None])[:, :, 0])

    def stacked(self) -> tuple[Array, Array, float]:
        """Rows without landmarks of all tracks, compressed (Mourikis and Roumeliotis, eqs. 27 to 29).

        Returns
        -------
        by_state : (m, d)
            At most as many rows as the state has.
        residual : (m,)
        rest : float
            Squared norm of what of the residuals no state can explain.
        """
        h = self.by_state[:, POINT:].reshape(-1, self.by_state.shape[2])
        r = self.residual[:, POINT:].reshape(-1)
        size = h.shape[1]
        if len(h) <= size:
            return h, r, 0.0
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack([h, r]), mode="r"))
        return triangle[:size, :size], triangle[:size, size], float(triangle[size, size] ** 2)

    def smoothed_residuals(self, error: Array) -> Array:
        """Residuals ``(n, 3V)`` given the state's error ``(d,)``, and the landmarks that fit best then."""
        left = self.residual - self.by_state @ error
        left[:, :POINT] = 0.0
        for v in self.reflectors[::-1]:
            left -= 2.0 * np.einsum("ni,ni->n", v, left)[:, None] * v
        return left


def linearise(camera: Camera, window: Window, tracks: Packed) -> Constraints:
    """Triangulate tracks at the current poses and linearise their observations there, or at the first ones.

    The landmark is not part of the state, so its estimate is the same for residuals and Jacobians. Errors
    that all tracks share are taken as they are now: that they walk is neglected over the length of a track.
    """
    place = np.searchsorted(window.frames, tracks.frame)
    errors = camera.errors(window.nav)
    rig = camera.actual(errors)
    z = tracks.z - errors.offset
    # Where there is none, triangulation needs a depth all the same; nothing is made of it.
    solved = z[:, 0, 0] > z[:, 0, 1]
    z[~solved, 0, 1] = z[~solved, 0, 0] - 1.0
    world_T_cam = window.poses @ rig.imu_T_cam
    found = triangulate(rig, world_T_cam[place], z, tracks.sigma)
    solved &= found.solved
    mean = np.where(solved[:, None], found.mean, z[:, 0])
    points = se3.transform(world_T_cam[place[:, 0]], rig.back_project(mean)[:, None])[:, 0]
    by_pose, by_point, depth = jacobians(rig, window.linearised_at[place], points)
    by_state = _spread(by_pose, place, window)
    camera.add_rotation(by_state, errors, by_pose)
    shared = errors.by_pixel_errors(tracks.z - found.residual, camera.rig, window.layout)
    for name, columns in shared.items():
        by_state[..., window.layout[name]] = columns
    solved &= np.all((depth > rig.nearest) | ~tracks.seen, axis=1)
    weight = np.where(tracks.seen[:, :, None], 1.0 / tracks.sigma, 0.0)
    return Constraints(
        by_point=_flat(by_point * weight[..., None]),
        by_state=_flat(by_state * weight[..., None]),
        residual=_flat(found.residual * weight),
        points_world=points,
        solved=solved,
    )


def jacobians(rig: StereoRig, world_T_imu: Array, points_world: Array) -> tuple[Array, Array, Array]:
    """Derivatives of observations (uL, uR, v) of points ``(n, 3)`` [m] from poses ``(n, V, 4, 4)``.

    Returns
    -------
    by_pose : (n, V, 3, 6)
        With respect to (omega, v) on the right of the pose.
    by_point : (n, V, 3, 3)
    depth : (n, V)
        In the left camera [m]; one below ``rig.nearest`` is taken for that in the derivatives.
    """
    imu_T_world = se3.inverse(world_T_imu)
    in_imu = se3.transform(imu_T_world, points_world[:, None, None])[:, :, 0]
    in_cam = se3.transform(rig.cam_T_imu, in_imu)
    depth = in_cam[..., 2].copy()
    in_cam[..., 2] = np.maximum(depth, rig.nearest)
    by_imu = rig.projection_jacobian(in_cam) @ rig.cam_T_imu[:3, :3]
    by_pose = np.concatenate([by_imu @ so3.hat(in_imu), -by_imu], axis=-1)
    return by_pose, by_imu @ imu_T_world[..., :3, :3], depth


def eliminate(constraints: Constraints, weight: Array) -> Projected:
    """Eliminate the landmarks, each observation being weighted by ``weight (n, V)``."""
    root = np.repeat(np.sqrt(weight), 3, axis=1)
    d = constraints.by_state.shape[2]
    joint = np.concatenate(
        [constraints.by_point, constraints.by_state, constraints.residual[:, :, None]], axis=2
    )
    joint *= root[:, :, None]
    reflectors = np.zeros((POINT, *root.shape))
    for column in range(POINT):
        v = reflectors[column]
        v[:, column:] = joint[:, column:, column]
        v[:, column] += np.copysign(np.linalg.norm(v, axis=1), v[:, column])
        v /= np.maximum(np.linalg.norm(v, axis=1), np.finfo(np.float64).tiny)[:, None]
        joint -= (2.0 * v)[:, :, None] * (v[:, None] @ joint)
    return Projected(joint[:, :, POINT : POINT + d], joint[:, :, POINT + d], reflectors)


def _spread(by_pose: Array, place: IntArray, window: Window) -> Array:
    """Jacobians ``(n, V, 3, d)`` by the state of those ``(n, V, 3, 6)`` by the poses at some places."""
    n, views = place.shape
    out = np.zeros((n, views, 3, len(window.cov)))
    columns = window.columns[place][:, :, None, None] + np.arange(6)
    np.put_along_axis(out, np.broadcast_to(columns, by_pose.shape), by_pose, axis=3)
    return out


def _flat(rows: Array) -> Array:
    """One row a number: ``(n, V, 3, ...)`` to ``(n, 3V, ...)``."""
    return rows.reshape(len(rows), rows.shape[1] * rows.shape[2], *rows.shape[3:])
