"""The normal equations of a whole drive, factorised: one Gauss-Newton step, and all marginals in one pass.

Landmarks of short tracks are eliminated first (:mod:`vislam.estimators.smoother.schur`), all else front by
front from the newest frame to the first (:mod:`vislam.estimators.smoother.frontal`). A landmark that is seen
for long would tie as many poses, of six columns each; it stays in the front for as long as it is seen, with
three.
"""

from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from scipy import sparse

from vislam.base.types import Array, IntArray
from vislam.estimators.smoother.frontal import Factorisation
from vislam.estimators.smoother.layout import Layout, Variables
from vislam.estimators.smoother.observations import Linearised, Observations
from vislam.estimators.smoother.schur import Eliminated, Groups


@dataclass(frozen=True)
class Marginals:
    """Covariances of poses ``(T, 6, 6)`` and landmarks ``(n, 3, 3)``.

    Attributes
    ----------
    poses, points
    poses_shared, points_shared : (T, 6, m), (n, 3, m)
        Those with some variables of the first frame.
    shared : (m, m)
        Of the latter.
    """

    poses: Array
    points: Array
    poses_shared: Array
    points_shared: Array
    shared: Array


@dataclass(frozen=True)
class Structure:
    """All of the normal equations of a drive that is the same at each estimate.

    Parameters
    ----------
    variables : Variables
        Of all factors but the stereo ones.
    seen : Observations
    frames, landmarks : int
    """

    variables: Variables
    seen: Observations
    frames: int
    landmarks: int

    @cached_property
    def layout(self) -> Layout:
        """Order of elimination."""
        return Layout(self.variables, self.seen, frames=self.frames, landmarks=self.landmarks)

    @cached_property
    def groups(self) -> Groups:
        """Landmarks that are eliminated first."""
        layout = self.layout
        return Groups(self.seen, layout.pose[self.seen.frame], layout.group, layout.fronts)

    @cached_property
    def by_frame(self) -> tuple[IntArray, IntArray]:
        """Observations ``(n,)`` frame after frame, and the ends ``(T + 1,)`` of the frames in these."""
        order = np.argsort(self.seen.frame, kind="stable")
        return order, np.searchsorted(self.seen.frame[order], np.arange(self.frames + 1))

    @cached_property
    def by_landmark(self) -> tuple[IntArray, IntArray]:
        """Landmarks that are observed, and where the observations of each begin."""
        return np.unique(self.seen.landmark, return_index=True)

    @cached_property
    def poses(self) -> "Blocks":
        """Poses by the front that eliminates them."""
        return Blocks.of(self.layout.front_of_pose, self.layout.fronts)

    @cached_property
    def points(self) -> "Blocks":
        """Landmarks of long tracks by the front that eliminates them."""
        return Blocks.of(self.layout.front_of_point, self.layout.fronts)

    @cached_property
    def across(self) -> "Blocks":
        """Observations of long tracks by the front that eliminates pose or landmark first."""
        layout, seen = self.layout, self.seen
        first = np.minimum(layout.front_of_pose[seen.frame], layout.front_of_point[seen.landmark])
        return Blocks.of(first, layout.fronts)


@dataclass(frozen=True)
class Blocks:
    """Some items in the order of the fronts that they belong to.

    Attributes
    ----------
    items : (n,)
    ends : (fronts + 1,)
        Those of front i are from ``ends[i]`` to ``ends[i + 1]``.
    """

    items: IntArray
    ends: IntArray

    @classmethod
    def of(cls, front: IntArray, fronts: int) -> "Blocks":
        """Items ``(m,)`` by their fronts; -1 for one that belongs to none."""
        order = np.argsort(front, kind="stable")
        items = order[np.searchsorted(front[order], 0) :]
        return cls(items, np.searchsorted(front[items], np.arange(fronts + 1)))

    def rows(self, front: int) -> slice:
        """Places of a front's items."""
        return slice(self.ends[front], self.ends[front + 1])


class NormalEquations:
    """Normal equations of a drive, linearised at an estimate.

    Parameters
    ----------
    structure : Structure
    linear : gtsam.GaussianFactorGraph
        All factors but the stereo ones.
    found : Linearised
        The observations.
    """

    def __init__(self, structure: Structure, linear: gtsam.GaussianFactorGraph, found: Linearised) -> None:
        self.structure, self.found = structure, found
        layout, residual = structure.layout, found.residual
        self.information, self.right = _others(linear, layout)
        order, ends = structure.by_frame
        self.of_pose, of_pose = np.empty((structure.frames, 6, 6)), np.empty((structure.frames, 6))
        by_pose, ordered = found.by_pose[order].reshape(-1, 6), residual[order].ravel()
        for k in range(structure.frames):
            own = slice(3 * ends[k], 3 * ends[k + 1])
            self.of_pose[k], of_pose[k] = by_pose[own].T @ by_pose[own], ordered[own] @ by_pose[own]
        self.right[layout.pose] -= of_pose
        self.of_point = np.zeros((structure.landmarks, 3, 3))
        self.right_of_point = np.zeros((structure.landmarks, 3))
        which, begins = structure.by_landmark
        turned = found.by_point.transpose(0, 2, 1)
        if len(which):
            self.of_point[which] = np.add.reduceat(turned @ found.by_point, begins)
            self.right_of_point[which] = -np.add.reduceat((turned @ residual[:, :, None])[:, :, 0], begins)
        self.right[layout.point[layout.long]] = self.right_of_point[layout.long]
        rows = structure.across.items
        self.across = found.by_pose[rows].transpose(0, 2, 1) @ found.by_point[rows]

    def factorised(self, damping: float = 0.0) -> "DriveSystem":
        """Factorise them, with a damping on the diagonal of all variables.

        Raises
        ------
        numpy.linalg.LinAlgError
            If they are not positive definite.
        """
        return DriveSystem(self, damping)

    def fall(self, states: Array, points: Array, damping: float) -> float:
        """What a damped step takes off the linearised cost, ``(b^T d + lambda d^T d) / 2``."""
        right = self.right[self.structure.layout.state] @ states + np.vdot(self.right_of_point, points)
        return 0.5 * float(right + damping * (states @ states + np.vdot(points, points)))


