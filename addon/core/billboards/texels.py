"""Texels on the quads of a level, in texture space and in world space."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..arrays import TINY
from ..geometry.distance import closest_barycentric, closest_on_mesh
from ..geometry.mesh import face_areas_and_normals

BOUNDARY_TOLERANCE = 1e-6  # In texels, for corners that lie on the boundary between two texels.
FLATNESS = 1e-4  # A chart thinner than this fraction of its size has no depth that tells its axis.


@dataclass(frozen=True)
class Texels:
    """N texels on Q quads.

    Attributes:
        texture_size: (width, height).
        pixels: (N, 2) int32, x and y in the texture, row 0 at the bottom.
        quad_indices: (N,) int32.
        positions: (N, 3) float64, texel centers in the space of the quads' corners.
        steps: (Q, 2, 3) vectors from one texel to the next along x and y.
        normals: (N, 3) unit normals of the faces on which texels lie, None where all faces of a quad have that of the quad.
    """

    texture_size: tuple[int, int]
    pixels: np.ndarray
    quad_indices: np.ndarray
    positions: np.ndarray
    steps: np.ndarray
    normals: np.ndarray | None = None

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
        """Compute the absolute cosines (V, N) float32 between the face normal of each texel and unit `directions` (V, 3)."""
        if self.normals is not None:
            return np.abs(directions @ self.normals.T).astype(np.float32)
        return np.abs(directions @ self.quad_normals.T).astype(np.float32)[:, self.quad_indices]

    def face_viewer(self, direction: np.ndarray) -> np.ndarray:
        """Return whether the front of the face of each texel faces a viewer in `direction` (3,): (N,) bool."""
        if self.normals is not None:
            return self.normals @ direction > 0.0
        return (self.quad_normals @ direction > 0.0)[self.quad_indices]

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


def interpolate_in_triangles(points: np.ndarray, triangles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate `values` (T, 3, K) at the corners of `triangles` (T, 3, 2) at `points` (N, 2): (N, K).

    A point outside of all triangles gets the value of the closest point in one of them.
    """
    corners = np.concatenate([triangles, np.zeros_like(triangles[..., :1])], axis=2)
    lifted = np.column_stack([points, np.zeros(len(points))])
    nearest = closest_on_mesh(lifted, corners)[1]
    return np.einsum("nc,nck->nk", closest_barycentric(lifted, corners[nearest]), values[nearest])


@dataclass(frozen=True)
class QuadPolygons:
    """F convex polygons of the quads of a level, one for each quad or several.

    Per polygon `corners` (C, 3) in space and `texel_coordinates` (C, 2) in the texture, C >= 3. quads (F,) int: the quad of each, not
    descending; None if there is one per quad.
    """

    corners: list[np.ndarray]
    texel_coordinates: list[np.ndarray]
    quads: np.ndarray | None = None

    @property
    def quad_indices(self) -> np.ndarray:
        """(F,) int, the quad of each polygon."""
        return np.arange(len(self.corners)) if self.quads is None else self.quads

    def by_quad(self) -> list[tuple[list[np.ndarray], list[np.ndarray]]]:
        """Return the corners and texel coordinates of the polygons of each quad."""
        starts = np.searchsorted(self.quad_indices, np.arange(int(self.quad_indices.max(initial=-1)) + 2)).tolist()
        return [(self.corners[start:end], self.texel_coordinates[start:end]) for start, end in pairwise(starts)]


def texels_under_quads(polygons: QuadPolygons, texture_size: tuple[int, int]) -> Texels:
    """Return the texels under quads in a texture of `texture_size` (width, height).

    A texel counts if its center is within half a texel of the bounding box of the polygons in the texture. With several polygons, which
    must be triangles, it lies on the nearest one.
    """
    pixels, quads, positions, normals, steps = [], [], [], [], []
    for quad, (corners, coordinates) in enumerate(polygons.by_quad()):
        all_coordinates = np.concatenate(coordinates)
        low = np.maximum(np.floor(all_coordinates.min(axis=0) - 0.5 + BOUNDARY_TOLERANCE) + 0.0, 0).astype(np.int64)
        high = np.minimum(np.ceil(all_coordinates.max(axis=0) + 0.5 - BOUNDARY_TOLERANCE), texture_size).astype(np.int64)
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        quad_pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        pixels.append(quad_pixels)
        quads.append(np.full(len(quad_pixels), quad))
        if len(corners) == 1:
            affine, *_ = np.linalg.lstsq(np.column_stack([all_coordinates, np.ones(len(all_coordinates))]), corners[0], rcond=None)
            positions.append(np.column_stack([quad_pixels + 0.5, np.ones(len(quad_pixels))]) @ affine)
            steps.append(affine[:2])
            normals.append(np.broadcast_to(_unit_cross(*affine[:2]), positions[-1].shape))
        else:
            triangles, in_texture = np.stack(corners), np.stack(coordinates)
            face_normals = np.repeat(face_areas_and_normals(triangles)[1][:, None], 3, axis=1)
            values = interpolate_in_triangles(quad_pixels + 0.5, in_texture, np.concatenate([triangles, face_normals], axis=2))
            positions.append(values[:, :3])
            normals.append(values[:, 3:])
            steps.append(_projected_steps(triangles.reshape(-1, 3), all_coordinates))
    all_pixels = np.concatenate(pixels)
    # Two bounding boxes may share a column of texels between them; it belongs to the first.
    _, first = np.unique(all_pixels[:, 1] * texture_size[0] + all_pixels[:, 0], return_index=True)
    all_pixels, quad, position = all_pixels[first], np.concatenate(quads)[first], np.concatenate(positions)[first]
    face_normals = None if polygons.quads is None else np.concatenate(normals)[first]
    return Texels(texture_size, all_pixels.astype(np.int32), quad.astype(np.int32), position, np.array(steps), face_normals)


def _projected_steps(points: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
    """Return the steps (2, 3) from texel to texel in the plane onto which `points` (N, 3) with texel `coordinates` (N, 2) are projected."""
    gradients = np.linalg.pinv(points - points.mean(axis=0), rcond=FLATNESS) @ (coordinates - coordinates.mean(axis=0))
    return (gradients / np.maximum((gradients**2).sum(axis=0), TINY)).T


def _unit_cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    normal = np.cross(first, second)
    return normal / max(float(np.linalg.norm(normal)), TINY)
