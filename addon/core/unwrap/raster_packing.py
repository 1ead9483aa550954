"""Packs charts into the tiles of a texture by their rasters: each is turned by quarters and placed where the used rectangle grows least.

Where a chart fits is the correlation of its raster with the occupied cells, by fast Fourier transforms.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft, ndimage

from ..arrays import TINY
from ..geometry.transforms import signed_areas
from ..imaging.raster import rasterize
from ..jobs.progress import Progress, Steps
from .cutting.boundaries import boundary_edges

GRID_SIDE = 320  # Cells per side of a square tile that charts are placed in; the packed square is smaller.
MAX_ASPECT = 8.0  # Square root of the largest ratio of the sides of a tile.
EXPECTED_FILLS = 0.6, 0.4, 0.25, 0.15, 0.08  # Fractions of the tiles that charts cover; the next is tried where they find no place.
MAX_RASTER_FILL = 0.75  # Fraction of the tiles above which the rasters hardly ever fit.
MAX_CHARTS_IN_ALL_ORDERS = 24  # Charts are placed by decreasing bounding box, and up to this number also by length and by area.
SAMPLES_PER_CELL = 2.0  # Along boundary edges.
MAX_CELLS_BY_SHIFTING = 64  # Rasters with fewer cells are tested by shifting, which is faster than a transform.
CHARTS_PER_YIELD = 16


@dataclass(frozen=True)
class Placement:
    """Where a chart goes: tile, quarter turns counter-clockwise, and the lower left corner (2,) of its bounding box, in the unit of uv."""

    tile: int
    turns: int
    corner: np.ndarray


@dataclass(frozen=True)
class RasterGrid:
    """The cells of a tile that charts are placed in. gap: cells between charts. cell_texels: side of a cell, in texels."""

    rows: int
    columns: int
    gap: int
    cell_texels: float

    @classmethod
    def of_tile(cls, size: np.ndarray, margin: float) -> "RasterGrid":
        """Return the grid of a tile of `size` (2,), width and height, with at least `margin` between charts, all in texels."""
        aspect = float(np.clip(np.sqrt(size[0] / size[1]), 1.0 / MAX_ASPECT, MAX_ASPECT))
        columns, rows = round(GRID_SIDE * aspect), round(GRID_SIDE / aspect)
        cell_texels = float(min(size[0] / columns, size[1] / rows))
        return cls(rows, columns, int(np.ceil(margin / cell_texels - 1e-6)), cell_texels)


@dataclass(eq=False)
class _Raster:
    """The cells (H, W) bool that a chart covers, and those that it keeps free; turn_count: how many quarter turns are tried.

    transform: of the covered cells, where a chart is placed several times; None before the first time.
    """

    covered: np.ndarray
    kept_free: np.ndarray
    turn_count: int
    transform: np.ndarray | None = None

    @cached_property
    def turned(self) -> "list[_Raster]":
        """The raster after each quarter turn; without the last two if a half turn changes nothing."""
        is_symmetric = np.array_equal(self.covered, np.rot90(self.covered, 2))
        count = min(self.turn_count, 2) if is_symmetric else self.turn_count
        return [_Raster(np.rot90(self.covered, -turns), np.rot90(self.kept_free, -turns), 1) for turns in range(count)]  # Rows run upwards.


def place_charts(
    uvs: Sequence[np.ndarray],
    triangles: Sequence[np.ndarray],
    may_turn: Sequence[bool],
    grid: RasterGrid,
    max_tiles: int = 1,
    density: float = 0.0,
) -> Steps[list[Placement] | None]:
    """Return the placements of charts in tiles; None where they do not fit.

    Args:
        uvs: (V, 2) of each chart.
        triangles: (T, 3) of each chart.
        may_turn: whether each chart may be turned by quarters.
        grid: of each tile.
        density: texels per unit of uv; tiles are then filled one after the other. 0: as many as possible; charts are then placed where
            the rectangle that all tiles need grows least.
    """
    extents = np.array([np.ptp(uv, axis=0) for uv in uvs])
    area = sum(float(np.abs(signed_areas(uv[faces])).sum()) for uv, faces in zip(uvs, triangles, strict=True))
    min_cell = grid.cell_texels / max_density(uvs, may_turn, grid)
    cells = [max(float(np.sqrt(area / max_tiles / fill)) / GRID_SIDE, min_cell / 0.9) for fill in EXPECTED_FILLS]
    if density > 0.0:
        cells = [grid.cell_texels / density] if min_cell * density <= grid.cell_texels * (1.0 + 1e-9) else []
    for cell in cells:
        expected = area / cell**2 + (1 + grid.gap) * float(extents.sum()) / cell  # Covered cells and those at boundaries, approximately.
        if expected > MAX_RASTER_FILL * GRID_SIDE**2 * max_tiles and density == 0.0:
            continue
        border = (grid.gap + 1) // 2
        rasters = [
            _rasterize((uv - uv.min(axis=0)) / cell, faces, grid.gap, 4 if turns else 1)
            for uv, faces, turns in zip(uvs, triangles, may_turn, strict=True)
        ]
        shapes = np.array([raster.covered.shape for raster in rasters])
        sizes = shapes.prod(axis=1), shapes.max(axis=1), np.array([raster.kept_free.sum() for raster in rasters])
        packings = []
        order_count = 1 if len(uvs) > MAX_CHARTS_IN_ALL_ORDERS else 3
        for size in sizes[:order_count]:
            tiles = _Tiles(grid, border if density > 0.0 else 0, max_tiles, density > 0.0, keeps_transforms=order_count > 1)
            placed = yield from tiles.place_all(rasters, np.argsort(-size, kind="stable"))
            if not placed:
                break
            packings.append((len(tiles.occupied), tiles.side, placed))
        if packings:
            *_, placed = min(packings, key=lambda packing: packing[:2])
            return [Placement(tile, turns, cell * (np.array([column, row]) + border)) for tile, turns, row, column in placed]
    return None


def max_density(uvs: Sequence[np.ndarray], may_turn: Sequence[bool], grid: RasterGrid) -> float:
    """Return the texels per unit of `uvs` (V, 2) at which the largest chart just fits into a tile. may_turn: as for `place_charts`."""
    shape, extents = np.array([grid.columns, grid.rows]), np.array([np.ptp(uv, axis=0) for uv in uvs])
    upright, turned = (extents / shape).max(axis=1), (extents / shape[::-1]).max(axis=1)
    return grid.cell_texels / max(float(np.where(may_turn, np.minimum(upright, turned), upright).max()), TINY)


def _rasterize(uv: np.ndarray, triangles: np.ndarray, gap: int, turn_count: int) -> _Raster:
    """Return the cells that a chart covers, and those that it keeps free so that `gap` cells are between it and others.

    uv: (V, 2) in cells, from 0.
    """
    width, height = (int(extent) + 1 for extent in uv.max(axis=0))
    inside = np.zeros(width * height, bool)
    for _, cells, _ in rasterize(uv[triangles], (width, height)):
        inside[cells] = True
    starts, ends = uv[boundary_edges(triangles)].transpose(1, 0, 2)
    counts = np.ceil(SAMPLES_PER_CELL * np.abs(ends - starts).max(axis=1)).astype(int) + 1
    edge = np.repeat(np.arange(len(starts)), counts)
    t = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)) / np.maximum(counts[edge] - 1, 1)
    columns, rows = (starts[edge] + t[:, None] * (ends - starts)[edge]).astype(int).T
    inside[rows * width + columns] = True
    raster = np.pad(inside.reshape(height, width), (gap + 1) // 2)
    return _Raster(_widen(raster, gap // 2), _widen(raster, (gap + 1) // 2), turn_count)


def _widen(raster: np.ndarray, distance: int) -> np.ndarray:
    return ndimage.maximum_filter(raster, 2 * distance + 1, mode="constant") if distance else raster


class _Tiles:
    """Tiles in which charts are placed.

    Attributes:
        occupied: (rows, columns) float32 of each tile, 0 where it is free.
        side: of the used rectangle in all tiles, relative to that of a tile, times `GRID_SIDE`.
    """

    def __init__(self, grid: RasterGrid, border: int, max_count: int, one_by_one: bool, keeps_transforms: bool) -> None:
        """Prepare empty tiles with a `border` of cells around `grid`.

        one_by_one: place a chart in the first tile where it fits, instead of where all tiles grow least.
        keeps_transforms: of rasters, which take memory, for other orders.
        """
        self._keeps_transforms = keeps_transforms
        self._shape = grid.rows + 2 * border, grid.columns + 2 * border
        self._padded = tuple(fft.next_fast_len(side, real=True) for side in self._shape)
        self._scale = GRID_SIDE / grid.rows, GRID_SIDE / grid.columns
        self._max_count, self._one_by_one = max_count, one_by_one
        self._transforms: dict[int, np.ndarray] = {}
        self.occupied: list[np.ndarray] = []
        self.side = 0.0

    def place_all(self, rasters: list[_Raster], order: np.ndarray) -> Steps[list[tuple[int, int, int, int]]]:
        """Return tile, quarter turns, row and column of each raster, placed in `order`; nothing where they do not fit."""
        placed = [(0, 0, 0, 0)] * len(rasters)
        for count, index in enumerate(order.tolist()):
            if count % CHARTS_PER_YIELD == 0:
                yield Progress(count / len(rasters), "Packing")
            place = self._find_place(rasters[index])
            if place is None:
                return []
            placed[index] = place
        return placed

    def _find_place(self, raster: _Raster) -> tuple[int, int, int, int] | None:
        """Occupy the cells of the best place for a raster, and return tile, quarter turns, row and column; None if there is none."""
        best, place = np.inf, None
        for tile in range(min(len(self.occupied) + 1, self._max_count)):
            if self._one_by_one and place is not None:
                break
            if tile == len(self.occupied):
                self.occupied.append(np.zeros(self._shape, np.float32))
            for turns, turned in enumerate(raster.turned):
                cost, row, column = self._find_best(tile, turned)
                if cost < best:
                    best, place = cost, (tile, turns, row, column)
        if place is None:
            return None
        tile, turns, row, column = place
        if not self.occupied[-1].any() and tile < len(self.occupied) - 1:
            self.occupied.pop()
        kept_free = raster.turned[turns].kept_free
        height, width = kept_free.shape
        self.occupied[tile][row : row + height, column : column + width] += kept_free
        self._transforms.pop(tile, None)
        self.side = max(self.side, self._scale[0] * (row + height), self._scale[1] * (column + width))
        return place

    def _find_best(self, tile: int, raster: _Raster) -> tuple[float, int, int]:
        """Return the lowest cost of placing a raster in a tile, infinite where none fits, with its row and column."""
        height, width = raster.covered.shape
        if height > self._shape[0] or width > self._shape[1]:
            return np.inf, 0, 0
        is_free = self._find_free(tile, raster)
        rows = np.flatnonzero(is_free.any(axis=1))
        if not len(rows):
            return np.inf, 0, 0
        columns = is_free[rows].argmax(axis=1)  # The first one that is free: costs grow along each row.
        cost = np.maximum(np.maximum(self._scale[0] * (rows + height), self._scale[1] * (columns + width)), self.side)
        cost = GRID_SIDE * cost + 0.5 * (self._scale[0] * rows + self._scale[1] * columns)
        best = int(cost.argmin())
        return float(cost[best]), int(rows[best]), int(columns[best])

    def _find_free(self, tile: int, raster: _Raster) -> np.ndarray:
        """Return at which rows and columns of a tile the covered cells of a raster are free."""
        covered = raster.covered
        height, width = (side - length + 1 for side, length in zip(self._shape, covered.shape, strict=True))
        if covered.sum() <= MAX_CELLS_BY_SHIFTING:
            is_taken, is_occupied = np.zeros((height, width), bool), self.occupied[tile] > 0.0
            for row, column in np.argwhere(covered):
                is_taken |= is_occupied[row : row + height, column : column + width]
            return ~is_taken
        if tile not in self._transforms:
            self._transforms[tile] = fft.rfft2(self.occupied[tile], self._padded)
        transform = raster.transform
        if transform is None:
            transform = np.conj(fft.rfft2(covered.astype(np.float32), self._padded))
            raster.transform = transform if self._keeps_transforms else None
        overlap = fft.irfft2(self._transforms[tile] * transform, self._padded)
        return overlap[:height, :width] < 0.5
