"""Rasterization of triangles: covered pixels, depth buffer, flat colors, and what each pixel shows of a surface."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..arrays import concatenate_ranges
from ..geometry.transforms import cross

CHUNK_PIXELS, CHUNK_ROWS = 1 << 18, 1 << 15  # at once
TOLERANCE = 1e-7  # pixels outside of an edge that count as on it, so that rounding leaves no gap between two triangles


def rasterize(corners: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels whose centers lie in triangles, some triangles at a time: triangle indices (N,), pixel indices (N,), row by row
    from the bottom, and barycentric coordinates (N, 3).

    Args:
        corners: (T, 3, 2) float64 in pixels, from the lower left corner of the image. size: width and height.
    """
    for triangles, y, left, lengths in _find_spans(corners, size):
        a, b, c = corners[triangles].transpose(1, 2, 0)
        area = _cross(b - a, c - a)
        opposite = ((b, c), (c, a), (a, b))
        gradients = [(start[1] - end[1]) / area for start, end in opposite]  # Change of barycentric coordinates per column.
        center = np.stack([left + 0.5, y + 0.5])
        values = [_cross(start - center, end - center) / area for start, end in opposite]
        for rows, steps, pixels in _fill_spans(y * size[0] + left, lengths):
            counts = lengths[rows]
            barycentric = [
                np.repeat(value[rows], counts) + steps * np.repeat(gradient[rows], counts)
                for value, gradient in zip(values, gradients, strict=True)
            ]
            yield np.repeat(triangles[rows], counts), pixels, np.stack(barycentric, axis=1)


