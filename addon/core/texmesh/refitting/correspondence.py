"""The point of a level that has the texture coordinates of a point of the fine mesh."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...arrays import concatenate_ranges
from ...geometry.distance import closest_barycentric, closest_on_mesh, segment_argmin
from ...geometry.geometry_2d import signed_areas
from ...geometry.mesh import face_areas_and_normals
from ...jobs.chunks import slices
from ..textured_mesh import TexturedMesh
from .sampling import SurfaceSamples

CHUNK_SAMPLES = 1 << 14
CELLS_PER_TRIANGLE = 2.0
MAX_CELLS = 1 << 22
INSIDE_TOLERANCE = 1e-9  # of barycentric coordinates
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
    count = len(samples.uvs)
    triangles = np.full(count, -1, np.int64)
    barycentric = np.zeros((3, count)).T  # column by column in memory, as it is used
    maps = invert_uv_maps(corner_uvs)
    searched = samples
    rows = None
    if guess is not None:
        is_kept, coordinates = _locate(maps, guess, samples.uvs)
        kept = np.flatnonzero(is_kept & (islands[guess] == samples.islands))
        triangles[kept], barycentric[kept] = guess[kept], coordinates[kept]
        rows = np.flatnonzero(triangles < 0)
        searched = samples.take(rows, samples.islands[rows])
    for sample, triangle, coordinates in _find_containing(searched, corner_uvs, islands, maps):
        if rows is not None:
            sample = rows[sample]
        points = np.einsum("ni,nic->nc", coordinates, corners[triangle])
        distances = ((points - samples.positions[sample]) ** 2).sum(axis=1)
        chosen = segment_argmin(distances, np.flatnonzero(np.diff(sample, prepend=-1)))
        triangles[sample[chosen]], barycentric[sample[chosen]] = triangle[chosen], coordinates[chosen]
    is_covered = triangles >= 0
    outside = np.flatnonzero(~is_covered)
    if len(outside):
        triangles[outside], barycentric[outside] = _find_nearest(samples.uvs[outside], samples.islands[outside], corner_uvs, islands)
    return Correspondence(triangles, barycentric, is_covered)


def invert_uv_maps(corner_uvs: np.ndarray) -> np.ndarray:
    """Return the affine maps (2, 3, T) from (u, v, 1) to the first two barycentric coordinates; NaN for triangles without area."""
    u, v, area = corner_uvs[:, :, 0].T, corner_uvs[:, :, 1].T, 2.0 * signed_areas(corner_uvs)
    scale = 1.0 / np.where(area != 0.0, area, np.nan)
    maps = np.empty((2, 3, len(corner_uvs)))
    for row, (first, second) in enumerate(((1, 2), (2, 0))):
        maps[row, 0] = (v[first] - v[second]) * scale
        maps[row, 1] = (u[second] - u[first]) * scale
        maps[row, 2] = (u[first] * v[second] - v[first] * u[second]) * scale
    return maps


def evaluate_uv_maps(maps: np.ndarray, triangles: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates (3, N) in `triangles` (N,) of texture coordinates `u`, `v` (N,), by maps of `invert_uv_maps`."""
    coordinates = np.empty((3, len(u)))
    for row in range(2):
        coordinates[row] = maps[row, 0].take(triangles) * u + maps[row, 1].take(triangles) * v + maps[row, 2].take(triangles)
    coordinates[2] = 1.0 - coordinates[0] - coordinates[1]
    return coordinates


def _locate(maps: np.ndarray, triangles: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which of `triangles` (N,) contain their row of `uvs` (N, 2), and barycentric coordinates (N, 3), clamped to 0."""
    coordinates = evaluate_uv_maps(maps, triangles, *uvs.T)
    first, second, third = coordinates >= -INSIDE_TOLERANCE
    is_inside = first & second & third
    return is_inside, np.maximum(coordinates, 0.0).T


def _find_containing(
    samples: SurfaceSamples, corner_uvs: np.ndarray, islands: np.ndarray, maps: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield ascending samples (K,), triangles (K,) that contain them in UV space, and barycentric coordinates (K, 3), a part at a time."""
    triangle_low, triangle_high = (  # pairwise: NumPy reduces short axes slowly
        bound(bound(corner_uvs[:, 0], corner_uvs[:, 1]), corner_uvs[:, 2]) for bound in (np.minimum, np.maximum)
    )
    low = triangle_low.min(axis=0)
    extent = np.maximum(triangle_high.max(axis=0) - low, 1e-300)
    cells = min(CELLS_PER_TRIANGLE * len(corner_uvs), MAX_CELLS)
    size = np.maximum(np.sqrt(cells * extent / extent[::-1]), 1.0).astype(np.int64)
    size = np.minimum(size, MAX_CELLS // size[::-1] + 1)

    def cell_of(uvs: np.ndarray) -> np.ndarray:
        return np.clip(np.floor((uvs - low) / extent * size), 0, size - 1).astype(np.int64)

    first, last = cell_of(triangle_low), cell_of(triangle_high)
    rows = last[:, 1] - first[:, 1] + 1
    owners = np.repeat(np.arange(len(corner_uvs)), rows)
    row = concatenate_ranges(first[:, 1], rows)
    widths = (last[:, 0] - first[:, 0] + 1)[owners]
    cell = concatenate_ranges(row * size[0] + first[owners, 0], widths)
    owners = np.repeat(owners, widths)
    order = np.argsort(cell, kind="stable")
    owners = owners[order]
    starts = np.searchsorted(cell[order], np.arange(size[0] * size[1] + 1))
    tolerance = INSIDE_TOLERANCE * extent
    for chunk in slices(len(samples.uvs), CHUNK_SAMPLES):
        uvs = samples.uvs[chunk]
        inside = ((uvs >= low - tolerance) & (uvs <= low + extent + tolerance)).all(axis=1)
        sample = np.flatnonzero(inside)
        column, line = cell_of(uvs[sample]).T
        key = line * size[0] + column
        counts = starts[key + 1] - starts[key]
        triangle = owners[concatenate_ranges(starts[key], counts)]
        sample = np.repeat(sample, counts)
        is_same = islands[triangle] == samples.islands[chunk][sample]
        sample, triangle = sample[is_same], triangle[is_same]
        is_inside, coordinates = _locate(maps, triangle, uvs.take(sample, axis=0))
        found = np.flatnonzero(is_inside)
        if len(found):
            yield chunk.start + sample[found], triangle[found], coordinates[found]


def _find_nearest(
    uvs: np.ndarray, islands: np.ndarray, corner_uvs: np.ndarray, triangle_islands: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (N,) and barycentric coordinates (N, 3) nearest to `uvs` (N, 2) in UV space, of the same island if possible."""
    spacing = 2.0 * (np.ptp(corner_uvs, axis=(0, 1)).sum() + np.ptp(uvs, axis=0).sum()) + 1e-300
    layers = np.broadcast_to(spacing * triangle_islands[:, None, None].astype(float), (*corner_uvs.shape[:2], 1))
    corners = np.concatenate([corner_uvs, layers], axis=2)
    points = np.column_stack([uvs, spacing * islands])
    _, nearest = closest_on_mesh(points, corners)
    return nearest.astype(np.int64), closest_barycentric(points, corners[nearest])
