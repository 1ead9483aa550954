"""Parts of a texture as images in which the surface continues across the seams of the UV map.

Blending in several resolutions needs what lies around each texel on the surface. A window shows a part of one UV island; around the island
it shows what lies behind its seams: each pixel there is moved to the other side of the nearest seam edge, by the similarity that takes one
side of this edge to the other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix, csgraph
from scipy.spatial import cKDTree

from ...arrays import concatenate_ranges
from ...geometry.edges import Edges
from ...imaging.raster import locate_positions
from ..photographs.surface import Surface
from .texel_map import TexelMap, TexelTile

MAX_GAP = 1e-3  # texels between the UVs of both sides of an edge that is no seam
SEAM_STEP = 1.0  # texels between the points that represent a seam edge


@dataclass(frozen=True)
class SurfaceWindow:
    """An image of a part of the surface.

    shape: rows and columns. tile: the N pixels that show the surface; its texels are those of the texture from which they are taken.
    pixels: (N,) their flat indices in the window. is_own: (N,) bool, pixels whose texels this window, and no other, determines.
    """

    shape: tuple[int, int]
    tile: TexelTile
    pixels: np.ndarray
    is_own: np.ndarray

    def to_image(self, values: np.ndarray) -> np.ndarray:
        """Return an image (H, W, C) of `values` (N, C), or (H, W) of (N,), zero where there is no surface."""
        image = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), values.dtype)
        image[self.pixels] = values
        return image.reshape(*self.shape, *values.shape[1:])

    def from_image(self, image: np.ndarray) -> np.ndarray:
        """Return the values (N, C) or (N,) of an image (H, W, C) or (H, W)."""
        return image.reshape(-1, *image.shape[2:])[self.pixels]


class SurfaceWindows:
    """Divides a texture into windows."""

    def __init__(self, texel_map: TexelMap, surface: Surface, size: int, margin: int) -> None:
        """Prepare windows of `size` texels, with `margin` more on each side, of a surface."""
        self._map, self._size, self._margin = texel_map, size, margin
        self._seams = _Seams(texel_map, surface.mesh.triangles, surface.edges)
        first, second = (surface.edges.interior_halfedges[~self._seams.is_seam] // 3).T
        links = coo_matrix((np.ones(len(first), bool), (first, second)), shape=(len(texel_map.corners),) * 2)
        self._islands = csgraph.connected_components(links, directed=False)[1].astype(np.int32)
        self.count = int(self._islands.max(initial=-1)) + 1

    def __iter__(self) -> Iterator[SurfaceWindow]:
        """Yield windows of which every texel that a triangle covers is the own texel of exactly one."""
        order = np.argsort(self._islands, kind="stable")
        starts = np.searchsorted(self._islands[order], np.arange(self.count + 1))
        for island in range(self.count):
            triangles = order[starts[island] : starts[island + 1]]
            corners = self._map.corners[triangles].reshape(-1, 2)
            low = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, self._map.size)
            high = np.clip(np.ceil(corners.max(axis=0)).astype(int), 0, self._map.size)
            seam_points = self._seams.sample(self._islands == island)
            for row in range(low[1], high[1], self._size):
                for column in range(low[0], high[0], self._size):
                    core = (row, min(row + self._size, high[1]), column, min(column + self._size, high[0]))
                    window = self._show(island, int(self._map.pages[triangles[0]]), core, seam_points)
                    if window is not None:
                        yield window

    def _show(self, island: int, page: int, core: tuple[int, int, int, int], seam_points: "_SeamPoints | None") -> SurfaceWindow | None:
        """Return the window of an island whose own texels lie in the rows and columns of `core` (first, end, first, end)."""
        size, margin = self._map.size, self._margin
        first_row, end_row, first_column, end_column = core
        rows = np.arange(first_row - margin, end_row + margin)
        columns = np.arange(first_column - margin, end_column + margin)
        shape = len(rows), len(columns)
        inside_rows, inside_columns = (rows >= 0) & (rows < size), (columns >= 0) & (columns < size)
        texels = np.full(shape, -1)
        texels[np.ix_(inside_rows, inside_columns)] = (page * size + rows[inside_rows])[:, None] * size + columns[inside_columns]
        triangles = np.where(texels >= 0, self._map.triangles[np.maximum(texels, 0)], -1)
        is_island = (triangles >= 0) & (self._islands[triangles] == island)
        in_core = np.zeros(shape, bool)
        in_core[margin : len(rows) - margin, margin : len(columns) - margin] = True
        if not (is_island & in_core).any():
            return None
        positions = np.stack(np.broadcast_arrays(columns[None, :] + 0.5, rows[:, None] + 0.5), axis=-1)
        pixels = np.flatnonzero(is_island)
        found = [(pixels, triangles.ravel()[pixels], positions.reshape(-1, 2)[pixels], texels.ravel()[pixels])]
        if seam_points is not None:
            outside = np.flatnonzero(~is_island & (distance_transform_edt(~is_island) <= margin))
            found.append(self._continue(outside, positions.reshape(-1, 2)[outside], seam_points))
        pixels, owners, places, sources = (np.concatenate(values) for values in zip(*found, strict=True))
        corners = self._map.corners[owners]
        barycentric = locate_positions(corners, np.ones(corners.shape[:2]), places)
        tile = TexelTile(sources, owners.astype(np.int32), barycentric.astype(np.float32))
        return SurfaceWindow(shape, tile, pixels, (is_island & in_core).ravel()[pixels])

    def _continue(
        self, pixels: np.ndarray, positions: np.ndarray, seam_points: "_SeamPoints"
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what `pixels` (N,) at `positions` (N, 2) next to an island show: those of them that show the surface, with triangles,
        positions and texels there."""
        others, edges = seam_points.carry_over(positions, self._margin)
        columns, rows = np.floor(others).astype(np.int64).T
        size = self._map.size
        is_inside = (edges >= 0) & (columns >= 0) & (columns < size) & (rows >= 0) & (rows < size)
        pixels, others, edges, columns, rows = (values[is_inside] for values in (pixels, others, edges, columns, rows))
        neighbors = seam_points.others[edges]
        texels = (self._map.pages[neighbors].astype(np.int64) * size + rows) * size + columns
        triangles = self._map.triangles[texels]
        kept = (triangles >= 0) & (self._islands[triangles] == self._islands[neighbors])
        return pixels[kept], triangles[kept], others[kept], texels[kept]