def _find_spans(corners: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the rows of pixels whose centers lie in triangles, some triangles at a time: triangle indices (R,), rows (R,), first columns
    (R,) int64, and numbers of pixels (R,), none 0. Arguments as for `rasterize`."""
    a, b, c = np.ascontiguousarray(corners.transpose(1, 2, 0))  # pairwise: NumPy reduces short axes slowly
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    limits = np.array(size)[:, None]
    low = np.clip(np.ceil(low - (0.5 + TOLERANCE)), 0, limits)
    high = np.clip(np.floor(high - (0.5 - TOLERANCE)), -1, limits - 1)
    area = _cross(b - a, c - a)
    used = np.flatnonzero((high[0] >= low[0]) & (high[1] >= low[1]) & (area != 0.0))
    low, counts = low[1, used].astype(np.int64), (high - low)[1, used].astype(np.int64) + 1
    a, b, c, area = a[:, used], b[:, used], c[:, used], area[used]
    edges = []
    for start, end in ((b, c), (c, a), (a, b)):
        with np.errstate(divide="ignore", invalid="ignore"):
            gradient = (end[0] - start[0]) / (end[1] - start[1])
        edges.append((start[0] - 0.5, start[1], gradient, np.sign((start[1] - end[1]) * area)))
    ends = np.cumsum(counts)
    start = 0
    while start < len(used):
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK_ROWS, side="right")), start + 1)
        owners = np.repeat(np.arange(start, stop), counts[start:stop])
        y = concatenate_ranges(low[start:stop], counts[start:stop])
        height = y + 0.5
        left, right = np.zeros(len(y)), np.full(len(y), size[0] - 1.0)
        for start_x, start_y, gradient, side in edges:
            with np.errstate(invalid="ignore"):
                crossing = start_x.take(owners) + (height - start_y.take(owners)) * gradient.take(owners)
            direction = side.take(owners)
            np.maximum(left, np.ceil(crossing - TOLERANCE), out=left, where=direction > 0.0)
            np.minimum(right, np.floor(crossing + TOLERANCE), out=right, where=direction < 0.0)
        filled = np.flatnonzero(right >= left)
        lengths = (right[filled] - left[filled]).astype(np.int64) + 1
        yield used[owners[filled]], y[filled], left[filled].astype(np.int64), lengths
        start = stop


def _fill_spans(first: np.ndarray, lengths: np.ndarray) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
    """Yield the pixels of some spans at a time, which begin at the pixels `first` (R,) and have `lengths` (R,): the spans, the number of
    each pixel in its span (N,), and pixel indices (N,)."""
    ends = np.cumsum(lengths)
    begin = 0
    while begin < len(lengths):
        stop = max(int(np.searchsorted(ends, (ends[begin - 1] if begin else 0) + CHUNK_PIXELS, side="right")), begin + 1)
        rows, begin = slice(begin, stop), stop
        steps = concatenate_ranges(0, lengths[rows])
        yield rows, steps, np.repeat(first[rows], lengths[rows]) + steps


def depth_buffer(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the smallest depth (H, W) in every pixel, infinite where there is no triangle.

    Args:
        corners: (T, 3, 2) in pixels. depths: (T, 3), linear in image space, smaller is nearer. size: width and height.
    """
    buffer = np.full(size[0] * size[1], np.inf)
    for triangle, pixels, barycentric in rasterize(corners, size):
        np.minimum.at(buffer, pixels, np.einsum("ni,ni->n", barycentric, depths[triangle]))
    return buffer.reshape(size[1], size[0])


def draw_ids(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest triangle (H, W) int32 in every pixel, -1 where there is none, and its depth (H, W) float32, infinite there.

    Args:
        corners: (T, 3, 2) in pixels. depths: (T, 3), linear in image space, smaller is nearer. size: width and height.
    """
    owners, buffer = np.full(size[0] * size[1], -1, np.int32), np.full(size[0] * size[1], np.inf, np.float32)
    for triangles, y, left, lengths in _find_spans(corners, size):
        start, along = _find_depths(corners[triangles], depths[triangles], left, y)
        for rows, steps, pixels in _fill_spans(y * size[0] + left, lengths):
            counts = lengths[rows]
            found = (np.repeat(start[rows], counts) + steps * np.repeat(along[rows], counts)).astype(np.float32)
            np.minimum.at(buffer, pixels, found)
            nearest = np.flatnonzero(found == buffer.take(pixels))
            owners[pixels[nearest]] = np.repeat(triangles[rows], counts)[nearest]
    return owners.reshape(size[1], size[0]), buffer.reshape(size[1], size[0])


def list_drawn(owners: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which of `count` triangles are drawn, (T,) int64 ascending, and the row among these of each of `owners`, (N,) int32.

    owners: (N,) triangles of covered pixels, see `draw_ids`.
    """
    is_drawn = np.zeros(count, bool)
    is_drawn[owners] = True
    drawn = np.flatnonzero(is_drawn)
    rows = np.empty(count, np.int32)
    rows[drawn] = np.arange(len(drawn))
    return drawn, rows.take(owners)


def _find_depths(corners: np.ndarray, depths: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the depths (R,) of triangles `corners` (R, 3, 2) with `depths` (R, 3) at the pixels `x`, `y` (R,), and by how much they grow
    from one pixel to the next (R,)."""
    a, b, c = corners.transpose(1, 2, 0)
    origin, first, second = depths[:, 0], depths[:, 1] - depths[:, 0], depths[:, 2] - depths[:, 0]
    ab, ac = b - a, c - a
    area = _cross(ab, ac)
    along = (ac[1] * first - ab[1] * second) / area
    across = (ab[0] * second - ac[0] * first) / area
    return origin + (x + 0.5 - a[0]) * along + (y + 0.5 - a[1]) * across, along


def fill_triangles(corners: np.ndarray, colors: np.ndarray, size: tuple[int, int], background: float = 0.0) -> np.ndarray:
    """Return an image (H, W, C) of triangles (T, 3, 2) in pixels, filled with `colors` (T, C); where they overlap the last one wins."""
    image = np.full((size[0] * size[1], colors.shape[1]), background, np.float32)
    for triangle, pixels, _ in rasterize(corners, size):
        image[pixels] = colors[triangle]
    return image.reshape(size[1], size[0], -1)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross products (N,) of vectors (2, N)."""
    return first[0] * second[1] - first[1] * second[0]


class PixelLocations(NamedTuple):
    """What N pixels of an image show: covered (H, W) bool, N of them true; triangles (N,) int32, in the order of the pixels; and their
    barycentric coordinates (N, 3) on the surface."""

    covered: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray

    def interpolate(self, corner_values: np.ndarray) -> np.ndarray:
        """Return the values (N, C) of `corner_values` (T, 3, C) at the pixels."""
        return np.einsum("ni,nic->nc", self.barycentric, corner_values[self.triangles])


def locate_pixels(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> PixelLocations:
    """Return what each pixel shows of triangles with `corners` (T, 3, 2) float64 in pixels and positive `depths` (T, 3) along the optical
    axis, with correct perspective. size: width and height."""
    owners, _ = draw_ids(corners, -1.0 / depths, size)
    covered = owners >= 0
    triangles = owners[covered]
    rows, columns = np.nonzero(covered)
    positions = np.stack([columns, rows], axis=1) + 0.5
    return PixelLocations(covered, triangles, locate_positions(corners[triangles], depths[triangles], positions))


def locate_positions(corners: np.ndarray, depths: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the barycentric coordinates (N, 3), on the surface, of `positions` (N, 2) of an image, each in a triangle of its own with
    `corners` (N, 3, 2) and positive `depths` (N, 3) along the optical axis."""
    offsets = corners - positions[:, None]
    areas = np.stack(
        [cross(offsets[:, 1], offsets[:, 2]), cross(offsets[:, 2], offsets[:, 0]), cross(offsets[:, 0], offsets[:, 1])], axis=1
    )
    weights = areas / depths
    return weights / weights.sum(axis=1, keepdims=True)
