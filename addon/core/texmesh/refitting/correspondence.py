"""Points on the fine mesh, uniform by area, and the points of a level that correspond to them.

These have the same texture coordinates where the level has them near the sample. Elsewhere, they are the nearest ones in space: where a
seam has moved, an island is gone, or texture coordinates have no area.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ...arrays import concatenate_ranges
from ...geometry.distance import TriangleTree, closest_barycentric, segment_argmin
from ...geometry.mesh import face_areas_and_normals
from ...geometry.proximity import counting_argsort
from ...geometry.transforms import signed_areas
from ...jobs.chunks import slices
from ..simplification.topology import find_islands
from ..textured_mesh import TexturedMesh

LABEL_POINTS = np.array([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]])
LABEL_POINTS = LABEL_POINTS / LABEL_POINTS.sum(axis=1, keepdims=True)
CHUNK_POINTS = 1 << 14
CELLS_PER_TRIANGLE = 2.0
MAX_CELLS = 1 << 22
MIN_EXTENT = 1e-6  # Extent of a grid in one direction, relative to the other one.
INSIDE_TOLERANCE = 1e-9  # Tolerance of barycentric coordinates.
NEAR_EDGES = 0.5  # Points that are farther from where their texture is, in edge lengths of the level, correspond to the nearest ones.
UNTEXTURED = -1  # in place of the island of triangles whose texture coordinates have no area
LAYER_SPACING = 16.0  # Distance of UV islands in the third coordinate, relative to the largest texture coordinate.


@dataclass(frozen=True, eq=False)
class UvTriangles:
    """Texture coordinates `corner_uvs` (T, 3, 2) of triangles and their UV `islands` (T,). What searches need is made once."""

    corner_uvs: np.ndarray
    islands: np.ndarray

    @cached_property
    def _maps(self) -> np.ndarray:
        return invert_uv_maps(self.corner_uvs)

    @cached_property
    def _cells(self) -> "_Cells":
        return _divide_into_cells(self.corner_uvs)

    @cached_property
    def _spacing(self) -> float:
        return LAYER_SPACING * float(np.abs(self.corner_uvs).max(initial=0.0)) + 1e-300

    @cached_property
    def _layers(self) -> np.ndarray:
        """(T, 3, 3) corners, in which islands are told apart by the third coordinate."""
        heights = np.broadcast_to(self._spacing * self.islands[:, None, None].astype(float), (len(self.islands), 3, 1))
        return np.concatenate([self.corner_uvs, heights], axis=2)

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self._layers)

    def locate(self, triangles: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which of `triangles` (N,) contain their row of `uvs` (N, 2), and barycentric coordinates (N, 3), clamped to 0."""
        coordinates = evaluate_uv_maps(self._maps, triangles, *uvs.T)
        first, second, third = coordinates >= -INSIDE_TOLERANCE
        return first & second & third, np.maximum(coordinates, 0.0).T

    def find_containing(self, uvs: np.ndarray, islands: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield ascending rows (K,) of `uvs` (N, 2), triangles (K,) of the same one of `islands` (N,) that contain them, and barycentric
        coordinates (K, 3), a part at a time."""
        cells = self._cells
        for chunk in slices(len(uvs), CHUNK_POINTS):
            points = uvs[chunk]
            row, triangle = cells.find_candidates(points)
            is_same = self.islands[triangle] == islands[chunk][row]
            row, triangle = row[is_same], triangle[is_same]
            is_inside, coordinates = self.locate(triangle, points.take(row, axis=0))
            found = np.flatnonzero(is_inside)
            if len(found):
                yield chunk.start + row[found], triangle[found], coordinates[found]

    def find_nearest(self, uvs: np.ndarray, islands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the triangles (N,) and barycentric coordinates (N, 3) nearest to `uvs` (N, 2), of the same one of `islands` (N,) if
        possible."""
        points = np.column_stack([uvs, self._spacing * islands])
        _, nearest = self._tree.find_closest(points)
        return nearest.astype(np.int64), closest_barycentric(points, self._layers[nearest])


@dataclass(frozen=True, eq=False)
class _Cells:
    """A grid over triangles in UV space.

    Attributes:
        low, extent: (2,) lowest corner and size of the grid.
        size: (2,) columns and rows of cells.
        starts: (cells + 1,), row by row: the owners of cell i are those from starts[i] to starts[i + 1].
        owners: (K,) triangles whose bounding boxes overlap the cell.
    """

    low: np.ndarray
    extent: np.ndarray
    size: np.ndarray
    starts: np.ndarray
    owners: np.ndarray

    def find(self, uvs: np.ndarray) -> np.ndarray:
        """Return the columns and rows (N, 2) of the cells of `uvs` (N, 2), those on the border for points outside."""
        return np.clip(np.floor((uvs - self.low) / self.extent * self.size), 0, self.size - 1).astype(np.int64)

    def find_candidates(self, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of a row of `uvs` (N, 2), ascending, and a triangle that may contain it."""
        tolerance = INSIDE_TOLERANCE * self.extent
        is_inside = ((uvs >= self.low - tolerance) & (uvs <= self.low + self.extent + tolerance)).all(axis=1)
        rows = np.flatnonzero(is_inside)
        column, line = self.find(uvs[rows]).T
        cell = line * self.size[0] + column
        counts = self.starts[cell + 1] - self.starts[cell]
        return np.repeat(rows, counts), self.owners[concatenate_ranges(self.starts[cell], counts)]


def _divide_into_cells(corner_uvs: np.ndarray) -> _Cells:
    triangle_low, triangle_high = (  # pairwise: NumPy reduces short axes slowly
        bound(bound(corner_uvs[:, 0], corner_uvs[:, 1]), corner_uvs[:, 2]) for bound in (np.minimum, np.maximum)
    )
    low = triangle_low.min(axis=0)
    extent = triangle_high.max(axis=0) - low
    extent = np.maximum(extent, max(MIN_EXTENT * float(extent.max()), 1e-300))
    count = min(CELLS_PER_TRIANGLE * len(corner_uvs), MAX_CELLS)
    size = np.maximum(np.sqrt(count * extent / extent[::-1]), 1.0).astype(np.int64)
    size = np.minimum(size, MAX_CELLS // size[::-1] + 1)
    empty = np.zeros(0, np.int64)
    grid = _Cells(low, extent, size, empty, empty)
    first, last = grid.find(triangle_low), grid.find(triangle_high)
    rows = last[:, 1] - first[:, 1] + 1
    owners = np.repeat(np.arange(len(corner_uvs)), rows)
    row = concatenate_ranges(first[:, 1], rows)
    widths = (last[:, 0] - first[:, 0] + 1)[owners]
    cell = concatenate_ranges(row * size[0] + first[owners, 0], widths)
    cell_count = int(size[0] * size[1])
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=cell_count))])
    return _Cells(low, extent, size, starts, np.repeat(owners, widths)[counting_argsort(cell, cell_count)])


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


@dataclass(frozen=True)
class SurfaceSamples:
    """Points on the surface of a textured mesh.

    Attributes:
        triangles: (N,) int64 of the mesh.
        barycentric: (N, 3) float64.
        positions: (N, 3) float64, in the space of the mesh.
        uvs: (N, 2) float64.
        islands: (N,) int32, the UV islands of `find_textured_islands`.
        weights: (N,) float64, the areas that the samples stand for.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    positions: np.ndarray
    uvs: np.ndarray
    islands: np.ndarray
    weights: np.ndarray

    def take(self, rows: np.ndarray, islands: np.ndarray) -> "SurfaceSamples":
        """Return the samples `rows` (K,), with other `islands` (K,)."""
        values = (self.triangles, self.barycentric, self.positions, self.uvs)
        return SurfaceSamples(*(value[rows] for value in values), islands, self.weights[rows])


def sample_surface(
    mesh: TexturedMesh, islands: np.ndarray, count: int, generator: np.random.Generator, triangle_fraction: float = 0.0
) -> SurfaceSamples:
    """Return about `count` points on the mesh, uniform by 3D area; equal areas get equal numbers of points, rounded up or down.

    Args:
        islands: (T,) from `find_textured_islands`.
        triangle_fraction: of the points, those that are divided evenly among the triangles, however small. Then the points stand for
            different areas.
    """
    areas, _ = face_areas_and_normals(mesh.vertices[mesh.triangles])
    expected = count * ((1.0 - triangle_fraction) * areas / areas.sum() + triangle_fraction / len(areas))
    ends = np.cumsum(expected) + generator.uniform()
    counts = np.diff(np.floor(ends), prepend=0.0).astype(np.int64)
    triangles = np.repeat(np.arange(len(areas)), counts)
    order = concatenate_ranges(0, counts)
    barycentric = _spread_points(order, counts[triangles], generator)
    if triangle_fraction > 0.0:
        weights = (areas / np.where(expected < 1.0, expected, np.maximum(counts, 1)))[triangles]
    else:
        weights = np.full(len(triangles), areas.sum() / max(len(triangles), 1))
    return SurfaceSamples(
        triangles,
        barycentric,
        np.einsum("ni,nic->nc", barycentric, mesh.vertices[mesh.triangles[triangles]]),
        np.einsum("ni,nic->nc", barycentric, mesh.uvs[mesh.wedge_triangles[triangles]]),
        islands[triangles],
        weights,
    )


def _spread_points(order: np.ndarray, counts: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return barycentric coordinates (N, 3) of the points number `order` (N,) of `counts` (N,) in triangles, spread evenly: the first
    coordinate of a square is stratified, the second a van der Corput sequence with a random shift per point of the first triangle."""
    first = (order + generator.uniform(size=len(order))) / np.maximum(counts, 1)
    second = np.mod(_reverse_bits(order) + generator.uniform(size=len(order)) / np.maximum(counts, 1), 1.0)
    root = np.sqrt(first)
    return np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)


def _reverse_bits(numbers: np.ndarray) -> np.ndarray:
    """Return the van der Corput sequence (N,) in base 2 at `numbers` (N,)."""
    result, fraction, rest = np.zeros(len(numbers)), 0.5, numbers.copy()
    while rest.any():
        result += fraction * (rest & 1)
        rest >>= 1
        fraction *= 0.5
    return result


@dataclass(frozen=True)
class Correspondence:
    """For each of N samples the point of a level that corresponds to it.

    Attributes:
        triangles: (N,) int64 of the level.
        barycentric: (N, 3) float64, none negative, column by column in memory.
        is_covered: (N,) bool; where False the level has no point with these coordinates in the sample's UV island, and the point is the one
            with the nearest coordinates there, or the nearest one in space.
        is_spatial: (N,) bool, where it is the nearest one in space.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    is_covered: np.ndarray
    is_spatial: np.ndarray


def find_textured_islands(mesh: TexturedMesh) -> np.ndarray:
    """Return the UV island (T,) int32 of each triangle, UNTEXTURED for those whose texture coordinates have no area."""
    return np.where(signed_areas(mesh.corner_uvs) != 0.0, find_islands(mesh), UNTEXTURED).astype(np.int32)


def match_islands(samples: SurfaceSamples, materials: np.ndarray, level: TexturedMesh, uv_scale: float) -> np.ndarray:
    """Return for each triangle of `level` the UV island (T,) int32 of the fine mesh that it belongs to: that of most of the samples which
    are nearest to four of its points in space and in UV.

    samples: dense, of the fine mesh. materials: (N,) of the samples. uv_scale: length of a unit of UV space on the surface.
    """
    if (samples.islands == samples.islands[0]).all():
        return np.full(len(level.triangles), samples.islands[0])
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
    """Find the points of a level that correspond to `samples`; of several in the same island the nearest in space.

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
    is_textured = samples.islands != UNTEXTURED
    if guess is not None:
        is_kept, coordinates = uv_triangles.locate(guess, samples.uvs)
        kept = np.flatnonzero(is_kept & (uv_triangles.islands[guess] == samples.islands))
        triangles[kept], barycentric[kept] = guess[kept], coordinates[kept]
    rows = np.flatnonzero(is_textured & (triangles < 0))
    pieces = uv_triangles.find_containing(samples.uvs[rows], samples.islands[rows]) if len(rows) else ()
    for found, triangle, coordinates in pieces:
        sample = rows[found]
        points = np.einsum("ni,nic->nc", coordinates, corners[triangle])
        distances = ((points - samples.positions[sample]) ** 2).sum(axis=1)
        chosen = segment_argmin(distances, np.flatnonzero(np.diff(sample, prepend=-1)))
        triangles[sample[chosen]], barycentric[sample[chosen]] = triangle[chosen], coordinates[chosen]
    is_covered = triangles >= 0
    is_spatial = ~is_textured
    rows = np.flatnonzero(~is_covered & is_textured)
    if len(rows):
        triangles[rows], barycentric[rows] = uv_triangles.find_nearest(samples.uvs[rows], samples.islands[rows])
    _find_in_space(samples.positions, corners, triangles, barycentric, is_covered, is_spatial)
    return Correspondence(triangles, barycentric, is_covered, is_spatial)


def _find_in_space(
    points: np.ndarray,
    corners: np.ndarray,
    triangles: np.ndarray,
    barycentric: np.ndarray,
    is_covered: np.ndarray,
    is_spatial: np.ndarray,
) -> None:
    """Let `points` (N, 3) that `is_spatial`, and those that are not covered and far from their corresponding points, correspond to the
    nearest ones in space; change the other arrays in place."""
    rows = np.flatnonzero(~is_covered & ~is_spatial)
    distances = np.linalg.norm(np.einsum("ni,nic->nc", barycentric[rows], corners[triangles[rows]]) - points[rows], axis=1)
    areas = face_areas_and_normals(corners)[0]
    is_far = distances > NEAR_EDGES * np.sqrt(areas.mean())
    rows, distances = rows[is_far], distances[is_far]
    sought = np.concatenate([np.flatnonzero(is_spatial), rows])
    if not len(sought):
        return
    limits = np.concatenate([np.full(len(sought) - len(rows), np.inf), distances])
    found, nearest = TriangleTree(corners).find_closest(points[sought])
    is_nearer = found < limits
    sought, nearest = sought[is_nearer], nearest[is_nearer]
    is_spatial[sought] = True
    triangles[sought], barycentric[sought] = nearest, closest_barycentric(points[sought], corners[nearest])
