"""The range image of a mesh: its distance R from an axis, by angle around the axis and height (section II.B of the TexMesh paper)."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter

from ...geometry.mesh import scaled_normals
from ...imaging.raster import rasterize

MIN_COLUMNS, MIN_ROWS = 8, 4
MAX_COLUMNS = MAX_ROWS = 1 << 13
MAX_TURN = 0.5 * np.pi  # of a triangle around the axis; one that turns farther is beside the axis or around it
MIN_FACING = 0.05  # cosine between the normal and the direction away from the axis; below, a triangle is seen edge-on
MIN_EXTENT = 1e-9  # in height, relative to the largest
LAYER_TOLERANCE = 1.0  # samples between a point and the surface around its pixel


@dataclass(frozen=True)
class RangeImage:
    """Distances of the outermost surface from an axis, by angle (columns, wrapped) and height (rows, from the bottom).

    Attributes:
        ranges: (rows, columns) float64, 0 in holes. is_known: (rows, columns) bool.
        column_length, row_length: distance between samples, at the mean radius and along the axis.
        pixels: (V,) int64, the pixel of each vertex, row by row.
        is_seen: (V,) bool: whether the vertex is on the surface that its pixel shows.
        hidden, edge_on: fractions of the area that are behind the outermost surface, and edge-on to the axis, such as caps.
    """

    ranges: np.ndarray
    is_known: np.ndarray
    column_length: float
    row_length: float
    pixels: np.ndarray
    is_seen: np.ndarray
    hidden: float
    edge_on: float


def build_range_image(vertices: np.ndarray, triangles: np.ndarray, axis: int) -> RangeImage:
    """Return the range image about the axis through the center of the bounding box. vertices: (V, 3). axis: 0 to 2 for X to Z.

    There are about as many pixels as vertices; columns and rows follow from the extent of the edges in both directions.
    """
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    points = np.roll(vertices - center, 2 - axis, axis=1)
    centroids = points[triangles].mean(axis=1)
    normals = scaled_normals(points[triangles])
    areas = np.linalg.norm(normals, axis=1)
    facing = np.abs(np.einsum("ij,ij->i", normals[:, :2], centroids[:, :2]))
    corner_angles = _unwrap(np.arctan2(points[:, 1], points[:, 0])[triangles])
    is_drawn = (np.ptp(corner_angles, axis=1) < MAX_TURN) & (facing > MIN_FACING * areas * np.hypot(*centroids[:, :2].T))

    low, extent = points[:, 2].min(), max(float(np.ptp(points[:, 2])), MIN_EXTENT * float(np.abs(points).max()))
    size = _choose_size(corner_angles[is_drawn], points[triangles[is_drawn], 2], extent, len(vertices))
    scale = np.array([size[0] / (2.0 * np.pi), size[1] / extent])
    corners = np.stack([(corner_angles + np.pi) * scale[0], (points[triangles, 2] - low) * scale[1]], axis=2)
    ranges = _draw_ranges(points[triangles[is_drawn]], corners[is_drawn], normals[is_drawn], size, low, 1.0 / scale[1])
    is_known = ranges > 0.0

    radius = float(ranges[is_known].mean()) if is_known.any() else 0.0
    lengths = 2.0 * np.pi * radius / size[0], extent / size[1]
    least = np.where(is_known, ranges, np.inf)
    least = minimum_filter(least, 3, mode=("nearest", "wrap")) - LAYER_TOLERANCE * np.sqrt(lengths[0] * lengths[1])
    least = np.where(is_known, least, np.inf).ravel()
    pixels = _pixels_of(points, scale, size, low)
    is_shown = np.hypot(*centroids[:, :2].T) >= least[_pixels_of(centroids, scale, size, low)]
    return RangeImage(
        ranges=ranges,
        is_known=is_known,
        column_length=lengths[0],
        row_length=lengths[1],
        pixels=pixels,
        is_seen=np.hypot(*points[:, :2].T) >= least[pixels],
        hidden=float(areas[is_drawn & ~is_shown].sum() / areas.sum()),
        edge_on=float(areas[~is_drawn].sum() / areas.sum()),
    )


def _unwrap(angles: np.ndarray) -> np.ndarray:
    """Return `angles` (T, 3) plus multiples of a turn, so that each is within half a turn of the first corner's."""
    return angles[:, :1] + np.remainder(angles - angles[:, :1] + np.pi, 2.0 * np.pi) - np.pi


def _choose_size(angles: np.ndarray, heights: np.ndarray, extent: float, count: int) -> tuple[int, int]:
    """Return columns and rows for `count` samples of triangles at `angles` and `heights` (T, 3) of a mesh with this `extent` in height."""
    turn, rise = (
        float(np.sqrt(np.mean((values - np.roll(values, 1, axis=1)) ** 2))) if len(values) else 0.0 for values in (angles, heights)
    )
    ratio = (2.0 * np.pi * rise) / (extent * turn) if turn > 0.0 and rise > 0.0 else 1.0
    columns = int(np.clip(np.rint(np.sqrt(count * ratio)), MIN_COLUMNS, MAX_COLUMNS))
    return columns, int(np.clip(np.rint(count / columns), MIN_ROWS, MAX_ROWS))


def _draw_ranges(
    triangles: np.ndarray, corners: np.ndarray, normals: np.ndarray, size: tuple[int, int], low: float, row_height: float
) -> np.ndarray:
    """Return the largest distance from the axis (rows, columns) in each pixel, 0 where there is none.

    triangles: (T, 3, 3) corner positions, the axis being Z. corners: (T, 3, 2) the same in pixels. normals: (T, 3). low, row_height: of the
    rows.
    """
    columns, rows = size
    ranges = np.zeros(columns * rows)
    shifted = corners.copy()
    shifted[..., 0] -= columns * np.floor(corners[..., 0].min(axis=1, keepdims=True) / columns)
    offsets = np.einsum("ij,ij->i", normals, triangles[:, 0])
    limits = np.hypot(triangles[..., 0], triangles[..., 1]).max(axis=1)
    for found, pixels, _ in rasterize(shifted, (2 * columns, rows)):
        row, column = pixels // (2 * columns), pixels % (2 * columns) % columns
        angle = (column + 0.5) * (2.0 * np.pi / columns) - np.pi
        height = low + (row + 0.5) * row_height
        along = normals[found, 0] * np.cos(angle) + normals[found, 1] * np.sin(angle)
        distance = (offsets[found] - normals[found, 2] * height) / np.where(along != 0.0, along, 1.0)
        np.maximum.at(ranges, row * columns + column, np.clip(distance, 0.0, limits[found]))
    return ranges.reshape(rows, columns)


def _pixels_of(points: np.ndarray, scale: np.ndarray, size: tuple[int, int], low: float) -> np.ndarray:
    """Return the pixels (N,) of `points` (N, 3), row by row; scale: pixels per radian and per unit of height."""
    columns, rows = size
    column = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) * scale[0]).astype(np.int64) % columns
    row = np.clip(np.floor((points[:, 2] - low) * scale[1]).astype(np.int64), 0, rows - 1)
    return row * columns + column
