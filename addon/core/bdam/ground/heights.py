"""Heights and normals of a terrain at any positions.

They are those of the triangles: of the finest ones by default, which interpolate the samples of the field, or of a cut. Triangles are
found in grid coordinates and evaluated in the local frame. In a geographic frame, whose triangles are straight in the local frame only, a
point within about L^2 / 8 R (0.02 mm for L = 30 m, 2 cm for L = 1 km, R the radius of the earth) of an edge of length L may be evaluated
on the plane of the triangle on the other side.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...errors import FileError
from ...files.segment_cache import DEFAULT_CACHE_BYTES, SegmentCache
from ...geometry.triangle_search import TriangleSearch, evaluate_planes
from ..store.patch_codec import Patch
from ..store.terrain_store import TerrainStore
from ..view.extraction import Cut

MAX_POINTS = 1 << 17  # points that are evaluated at once
NUDGE = 1e-6  # cells by which points on edges are moved to be inside of a triangle
# Towards the inside of each of the eight triangles around a sample. All borders of patches and of leaf triangles are along or between
# these.
NUDGES = [NUDGE * np.array([x, y]) for x, y in ((2, 1), (1, 2), (-1, 2), (-2, 1), (-2, -1), (-1, -2), (1, -2), (2, -1))]
# Corners of the two triangles of a cell in counterclockwise order, by the parity of x + y at its lower left corner
CELL_CORNERS = np.array([[[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], [[(0, 0), (1, 0), (0, 1)], [(1, 0), (1, 1), (0, 1)]]])


class HeightQuery:
    """Finds heights of one store, and keeps the patches used last. One thread at a time may use it.

    damages: sentences about patches that cannot be read. Heights there are NaN.
    """

    def __init__(self, store: TerrainStore, cut: Cut | None = None, max_bytes: int = DEFAULT_CACHE_BYTES) -> None:
        """cut: the finest patches by default; whole patches count instead of outlines. max_bytes: bytes of patches kept in memory."""
        self._store, self._cache = store, SegmentCache(max_bytes)
        self.damages: list[str] = []
        leaf_level = store.tree.leaf_level
        rows = [np.zeros(0, np.int64)] * leaf_level + [np.arange(len(store.levels[-1].indices))]
        if cut is not None:
            rows = [np.sort(cut.rows[cut.levels == level]) for level in range(leaf_level + 1)]
        self._rows = rows

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the heights (N,) float64 in meters and the unit normals (N, 3) float64 of the triangles at `points` (N, 2), local meters.
        Both are NaN outside of the terrain, in holes, in damaged patches, and at points that are not finite."""
        points = np.asarray(points, np.float64).reshape(-1, 2)
        heights, normals = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
        for start in range(0, len(points), MAX_POINTS):
            part = slice(start, start + MAX_POINTS)
            heights[part], normals[part] = self._find_part(points[part])
        return heights, normals

    def _find_part(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        heights, normals = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        grid = np.stack(self._store.frame.to_grid(*points[finite].T), axis=1)
        last = np.array([self._store.header.columns, self._store.header.rows]) - 1.0
        is_inside = ((grid >= -NUDGE) & (grid <= last + NUDGE)).all(axis=1)
        grid, inside = np.clip(grid[is_inside], 0.0, last), finite[is_inside]
        corners, is_found = self._find_triangles(grid)
        missing = np.flatnonzero(~is_found & _are_on_edges(grid))
        for nudge in NUDGES:  # a point on an edge of a hole or of the field belongs to the triangle that exists
            if not len(missing):
                break
            corners[missing], is_found[missing] = self._find_triangles(np.clip(grid[missing] + nudge, 0.0, last))
            missing = missing[~is_found[missing]]
        found = inside[is_found]
        heights[found], normals[found] = self._evaluate(points[found], corners[is_found])
        return heights, normals

    def _find_triangles(self, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the triangles of points (N, 2) in grid coordinates: corners (N, 3, 3) int64, grid x and y and the height in steps, and
        whether there is a triangle, (N,) bool."""
        corners, is_found = np.zeros((len(grid), 3, 3), np.int64), np.zeros(len(grid), bool)
        levels, rows = self._locate(grid)
        order = np.lexsort((rows, levels))
        order = order[levels[order] >= 0]
        is_start = np.diff(levels[order], prepend=-1).astype(bool) | np.diff(rows[order], prepend=-1).astype(bool)
        bounds = np.append(np.flatnonzero(is_start), len(order)).tolist()
        for start, stop in pairwise(bounds):
            members = order[start:stop]
            patch = self._read(int(levels[members[0]]), int(rows[members[0]]))
            if patch is not None:
                corners[members], is_found[members] = patch.find(grid[members])
        return corners, is_found

    def _locate(self, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the levels and rows (N,) int64 of the patches at points (N, 2) in grid coordinates, levels -1 where there is none.

        It descends through the bintrees by barycentric coordinates: if (a, b, c) are those of the ends of the hypotenuse and of the right
        angle, those in the first child are (c, a - b, 2 b), and in the second one (b - a, c, 2 a).
        """
        store, side = self._store, float(self._store.tree.side)
        x, y = grid.T
        indices = (x < y).astype(np.int64)
        is_lower = indices == 0
        a, b, c = np.where(is_lower, y, side - y), np.where(is_lower, side - x, x), np.abs(x - y)
        levels, rows = np.full(len(grid), -1), np.full(len(grid), -1)
        for level, candidates in enumerate(self._rows):
            if len(candidates):
                wanted = store.levels[level].indices[candidates]
                places = np.minimum(np.searchsorted(wanted, indices), len(wanted) - 1)
                is_here = wanted[places] == indices
                levels[is_here], rows[is_here] = level, candidates[places[is_here]]
            is_second = b > a
            indices = 2 * indices + is_second
            a, b, c = np.where(is_second, b - a, c), np.where(is_second, c, a - b), 2.0 * np.where(is_second, a, b)
            indices[levels >= 0] = -1  # found; no deeper patch has this index
        return levels, rows

    def _read(self, level: int, row: int) -> "_LeafTriangles | _TinTriangles | None":
        """Return the triangles of a patch, None if it is damaged."""
        try:
            return self._cache.get((level, row), lambda: self._prepare(level, row))
        except FileError as error:
            if str(error) not in self.damages:
                self.damages.append(str(error))
            return None

    def _prepare(self, level: int, row: int) -> "_LeafTriangles | _TinTriangles":
        patch, tree = self._store.read(level, row), self._store.tree
        if level < tree.leaf_level:
            return _TinTriangles(patch)
        return _LeafTriangles.create(patch, tree.leaf_cells)

    def _evaluate(self, points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (N,) and normals (N, 3) at points on the planes of triangles with `corners` (N, 3, 3) int64."""
        return evaluate_planes(points, self._store.to_local(*np.moveaxis(corners, -1, 0)))


@dataclass(frozen=True)
class _LeafTriangles:
    """The triangles of a leaf that are not holes.

    low: (2,) int64, lower left corner of the bounding box. heights: (C + 1, C + 1) int32 steps, by x and y; 0 outside of the patch.
    exists: (C, C, 2) bool, for the two triangles of each cell.
    """

    low: np.ndarray
    heights: np.ndarray
    exists: np.ndarray

    @classmethod
    def create(cls, patch: Patch, cells: int) -> "_LeafTriangles":
        low = np.array([patch.x.min(), patch.y.min()], np.int64) // cells * cells  # not all of a leaf at the border of the field exists
        x, y = patch.x - low[0], patch.y - low[1]
        heights, exists = np.zeros((cells + 1, cells + 1), np.int32), np.zeros((cells, cells, 2), bool)
        heights[x, y] = patch.z
        triangles = patch.triangles[~patch.is_hole]
        cell_x, cell_y = x[triangles].min(axis=1), y[triangles].min(axis=1)
        is_upper = y[triangles].sum(axis=1) - 3 * cell_y == 2
        exists[cell_x, cell_y, is_upper.astype(np.int8)] = True
        return cls(low, heights, exists)

    @property
    def nbytes(self) -> int:
        return self.heights.nbytes + self.exists.nbytes

    def find(self, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return corners (N, 3, 3) int64 and whether there is a triangle (N,) bool; see `HeightQuery._find_triangles`."""
        offsets = grid - self.low
        cells = np.clip(offsets.astype(np.int64), 0, len(self.exists) - 1)
        x, y = (offsets - cells).T
        parity = cells.sum(axis=1) % 2
        is_upper = np.where(parity == 0, y > x, x + y > 1.0).astype(np.int8)
        corners = cells[:, None] + CELL_CORNERS[parity, is_upper]
        heights = self.heights[corners[..., 0], corners[..., 1]]
        return np.concatenate([corners + self.low, heights[..., None]], axis=-1), self.exists[cells[:, 0], cells[:, 1], is_upper]


class _TinTriangles:
    """The triangles of a patch above the leaves that are not holes."""

    def __init__(self, patch: Patch) -> None:
        self._vertices = np.stack([patch.x, patch.y, patch.z], axis=1).astype(np.int64)
        self._triangles = patch.triangles[~patch.is_hole]
        self._search = TriangleSearch(self._vertices[:, :2].astype(np.float64), self._triangles) if len(self._triangles) else None

    @property
    def nbytes(self) -> int:
        return self._vertices.nbytes + self._triangles.nbytes + (self._search.nbytes if self._search is not None else 0)

    def find(self, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._search is None:
            return np.zeros((len(grid), 3, 3), np.int64), np.zeros(len(grid), bool)
        found = self._search.find(grid)
        return self._vertices[self._triangles[found]], found >= 0


def _are_on_edges(grid: np.ndarray) -> np.ndarray:
    """Return whether points (N, 2) are on a line of the grid or on a diagonal, where all borders of patches and leaf triangles are."""
    x, y = grid.T
    lines = np.stack([x, y, x + y, x - y])
    return (np.abs(lines - np.rint(lines)) < 4.0 * NUDGE).any(axis=0)
