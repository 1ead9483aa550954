"""How far a simplified mesh and its texture are from the original, and from which size of a pixel that is not seen."""

import numpy as np

from ..arrays import TINY
from ..geometry.distance import TriangleTree, closest_barycentric
from ..geometry.mesh import face_areas_and_normals
from ..geometry.transforms import signed_areas

SAMPLES = 4000  # Vertices or triangles of the original that are compared.
QUANTILE = 0.99  # Of their distances; single points that are farther away do not count.
TEXTURE_QUANTILE = 0.95  # Of the lengths by which the texture moves; next to seams, the nearest point may have another part of it.
# The shortest length of detail relative to its height: bumps that are lower than a pixel, but wider, are seen by their shading.
DETAIL_SIZE = 4.0


def measure_pixel_size(vertices: np.ndarray, corners: np.ndarray) -> float:
    """Return the size of a pixel above which the triangles `corners` (T, 3, 3) look like the original with `vertices` (V, 3), a length."""
    sampled = np.unique(np.linspace(0, len(vertices) - 1, SAMPLES).astype(int))
    distances, _ = TriangleTree(np.asarray(corners, np.float64)).find_closest(np.asarray(vertices[sampled], np.float64))
    return DETAIL_SIZE * float(np.quantile(distances, QUANTILE))


def measure_texture_shift(corners: np.ndarray, uvs: np.ndarray, coarse_corners: np.ndarray, coarse_uvs: np.ndarray) -> float:
    """Return the length by which a texture moves on the surface between a mesh and a simplified one.

    Args:
        corners: (T, 3, 3) of the original.
        uvs: (T, 3, 2).
        coarse_corners: (S, 3, 3) of the simplified mesh.
        coarse_uvs: (S, 3, 2).
    """
    sampled = np.unique(np.linspace(0, len(corners) - 1, SAMPLES).astype(int))
    corners, uvs, coarse_corners = np.asarray(corners[sampled], np.float64), uvs[sampled], np.asarray(coarse_corners, np.float64)
    areas, uv_areas = face_areas_and_normals(corners)[0], np.abs(signed_areas(uvs))
    centers = corners.mean(axis=1)
    _, nearest = TriangleTree(coarse_corners).find_closest(centers)
    weights = closest_barycentric(centers, coarse_corners[nearest])
    moved = np.linalg.norm(np.einsum("nk,nkc->nc", weights, coarse_uvs[nearest]) - uvs.mean(axis=1), axis=1)
    has_area = uv_areas > TINY
    lengths = moved[has_area] * np.sqrt(areas[has_area] / uv_areas[has_area])
    return float(np.quantile(lengths, TEXTURE_QUANTILE)) if len(lengths) else 0.0
