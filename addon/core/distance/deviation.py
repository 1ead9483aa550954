"""How far a simplified mesh and its texture are from the original, from which size of a pixel that is not seen, and its shading normals."""

import numpy as np

from ..arrays import TINY
from ..geometry.distance import TriangleTree, closest_barycentric
from ..geometry.mesh import face_areas_and_normals
from ..geometry.transforms import normalize, signed_areas

SAMPLES = 4000  # Vertices or triangles of the original that are compared.
QUANTILE = 0.99  # Of their distances; single points that are farther away do not count.
TEXTURE_QUANTILE = 0.95  # Of the lengths by which the texture moves; next to seams, the nearest point may have another part of it.
# The shortest length of detail relative to its height: bumps that are lower than a pixel, but wider, are seen by their shading.
DETAIL_SIZE = 4.0
# Barycentric coordinates of the points of a triangle at which the original's normals are read.
NORMAL_POINTS = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 5, 5], [5, 2, 5], [5, 5, 2]]) / np.array([[6]] * 3 + [[12]] * 3)
MIN_COSINE = 0.7  # Of the angle between a triangle and such a normal; others are those of another side of an edge.


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


def transfer_normals(corners: np.ndarray, normals: np.ndarray, coarse_corners: np.ndarray, coarse_normals: np.ndarray) -> np.ndarray:
    """Return shading normals (S, 3, 3) of a simplified mesh that are, between the corners, nearest to those of the original in the sense of
    least squares: a round surface of small flat faces stays round with large ones, and flat faces with rounded edges stay flat. Triangles
    next to which the original faces elsewhere keep their own.

    Args:
        corners: (T, 3, 3) of the original.
        normals: (T, 3, 3), its shading normals.
        coarse_corners: (S, 3, 3) of the simplified mesh.
        coarse_normals: (S, 3, 3), its own shading normals.
    """
    corners, coarse_corners = np.asarray(corners, np.float64), np.asarray(coarse_corners, np.float64)
    points = np.einsum("pk,skc->spc", NORMAL_POINTS, coarse_corners).reshape(-1, 3)
    _, nearest = TriangleTree(corners).find_closest(points)
    weights = closest_barycentric(points, corners[nearest])
    found = normalize(np.einsum("nk,nkc->nc", weights, normals[nearest])).reshape(-1, len(NORMAL_POINTS), 3)
    face_normals = face_areas_and_normals(coarse_corners)[1][:, None]
    agrees = (found * face_normals).sum(axis=2) > MIN_COSINE
    found = np.where(agrees[..., None], found, face_normals)
    fitted = normalize(np.einsum("kp,spc->skc", np.linalg.pinv(NORMAL_POINTS), found))
    return np.where(agrees.any(axis=1)[:, None, None], fitted, coarse_normals).astype(np.float32)
