"""Pictures of textured planes along a path, of which every track is known exactly.

Every pixel is the texture where its own ray meets the nearest plane, so lens, baseline and pose are exact;
the textures are smooth, so that a pixel is wide enough a sample of them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from vislam.base.types import Array, IntArray
from vislam.geometry import se3
from vislam.models.camera import Camera
from vislam.models.stereo_pair import StereoPair

_TEXELS = 256
_OCTAVES = (1.0, 3.0, 8.0)
"""Standard deviations of the filters that make the texture of white noise [texels]: seen near and far, it has
something of a pixel's size."""
_CONTRAST, _GREY = 45.0, 128.0
_NEAREST = 1e-3
_TEXEL = 0.016
"""Size of a texel, as a share of half the width of a street."""


@dataclass(frozen=True)
class TexturedPlane:
    """A plane without end, with a texture that repeats.

    Attributes
    ----------
    origin : (3,)
        A point of it, in the world [m].
    across, along : (3,)
        Unit vectors in it, perpendicular to each other.
    texel : float
        Size of a texel [m].
    texture : (n, n)
        Grey values.
    """

    origin: Array
    across: Array
    along: Array
    texel: float
    texture: Array

    def distance(self, origin: Array, rays: Array) -> Array:
        """Distance ``(n,)`` from a point along rays ``(n, 3)``, in ray lengths, infinite if none."""
        normal = np.cross(self.across, self.along)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.origin - origin) @ normal) / (rays @ normal)
        return np.where(distance > _NEAREST, distance, np.inf)

    def grey(self, points: Array) -> Array:
        """Grey values ``(n,)`` at points ``(n, 3)`` of the plane."""
        place = (points - self.origin) @ np.column_stack([self.along, self.across]) / self.texel
        return np.asarray(map_coordinates(self.texture, place.T, order=1, mode="grid-wrap"))


def textured(
    origin: Array, across: Array, along: Array, *, texel: float, rng: np.random.Generator
) -> TexturedPlane:
    """Plane with a texture of smooth noise."""
    noise = np.zeros((_TEXELS, _TEXELS))
    for sigma in _OCTAVES:
        octave = gaussian_filter(rng.normal(size=noise.shape), sigma, mode="wrap")
        noise += octave / octave.std()
    return TexturedPlane(origin, across, along, texel, _GREY + _CONTRAST * noise / noise.std())


def street(*, half_width: float, camera_height: float, length: float, seed: int) -> tuple[TexturedPlane, ...]:
    """Ground, two walls and an end along x, with the body at the origin [m]."""
    rng = np.random.default_rng(seed)
    x, y, z = np.eye(3)
    texel = _TEXEL * half_width
    ground = textured(-camera_height * z, x, y, texel=texel, rng=rng)
    walls = [textured(side * half_width * y, x, z, texel=texel, rng=rng) for side in (-1.0, 1.0)]
    return (ground, *walls, textured(length * x, y, z, texel=texel, rng=rng))


@dataclass(frozen=True)
class Studio:
    """Planes and the cameras that look at them.

    Attributes
    ----------
    planes : tuple of TexturedPlane
    pair : StereoPair
    """

    planes: tuple[TexturedPlane, ...]
    pair: StereoPair

    def pictures(self, world_T_imu: Array) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Left and right picture from a pose ``(4, 4)``."""
        left, right = (self._picture(world_T_imu, side) for side in (0, 1))
        return left, right

    def points(self, world_T_imu: Array, pixels: Array) -> Array:
        """Points ``(n, 3)`` in the world [m] that pixels ``(n, 2)`` of the left picture show."""
        origin, rays = self._rays(world_T_imu, 0, self.pair.left.undistort(pixels))
        distance, _ = self._nearest(origin, rays)
        return np.asarray(origin + distance[:, None] * rays)

    def pixels(self, world_T_imu: Array, points: Array) -> tuple[Array, Array]:
        """Pixels ``(n, 2)`` of points ``(n, 3)`` of the world in the left and in the right picture."""
        pair = self.pair
        inside = se3.transform(pair.rig.cam_T_imu @ se3.inverse(world_T_imu), points)
        z = pair.rig.project(inside)
        return pair.raw_left(z[:, [0, 2]]), pair.raw_right(z[:, [1, 2]])

    @cached_property
    def _grids(self) -> tuple[Array, Array]:
        """Points on the normalised image plane of all pixels of the left and of the right camera."""
        left, right = (self._grid(side) for side in (0, 1))
        return left, right

    def _grid(self, side: int) -> Array:
        camera = self._camera(side)
        rows, columns = np.mgrid[: camera.height, : camera.width]
        return camera.undistort(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))

    def _picture(self, world_T_imu: Array, side: int) -> NDArray[np.uint8]:
        camera = self._camera(side)
        origin, rays = self._rays(world_T_imu, side, self._grids[side])
        distance, nearest = self._nearest(origin, rays)
        grey = np.full(len(rays), _GREY)
        for index, plane in enumerate(self.planes):
            seen = (nearest == index) & np.isfinite(distance)
            grey[seen] = plane.grey(origin + distance[seen, None] * rays[seen])
        return np.clip(np.rint(grey), 0, 255).astype(np.uint8).reshape(camera.height, camera.width)

    def _camera(self, side: int) -> Camera:
        return (self.pair.left, self.pair.right)[side]

    def _rays(self, world_T_imu: Array, side: int, normalised: Array) -> tuple[Array, Array]:
        """Centre of a camera ``(3,)`` and rays ``(n, 3)`` in the world of normalised points ``(n, 2)``."""
        pair = self.pair
        turn = (pair.rect_R_left, pair.rect_R_right)[side]
        ahead = np.column_stack([normalised, np.ones(len(normalised))])
        world_T_rect = world_T_imu @ pair.rig.imu_T_cam
        centre = se3.transform(world_T_rect, np.array([[side * pair.rig.baseline, 0.0, 0.0]]))[0]
        return centre, np.asarray(ahead @ turn.T @ world_T_rect[:3, :3].T)

    def _nearest(self, origin: Array, rays: Array) -> tuple[Array, IntArray]:
        """Distance of the nearest plane along each ray, in ray lengths, and which it is, ``(n,)`` each."""
        distances = np.array([plane.distance(origin, rays) for plane in self.planes])
        nearest = np.argmin(distances, axis=0)
        return distances[nearest, np.arange(len(rays))], nearest
