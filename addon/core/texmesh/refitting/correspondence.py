"""The point of a level that has the texture coordinates of a point of the fine mesh."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...geometry.distance import segment_argmin
from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas
from ..textured_mesh import TexturedMesh
from .sampling import SurfaceSamples
from .uv_triangles import UvTriangles

LABEL_POINTS = np.array([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]])
LABEL_POINTS = LABEL_POINTS / LABEL_POINTS.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class Correspondence:
    """For each of N samples the point of a level with the same texture coordinates.

    triangles: (N,) int64 of the level. barycentric: (N, 3) float64, none negative, column by column in memory.
    is_covered: (N,) bool; where False the level has no point with these coordinates in the sample's UV island, and the point is the one
    with the nearest coordinates there.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    is_covered: np.ndarray


def match_islands(samples: SurfaceSamples, materials: np.ndarray, level: TexturedMesh, uv_scale: float) -> np.ndarray:
    """Return for each triangle of `level` the UV island (T,) int32 of the fine mesh that it belongs to: that of most of the samples which
    are nearest to four of its points in space and in UV.

    samples: dense, of the fine mesh. materials: (N,) of the samples. uv_scale: length of a unit of UV space on the surface.
    """
    spacing = 4.0 * (np.ptp(samples.positions, axis=0).sum() + uv_scale * np.ptp(samples.uvs, axis=0).sum())
    keys = np.column_stack([samples.positions, uv_scale * samples.uvs, spacing * materials])
    positions = np.einsum("pi,tic->tpc", LABEL_POINTS, level.vertices[level.triangles])
    uvs = np.einsum("pi,tic->tpc", LABEL_POINTS, level.corner_uvs)
    wanted = np.broadcast_to(spacing * level.materials[:, None, None].astype(float), (*positions.shape[:2], 1))
    queries = np.concatenate([positions, uv_scale * uvs, wanted], axis=2)
    _, nearest = cKDTree(keys).query(queries.reshape(-1, keys.shape[1]))
    votes = samples.islands[nearest].reshape(-1, len(LABEL_POINTS))
    agreement = (votes[:, :, None] == votes[:, None, :]).sum(axis=2)
    return votes[np.arange(len(votes)), agreement.argmax(axis=1)]


def compute_uv_scale(mesh: TexturedMesh) -> float:
    """Return the length on the surface of a unit of UV space: the square root of the ratio of total areas; 0 if UVs have no area."""
    area = face_areas_and_normals(mesh.vertices[mesh.triangles])[0].sum()
    uv_area = np.abs(signed_areas(mesh.corner_uvs)).sum()
    return float(np.sqrt(area / uv_area)) if uv_area > 0.0 else 0.0


def find_correspondence(
    samples: SurfaceSamples, corners: np.ndarray, corner_uvs: np.ndarray, islands: np.ndarray, guess: np.ndarray | None = None
) -> Correspondence:
    """Find the points of a level with the texture coordinates of `samples`; of several in the same island the nearest in space.

    corners: (T, 3, 3) positions of the level. corner_uvs: (T, 3, 2). islands: (T,) from `match_islands`. guess: (N,) triangles, which are
    kept for the samples that they contain: those found before a small change of the level.
    """
    return find_in_triangles(samples, corners, UvTriangles(corner_uvs, islands), guess)


def find_in_triangles(
    samples: SurfaceSamples, corners: np.ndarray, uv_triangles: UvTriangles, guess: np.ndarray | None = None
) -> Correspondence:
    """Return what `find_correspondence` does, for several searches in the same triangles."""
    count = len(samples.uvs)
    triangles = np.full(count, -1, np.int64)
    barycentric = np.zeros((3, count)).T  # column by column in memory, as it is used
    rows = np.arange(count)
    if guess is not None:
        is_kept, coordinates = uv_triangles.locate(guess, samples.uvs)
        kept = np.flatnonzero(is_kept & (uv_triangles.islands[guess] == samples.islands))
        triangles[kept], barycentric[kept] = guess[kept], coordinates[kept]
        rows = np.flatnonzero(triangles < 0)
    for found, triangle, coordinates in uv_triangles.find_containing(samples.uvs[rows], samples.islands[rows]):
        sample = rows[found]
        points = np.einsum("ni,nic->nc", coordinates, corners[triangle])
        distances = ((points - samples.positions[sample]) ** 2).sum(axis=1)
        chosen = segment_argmin(distances, np.flatnonzero(np.diff(sample, prepend=-1)))
        triangles[sample[chosen]], barycentric[sample[chosen]] = triangle[chosen], coordinates[chosen]
    is_covered = triangles >= 0
    outside = np.flatnonzero(~is_covered)
    if len(outside):
        triangles[outside], barycentric[outside] = uv_triangles.find_nearest(samples.uvs[outside], samples.islands[outside])
    return Correspondence(triangles, barycentric, is_covered)
