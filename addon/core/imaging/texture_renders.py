"""Images of textured meshes without shading, by rasterization in NumPy."""

from typing import NamedTuple

import numpy as np

from ..geometry.transforms import cross
from .images import sample_bilinear
from .raster import draw_ids


class PixelLocations(NamedTuple):
    """What N pixels of an image show: covered (H, W) bool, N of them true; triangles (N,) int32, in the order of the pixels; and their
    barycentric coordinates (N, 3) on the surface."""

    covered: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray

    def interpolate(self, corner_values: np.ndarray) -> np.ndarray:
        """Return the values (N, C) of `corner_values` (T, 3, C) at the pixels."""
        return np.einsum("ni,nic->nc", self.barycentric, corner_values[self.triangles])


def locate_pixels(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> PixelLocations:
    """Return what each pixel shows of triangles with `corners` (T, 3, 2) float64 in pixels and positive `depths` (T, 3) along the optical
    axis, with correct perspective. size: width and height."""
    owners, _ = draw_ids(corners, -1.0 / depths, size)
    covered = owners >= 0
    triangles = owners[covered]
    rows, columns = np.nonzero(covered)
    positions = np.stack([columns, rows], axis=1) + 0.5
    return PixelLocations(covered, triangles, locate_positions(corners[triangles], depths[triangles], positions))


def locate_positions(corners: np.ndarray, depths: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the barycentric coordinates (N, 3), on the surface, of `positions` (N, 2) of an image, each in a triangle of its own with
    `corners` (N, 3, 2) and positive `depths` (N, 3) along the optical axis."""
    offsets = corners - positions[:, None]
    areas = np.stack(
        [cross(offsets[:, 1], offsets[:, 2]), cross(offsets[:, 2], offsets[:, 0]), cross(offsets[:, 0], offsets[:, 1])], axis=1
    )
    weights = areas / depths
    return weights / weights.sum(axis=1, keepdims=True)


def render_texture(
    corners: np.ndarray, depths: np.ndarray, corner_uvs: np.ndarray, texture: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return an image (H, W, C) of triangles with a texture, and where (H, W) bool there is a triangle.

    Args:
        corners: (T, 3, 2) float64 in pixels of the image. depths: (T, 3) distances along the optical axis, positive. corner_uvs: (T, 3, 2).
        texture: (H', W', C) float32, row 0 at the bottom. size: width and height of the image.
    """
    located = locate_pixels(corners, depths, size)
    image = np.zeros((size[1], size[0], texture.shape[2]), np.float32)
    image[located.covered] = sample_bilinear(texture, located.interpolate(corner_uvs) * texture.shape[1::-1])
    return image, located.covered
