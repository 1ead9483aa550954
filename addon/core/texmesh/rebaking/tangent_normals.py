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
        """Yield texels (N,) of an image, row by row from the bottom, and their frames (3, 3, N): tangents, bitangents and normals."""
        copies, owners = wrap_triangles(self.uvs)
        corners = [np.ascontiguousarray(values.transpose(1, 2, 0)) for values in (self.normals, self.tangents[..., :3])]
        for rows, texels, barycentric in rasterize(copies * size, size):
            found = owners[rows]
            normals, tangents = (
                sum(weights * corner.take(found, axis=1) for weights, corner in zip(barycentric.T, values, strict=True))
                for values in corners
            )
            yield texels, np.stack([tangents, self.tangents[found, 0, 3] * _cross(normals, tangents), normals])


def find_normals(surface: TangentSurface, vectors: np.ndarray) -> np.ndarray:
    """Return the normals (H, W, 3) float32 of a surface in object space.

    vectors: (H, W, 3), of its normal map, of any length.
    """
    height, width = vectors.shape[:2]
    flat, normals, known = vectors.reshape(-1, 3), np.zeros((height * width, 3), np.float32), np.zeros(height * width, bool)
    for texels, frames in surface.draw_frames((width, height)):
        normals[texels] = _normalize(sum(weights * axis for weights, axis in zip(flat[texels].T, frames, strict=True))).T
        known[texels] = True
    return dilate(normals.reshape(height, width, 3), known.reshape(height, width))


def express_normals(surface: TangentSurface, normals: np.ndarray) -> np.ndarray:
    """Return the normal map (H, W, 3) float32, unit vectors, with which a surface has `normals` (H, W, 3), in object space."""
    height, width = normals.shape[:2]
    flat, vectors, known = normals.reshape(-1, 3), np.zeros((height * width, 3), np.float32), np.zeros(height * width, bool)
    for texels, (tangents, bitangents, own) in surface.draw_frames((width, height)):
        wanted = np.ascontiguousarray(flat[texels].T)
        products = [_cross(*pair) for pair in ((bitangents, own), (own, tangents), (tangents, bitangents))]
        determinant = (tangents * products[0]).sum(axis=0)
        found = _normalize(np.sign(determinant) * np.stack([(wanted * product).sum(axis=0) for product in products]))
        found[2] = np.maximum(found[2], MIN_ABOVE)
        vectors[texels] = _normalize(found).T
        known[texels] = determinant != 0.0
    if not known.any():
        vectors[:] = (0.0, 0.0, 1.0)
    return normalize(dilate(vectors.reshape(height, width, 3), known.reshape(height, width))).astype(np.float32, copy=False)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross products (3, N) of vectors (3, N)."""
    pairs = ((1, 2), (2, 0), (0, 1))
    return np.stack([first[following] * second[last] - first[last] * second[following] for following, last in pairs])


def _normalize(vectors: np.ndarray) -> np.ndarray:
    """Return `vectors` (3, N) with length 1; zero stays zero."""
    lengths = np.sqrt((vectors**2).sum(axis=0))
    return vectors / np.where(lengths > 0.0, lengths, 1.0)
