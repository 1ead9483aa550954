"""Packs charts into a square by their rasters: each is turned by quarters and placed where the square grows least.

Where a chart fits is the correlation of its raster with the occupied texels, by fast Fourier transforms.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from ..geometry.transforms import signed_areas
from ..imaging.raster import rasterize
from .cutting.boundaries import boundary_edges

GRID_SIDE = 320  # Texels per side of what charts are placed in; the packed square is smaller.
EXPECTED_FILLS = 0.6, 0.4, 0.25, 0.15, 0.08  # Fractions of the grid that charts cover; the next is tried where they find no place.
MAX_RASTER_FILL = 0.75  # Fraction of the grid above which the rasters hardly ever fit.
MAX_CHARTS_IN_ALL_ORDERS = 24  # Charts are placed by decreasing bounding box, and up to this number also by length and by area.
SAMPLES_PER_TEXEL = 2.0  # Along boundary edges.
MAX_TEXELS_BY_SHIFTING = 64  # Rasters with fewer texels are tested by shifting, which is faster than a transform.


@dataclass(frozen=True)
class Placement:
    """Quarter turns counter-clockwise of a chart, and where the lower left corner (2,) of its bounding box goes, in the unit of its uv."""

    turns: int
    corner: np.ndarray


def place_charts(uvs: list[np.ndarray], triangles: list[np.ndarray], margin: float) -> tuple[list[Placement], float] | None:
    """Return the placements of charts, and the side of the square that they fill; None where they do not fit into the grid.

    Args:
        uvs: (V, 2) of each chart. triangles: (T, 3) of each chart.
        margin: distance of charts, relative to the side of the square.
    """
    extents = np.array([np.ptp(uv, axis=0) for uv in uvs])
    area = sum(float(np.abs(signed_areas(uv[faces])).sum()) for uv, faces in zip(uvs, triangles, strict=True))
    distance, packings = int(np.ceil(margin * 0.8 * GRID_SIDE - 0.25)), []
    for fill in EXPECTED_FILLS:
        texel = max(float(np.sqrt(area / fill)) / GRID_SIDE, float(extents.max()) / (0.9 * GRID_SIDE))
        texels = area / texel**2 + (1 + 2 * distance) * float(extents.sum()) / texel  # Covered ones and those at boundaries, approximately.
        if texels > MAX_RASTER_FILL * GRID_SIDE**2:
            continue
        rasters = [_rasterize((uv - uv.min(axis=0)) / texel, faces, distance) for uv, faces in zip(uvs, triangles, strict=True)]
        shapes = np.array([raster.shape for raster in rasters])
        sizes = shapes.prod(axis=1), shapes.max(axis=1), np.array([raster.sum() for raster in rasters])
        for size in sizes[: 1 if len(uvs) > MAX_CHARTS_IN_ALL_ORDERS else 3]:
            packing = _place(rasters, np.argsort(-size, kind="stable"))
            if packing is None:
                break
            packings.append(packing)
        if packings:
            break
    if not packings:
        return None
    found, _ = min(packings, key=lambda packing: packing[1])
    placements = [Placement(turns, texel * (np.array([column, row]) + distance)) for turns, row, column in found]
    corners = np.array([placement.corner for placement in placements])
    turned = np.array([extent[::-1] if placement.turns % 2 else extent for extent, placement in zip(extents, placements, strict=True)])
    return placements, float((corners + turned).max() - corners.min())


def _rasterize(uv: np.ndarray, triangles: np.ndarray, distance: int) -> np.ndarray:
    """Return which texels (H, W) a chart touches, bool, widened by `distance` texels. uv: (V, 2) in texels, from 0."""
    width, height = (int(extent) + 1 for extent in uv.max(axis=0))
    raster = np.zeros((height + 2 * distance, width + 2 * distance), bool)
    inside = np.zeros(width * height, bool)
    for _, texels, _ in rasterize(uv[triangles], (width, height)):
        inside[texels] = True
    starts, ends = uv[boundary_edges(triangles)].transpose(1, 0, 2)
    counts = np.ceil(SAMPLES_PER_TEXEL * np.abs(ends - starts).max(axis=1)).astype(int) + 1
    edge = np.repeat(np.arange(len(starts)), counts)
    t = (np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)) / np.maximum(counts[edge] - 1, 1)
    columns, rows = (starts[edge] + t[:, None] * (ends - starts)[edge]).astype(int).T
    inside[rows * width + columns] = True
    raster[distance : distance + height, distance : distance + width] = inside.reshape(height, width)
    return ndimage.binary_dilation(raster, np.ones((3, 3), bool), iterations=distance) if distance else raster


def _place(rasters: list[np.ndarray], order: np.ndarray) -> tuple[list[tuple[int, int, int]], int] | None:
    """Return quarter turns, row and column of each raster, placed in `order`, and the side of the square; None where they do not fit."""
    occupied = np.zeros((GRID_SIDE, GRID_SIDE), np.float32)
    rows, columns = np.arange(GRID_SIDE)[:, None], np.arange(GRID_SIDE)
    placed, side = [(0, 0, 0)] * len(rasters), 0
    for index in order.tolist():
        transform, best = None, (np.inf, 0, 0, 0)
        for turns in range(4):
            raster = np.rot90(rasters[index], -turns)  # Rows run upwards.
            if turns >= 2 and np.array_equal(raster, np.rot90(raster, 2)):
                break
            height, width = raster.shape
            if max(height, width) > GRID_SIDE:
                continue
            if raster.sum() <= MAX_TEXELS_BY_SHIFTING:
                is_free = _find_free_by_shifting(occupied, raster)
            else:
                transform = fft.rfft2(occupied) if transform is None else transform
                is_free = _find_free(transform, raster)
            cost = np.maximum(np.maximum(rows[: is_free.shape[0]] + height, columns[: is_free.shape[1]] + width), side)
            cost = np.where(is_free, GRID_SIDE * cost + 0.5 * (rows[: is_free.shape[0]] + columns[: is_free.shape[1]]), np.inf)
            position = int(cost.argmin())
            if cost.flat[position] < best[0]:
                best = float(cost.flat[position]), turns, *divmod(position, is_free.shape[1])
        if not np.isfinite(best[0]):
            return None
        _, turns, row, column = best
        raster = np.rot90(rasters[index], -turns)
        height, width = raster.shape
        occupied[row : row + height, column : column + width] += raster
        placed[index], side = (turns, row, column), max(side, row + height, column + width)
    return placed, side


def _find_free(transform: np.ndarray, raster: np.ndarray) -> np.ndarray:
    """Return at which rows and columns a raster (H, W) overlaps nothing. transform: of the occupied texels."""
    overlap = fft.irfft2(transform * np.conj(fft.rfft2(raster.astype(np.float32), (GRID_SIDE, GRID_SIDE))), (GRID_SIDE, GRID_SIDE))
    return overlap[: GRID_SIDE - raster.shape[0] + 1, : GRID_SIDE - raster.shape[1] + 1] < 0.5


def _find_free_by_shifting(occupied: np.ndarray, raster: np.ndarray) -> np.ndarray:
    height, width = GRID_SIDE - raster.shape[0] + 1, GRID_SIDE - raster.shape[1] + 1
    is_taken = np.zeros((height, width), bool)
    is_occupied = occupied > 0.0
    for row, column in np.argwhere(raster):
        is_taken |= is_occupied[row : row + height, column : column + width]
    return ~is_taken