class _SeamPoints:
    """Points on the seams of one island, which say how the surface continues behind them."""

    def __init__(self, positions: np.ndarray, edges: np.ndarray, starts: np.ndarray, ends: np.ndarray, others: np.ndarray) -> None:
        """Prepare points (P, 2) of `edges` (P,) whose `starts` and `ends` (E, 2, 2) are positions on this side and on the other one, with
        the triangles `others` (E,) there."""
        self._tree, self._edges = cKDTree(positions), edges
        self._starts, self._ends, self.others = starts, ends, others

    def carry_over(self, positions: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions (N, 2) behind the nearest seam edge of `positions` (N, 2) next to the island, and the indices (N,) of these
        edges; -1 where none lies within `distance`."""
        _, nearest = self._tree.query(positions, distance_upper_bound=distance)
        is_near = nearest < len(self._edges)
        edges = np.where(is_near, self._edges[np.where(is_near, nearest, 0)], -1)
        start, end = _to_complex(self._starts[edges]), _to_complex(self._ends[edges])
        factor = (end[:, 1] - start[:, 1]) / (end[:, 0] - start[:, 0])
        moved = start[:, 1] + factor * (_to_complex(positions) - start[:, 0])
        return np.stack([moved.real, moved.imag], axis=1), edges


class _Seams:
    """The interior edges of a mesh in its UV map, each from both sides.

    triangles: (I, 2) on both sides. starts, ends: (I, 2, 2), positions in texels of the same end on both sides. is_seam: (I,) bool.
    """

    def __init__(self, texel_map: TexelMap, triangles: np.ndarray, edges: Edges) -> None:
        """Find the seams of the mesh with `triangles` (T, 3)."""
        halfedges = edges.interior_halfedges
        self.triangles, corner = halfedges // 3, halfedges % 3
        first, second = (corner + 1) % 3, (corner + 2) % 3
        is_same = triangles[self.triangles[:, 1], first[:, 1]] == triangles[self.triangles[:, 0], first[:, 0]]
        first[:, 1], second[:, 1] = np.where(is_same, first[:, 1], second[:, 1]), np.where(is_same, second[:, 1], first[:, 1])
        self.starts, self.ends = texel_map.corners[self.triangles, first], texel_map.corners[self.triangles, second]
        gaps = [np.abs(ends[:, 0] - ends[:, 1]).max(axis=1) for ends in (self.starts, self.ends)]
        pages = texel_map.pages[self.triangles]
        self.is_seam = (np.maximum(*gaps) > MAX_GAP) | (pages[:, 0] != pages[:, 1])

    def sample(self, is_island: np.ndarray) -> _SeamPoints | None:
        """Return points on the seams of the triangles `is_island` (T,) bool; None if they have no seam."""
        starts, ends, others = [], [], []
        for side in (0, 1):
            own = np.flatnonzero(self.is_seam & is_island[self.triangles[:, side]])
            order = [side, 1 - side]
            starts.append(self.starts[own][:, order])
            ends.append(self.ends[own][:, order])
            others.append(self.triangles[own, 1 - side])
        start, end = np.concatenate(starts), np.concatenate(ends)
        lengths = np.linalg.norm(end[:, 0] - start[:, 0], axis=1)
        used = lengths > 0.0
        start, end, lengths = start[used], end[used], lengths[used]
        if not len(lengths):
            return None
        counts = np.ceil(lengths / SEAM_STEP).astype(np.int64) + 1
        edges = np.repeat(np.arange(len(counts)), counts)
        fractions = concatenate_ranges(0, counts) / np.repeat(counts - 1, counts)
        points = start[edges, 0] + fractions[:, None] * (end[edges, 0] - start[edges, 0])
        return _SeamPoints(points, edges, start, end, np.concatenate(others)[used])


def _to_complex(positions: np.ndarray) -> np.ndarray:
    return positions[..., 0] + 1j * positions[..., 1]
