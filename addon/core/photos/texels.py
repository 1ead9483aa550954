"""The texels of a texture on the surface: which triangle covers each, and where in world space it is."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.geometry_2d import signed_areas
from ..geometry.mesh import TriangleMesh, scaled_normals
from ..imaging.raster import rasterize

TILE_TEXELS = 1 << 20  # computed at once


@dataclass(frozen=True)
class TexelTile:
    """Some texels: flat indices (N,) in the texture, their triangles (N,) and barycentric coordinates (N, 3) float32."""

    texels: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray

    def interpolate(self, corner_values: np.ndarray) -> np.ndarray:
        """Return the values (N, C) of `corner_values` (T, 3, C) at the texels."""
        return np.einsum("ni,nic->nc", self.barycentric, corner_values[self.triangles])


class TexelMap:
    """The triangle of every texel whose center a triangle covers.

    triangles: (H * W,) int32, -1 where there is none. size: texels per side.
    """

    def __init__(self, corner_uvs: np.ndarray, size: int) -> None:
        """Rasterize triangles with UVs (T, 3, 2), of which only the part in 0..1 has texels."""
        self.size = size
        self._corners = corner_uvs.astype(np.float64) * size
        self.triangles = np.full(size * size, -1, np.int32)
        for triangles, texels, _ in rasterize(self._corners, (size, size)):
            self.triangles[texels] = triangles

    @property
    def covered(self) -> np.ndarray:
        """(H, W) bool: which texels have a triangle."""
        return (self.triangles >= 0).reshape(self.size, self.size)

    def tiles(self) -> Iterator[TexelTile]:
        """Yield all covered texels."""
        rows = max(TILE_TEXELS // self.size, 1)
        for start in range(0, self.size, rows):
            texels = np.flatnonzero(self.triangles[start * self.size : (start + rows) * self.size] >= 0) + start * self.size
            if len(texels):
                triangles = self.triangles[texels]
                yield TexelTile(texels, triangles, self._barycentric(texels, triangles))

    def _barycentric(self, texels: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        centers = np.stack([texels % self.size, texels // self.size], axis=1) + 0.5
        corners = self._corners[triangles]
        offsets = corners - centers[:, None]
        opposite = [
            signed_areas(np.stack([np.zeros_like(centers), offsets[:, i], offsets[:, j]], axis=1)) for i, j in ((1, 2), (2, 0), (0, 1))
        ]
        weights = np.stack(opposite, axis=1)
        return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


def vertex_normals(mesh: TriangleMesh) -> np.ndarray:
    """Return unit normals (V, 3) float64 of the vertices, the means of the triangles around them by area; zero where undefined."""
    normals = np.zeros((len(mesh.vertices), 3))
    scaled = scaled_normals(mesh.corners)
    for axis in range(3):
        normals[:, axis] = np.bincount(mesh.triangles.ravel(), np.repeat(scaled[:, axis], 3), len(mesh.vertices))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0.0, lengths, 1.0)
