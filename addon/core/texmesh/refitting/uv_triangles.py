"""Triangles in UV space, for searches of those that contain or are nearest to texture coordinates."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import concatenate_ranges
from ...geometry.distance import TriangleTree, closest_barycentric
from ...geometry.proximity import counting_argsort
from ...geometry.transforms import signed_areas
from ...jobs.chunks import slices

CHUNK_POINTS = 1 << 14
CELLS_PER_TRIANGLE = 2.0
MAX_CELLS = 1 << 22
INSIDE_TOLERANCE = 1e-9  # of barycentric coordinates
LAYER_SPACING = 16.0  # of UV islands in the third coordinate, relative to the largest texture coordinate


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
    """A grid of `size` (2,) cells, columns and rows, over triangles in UV space, from `low` (2,) with `extent` (2,). The `owners` (K,) of
    cell i, row by row, are those from starts[i] to starts[i + 1]: the triangles whose bounding boxes overlap it."""

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
    extent = np.maximum(triangle_high.max(axis=0) - low, 1e-300)
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
