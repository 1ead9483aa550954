"""Texels on the quads of a level, in texture space and in world space."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import TINY

BOUNDARY_TOLERANCE = 1e-6  # In texels, for corners that lie on the boundary between two texels.


@dataclass(frozen=True)
class Texels:
    """N texels on Q quads.

    Attributes:
        texture_size: (width, height).
        pixels: (N, 2) int32, x and y in the texture, row 0 at the bottom.
        quad_indices: (N,) int32.
        positions: (N, 3) float64, texel centers in the space of the quads' corners.
        steps: (Q, 2, 3) vectors from one texel to the next along x and y.
    """

    texture_size: tuple[int, int]
    pixels: np.ndarray
    quad_indices: np.ndarray
    positions: np.ndarray
    steps: np.ndarray

    def __len__(self) -> int:
        return len(self.quad_indices)

    @property
    def texel_size(self) -> float:
        """Median side length of a texel over the quads."""
        return float(np.median(np.linalg.norm(self.steps, axis=2)))

    @cached_property
    def quad_normals(self) -> np.ndarray:
        """Unit normals (Q, 3) of the quads, on the side of their fronts."""
        normals = np.cross(self.steps[:, 0], self.steps[:, 1])
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), TINY)

    def view_cosines(self, directions: np.ndarray) -> np.ndarray:
        """Compute the absolute cosines (V, N) float32 between the quad normal of each texel and unit `directions` (V, 3)."""
        return np.abs(directions @ self.quad_normals.T).astype(np.float32)[:, self.quad_indices]

    @cached_property
    def index_map(self) -> np.ndarray:
        """Index of the texel at each pixel of the texture, (height, width) int32; -1 for none."""
        indices = np.full((self.texture_size[1], self.texture_size[0]), -1, np.int32)
        indices[self.pixels[:, 1], self.pixels[:, 0]] = np.arange(len(self))
        return indices

    def to_image(self, values: np.ndarray) -> np.ndarray:
        """Write `values` (N, C) to the pixels of an image (H, W, C) that is 0 elsewhere."""
        image = np.zeros((self.texture_size[1], self.texture_size[0], values.shape[1]), values.dtype)
        image[self.pixels[:, 1], self.pixels[:, 0]] = values
        return image


@dataclass(frozen=True)
class QuadPolygons:
    """Convex polygons of the quads of a level: per quad `corners` (C, 3) in space and `texel_coordinates` (C, 2) in the texture, C >= 3."""

    corners: list[np.ndarray]
    texel_coordinates: list[np.ndarray]


def texels_under_quads(polygons: QuadPolygons, texture_size: tuple[int, int]) -> Texels:
    """Return the texels under quads in a texture of `texture_size` (width, height).

    A texel counts if its center is within half a texel of the bounding box of the polygon in the texture.
    """
    pixels, quads, positions, steps = [], [], [], []
    for quad, (corners, coordinates) in enumerate(zip(polygons.corners, polygons.texel_coordinates, strict=True)):
        low = np.maximum(np.floor(coordinates.min(axis=0) - 0.5 + BOUNDARY_TOLERANCE) + 0.0, 0).astype(np.int64)
        high = np.minimum(np.ceil(coordinates.max(axis=0) + 0.5 - BOUNDARY_TOLERANCE), texture_size).astype(np.int64)
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        quad_pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        affine, *_ = np.linalg.lstsq(np.column_stack([coordinates, np.ones(len(coordinates))]), corners, rcond=None)
        pixels.append(quad_pixels)
        quads.append(np.full(len(quad_pixels), quad))
        positions.append(np.column_stack([quad_pixels + 0.5, np.ones(len(quad_pixels))]) @ affine)
        steps.append(affine[:2])
    all_pixels = np.concatenate(pixels)
    # Two bounding boxes may share a column of texels between them; it belongs to the first.
    _, first = np.unique(all_pixels[:, 1] * texture_size[0] + all_pixels[:, 0], return_index=True)
    all_pixels, quad, position = all_pixels[first], np.concatenate(quads)[first], np.concatenate(positions)[first]
    return Texels(texture_size, all_pixels.astype(np.int32), quad.astype(np.int32), position, np.array(steps))
