"""Normals of a surface in the tangent frames of another one that has the same texture coordinates.

Frames are those of renderers: normals and tangents are interpolated without being normalized, and the bitangent is their cross product.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...geometry.transforms import normalize
from ...imaging.images import dilate
from ...imaging.raster import rasterize
from .uv_layout import wrap_triangles

MIN_ABOVE = 0.05  # Least component of a normal along that of the surface: renderers show nothing sensible of normals below it.


@dataclass(frozen=True, eq=False)
class TangentSurface:
    """Triangles with tangent frames. uvs: (T, 3, 2). normals: (T, 3, 3). tangents: (T, 3, 4), the last component the sign of the
    bitangent."""

    uvs: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray

    def draw_frames(self, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield texels (N,) of an image, row by row from the bottom, and their frames (3, N, 3): tangents, bitangents and normals."""
        copies, owners = wrap_triangles(self.uvs)
        for rows, texels, barycentric in rasterize(copies * size, size):
            found = owners[rows]
            normals, tangents = (np.einsum("ni,nic->nc", barycentric, values[found]) for values in (self.normals, self.tangents[..., :3]))
            signs = self.tangents[found, 0, 3:]
            yield texels, np.stack([tangents, signs * np.cross(normals, tangents), normals])


def find_normals(surface: TangentSurface, vectors: np.ndarray) -> np.ndarray:
    """Return the normals (H, W, 3) float32 of a surface in object space.

    vectors: (H, W, 3), of its normal map, of any length.
    """
    height, width = vectors.shape[:2]
    flat, normals, known = vectors.reshape(-1, 3), np.zeros((height * width, 3), np.float32), np.zeros(height * width, bool)
    for texels, frames in surface.draw_frames((width, height)):
        normals[texels] = normalize(np.einsum("nk,knc->nc", flat[texels], frames))
        known[texels] = True
    return dilate(normals.reshape(height, width, 3), known.reshape(height, width))


def express_normals(surface: TangentSurface, normals: np.ndarray) -> np.ndarray:
    """Return the normal map (H, W, 3) float32, unit vectors, with which a surface has `normals` (H, W, 3), in object space."""
    height, width = normals.shape[:2]
    flat, vectors, known = normals.reshape(-1, 3), np.zeros((height * width, 3), np.float32), np.zeros(height * width, bool)
    for texels, (tangents, bitangents, own) in surface.draw_frames((width, height)):
        wanted = flat[texels]
        pairs = ((bitangents, own), (own, tangents), (tangents, bitangents))
        products = [np.cross(*pair) for pair in pairs]
        columns = [np.einsum("nc,nc->n", wanted, product) for product in products]  # times the determinant of the frame
        determinant = np.einsum("nc,nc->n", tangents, products[0])
        found = normalize(np.stack(columns, axis=1) * np.sign(determinant)[:, None])
        found[:, 2] = np.maximum(found[:, 2], MIN_ABOVE)
        vectors[texels] = normalize(found)
        known[texels] = determinant != 0.0
    if not known.any():
        vectors[:] = (0.0, 0.0, 1.0)
    return normalize(dilate(vectors.reshape(height, width, 3), known.reshape(height, width))).astype(np.float32)