class DriveSystem:
    """Normal equations of a drive, factorised.

    Parameters
    ----------
    equations : NormalEquations
    damping : float
        Is added to the diagonal of all variables.

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not positive definite.
    """

    def __init__(self, equations: NormalEquations, damping: float = 0.0) -> None:
        self._equations, self._damping = equations, damping
        self._layout = layout = equations.structure.layout
        own = equations.of_point + damping * np.eye(3)
        self._short = Eliminated(equations.structure.groups, equations.found, own, equations.right_of_point)
        self._factorisation = Factorisation(layout.begin, layout.ends, self._assemble)

    def step(self) -> tuple[Array, Array]:
        """Step ``(n,)`` of all columns of the variables, and ``(m, 3)`` of the landmarks."""
        step = self._factorisation.solve()
        points = step[self._layout.point]
        points[self._equations.structure.groups.landmarks] = self._short.solution(step)
        return step[self._layout.state], points

    def marginals(self) -> Marginals:
        """Covariances of all poses and landmarks, and those with the first pose."""
        structure, layout = self._equations.structure, self._layout
        frames, landmarks, groups = structure.frames, structure.landmarks, structure.groups
        poses, points = np.empty((frames, 6, 6)), np.empty((landmarks, 3, 3))
        poses_first, points_first = np.empty((frames, 6, 6)), np.empty((landmarks, 3, 6))
        for number, place, sigma in self._factorisation.covariances():
            with_first = sigma[:, place[layout.pose[0]]]
            which = structure.poses.items[structure.poses.rows(number)]
            at = place[layout.pose[which]]
            poses[which], poses_first[which] = sigma[at[:, :, None], at[:, None]], with_first[at]
            which = structure.points.items[structure.points.rows(number)]
            at = place[layout.point[which]]
            points[which], points_first[which] = sigma[at[:, :, None], at[:, None]], with_first[at]
            columns, tall, _ = self._short.complement(number)
            at, which = place[columns], groups.landmarks[groups.of_group(number)]
            points[which] = self._short.covariances(number, tall, sigma[np.ix_(at, at)])
            points_first[which] = self._short.cross_covariances(number, tall, with_first[at])
        return Marginals(poses, points, poses_first, points_first, poses[0])

    def _assemble(self, number: int, place: IntArray, matrix: Array, vector: Array) -> None:
        """Add to a front what ties the columns that are eliminated in it, less what was eliminated before."""
        equations, layout, structure = self._equations, self._layout, self._equations.structure
        begin, end = layout.ends[number], layout.ends[number + 1]
        own = slice(len(vector) - (end - begin), len(vector))
        information = equations.information
        pointer = information.indptr[begin : end + 1]
        entries = slice(pointer[0], pointer[-1])
        row, column = information.indices[entries], np.repeat(np.arange(begin, end), np.diff(pointer))
        open_ = row >= begin
        matrix[place[column[open_]], place[row[open_]]] += information.data[entries][open_]
        for blocks, columns, values in (
            (structure.poses, layout.pose, equations.of_pose),
            (structure.points, layout.point, equations.of_point),
        ):
            which = blocks.items[blocks.rows(number)]
            at = place[columns[which]]
            matrix[at[:, :, None], at[:, None]] += values[which]
        rows = structure.across.rows(number)
        which = structure.across.items[rows]
        pose = place[layout.pose[structure.seen.frame[which]]][:, :, None]
        point = place[layout.point[structure.seen.landmark[which]]][:, None]
        matrix[np.maximum(pose, point), np.minimum(pose, point)] += equations.across[rows]
        matrix[np.arange(own.start, own.stop), np.arange(own.start, own.stop)] += self._damping
        vector[own] += equations.right[begin:end]
        tied, tall, known = self._short.complement(number)
        at = place[tied]
        matrix[at[:, None], at] -= tall @ tall.T
        vector[at] -= tall @ known


def _others(linear: gtsam.GaussianFactorGraph, layout: Layout) -> tuple[sparse.csr_array, Array]:
    """Information and right-hand side of all factors but the stereo ones, in the order of elimination."""
    row, column, entry = linear.sparseJacobian_()
    row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    of_right = column == len(layout.state)
    right = np.zeros(int(row.max()) + 1)
    right[row[of_right]] = entry[of_right]
    row, column, entry = row[~of_right], layout.state[column[~of_right]], entry[~of_right]
    jacobian = sparse.csr_array((entry, (row, column)), shape=(len(right), len(layout.begin)))
    turned = jacobian.T.tocsr()
    return turned @ jacobian, turned @ right
