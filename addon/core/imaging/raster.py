"""Rasterization of triangles: covered pixels, depth buffer, flat colors."""

from collections.abc import Iterator

import numpy as np

from ..arrays import concatenate_ranges

CHUNK_PIXELS, CHUNK_ROWS = 1 << 18, 1 << 15  # at once
TOLERANCE = 1e-7  # pixels outside of an edge that count as on it, so that rounding leaves no gap between two triangles


def rasterize(corners: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels whose centers lie in triangles, some triangles at a time: triangle indices (N,), pixel indices (N,), row by row
    from the bottom, and barycentric coordinates (N, 3).

    Args:
        corners: (T, 3, 2) float64 in pixels, from the lower left corner of the image. size: width and height.
    """
    first, second, third = corners.transpose(1, 0, 2)  # pairwise: NumPy reduces short axes slowly
    low = np.clip(np.ceil(np.minimum(np.minimum(first, second), third) - 0.5 - TOLERANCE), 0, size)
    high = np.clip(np.floor(np.maximum(np.maximum(first, second), third) - 0.5 + TOLERANCE), -1, np.array(size) - 1)
    a, b, c = corners.transpose(1, 2, 0)
    used = np.flatnonzero((high >= low).all(axis=1) & (_cross(b - a, c - a) != 0.0))
    low, counts = low[used, 1].astype(np.int64), (high - low)[used, 1].astype(np.int64) + 1
    ends = np.cumsum(counts)
    start = 0
    while start < len(used):
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK_ROWS, side="right")), start + 1)
        chunk = slice(start, stop)
        y = concatenate_ranges(low[chunk], counts[chunk])
        yield from _fill_rows(corners, np.repeat(used[chunk], counts[chunk]), y, size[0])
        start = stop


def _fill_rows(
    corners: np.ndarray, triangles: np.ndarray, y: np.ndarray, width: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield what `rasterize` yields for rows `y` (R,) of `triangles` (R,): the columns between the edges."""
    a, b, c = corners[triangles].transpose(1, 2, 0)
    area = _cross(b - a, c - a)
    height = y + 0.5
    left, right = np.zeros(len(y)), np.full(len(y), width - 1.0)
    opposite = ((b, c), (c, a), (a, b))
    gradients = [(start[1] - end[1]) / area for start, end in opposite]  # of barycentric coordinates, per column
    for (start, end), gradient in zip(opposite, gradients, strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = start[0] + (height - start[1]) * ((end[0] - start[0]) / (end[1] - start[1])) - 0.5
        left = np.maximum(left, np.where(gradient > 0.0, np.ceil(crossing - TOLERANCE), 0.0))
        right = np.minimum(right, np.where(gradient < 0.0, np.floor(crossing + TOLERANCE), width - 1.0))
    lengths = np.maximum(right - left + 1.0, 0.0).astype(np.int64)
    center = np.stack([left + 0.5, height])
    values = [_cross(start - center, end - center) / area for start, end in opposite]
    first = y * width + left.astype(np.int64)
    ends = np.cumsum(lengths)
    begin = 0
    while begin < len(y):
        stop = max(int(np.searchsorted(ends, (ends[begin - 1] if begin else 0) + CHUNK_PIXELS, side="right")), begin + 1)
        rows, begin = slice(begin, stop), stop
        counts = lengths[rows]
        steps = concatenate_ranges(0, counts)
        barycentric = [
            np.repeat(value[rows], counts) + steps * np.repeat(gradient[rows], counts)
            for value, gradient in zip(values, gradients, strict=True)
        ]
        yield np.repeat(triangles[rows], counts), np.repeat(first[rows], counts) + steps, np.stack(barycentric, axis=1)


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
    for triangle, pixels, barycentric in rasterize(corners, size):
        found = np.einsum("ni,ni->n", barycentric, depths[triangle]).astype(np.float32)
        np.minimum.at(buffer, pixels, found)
        is_nearest = found == buffer[pixels]
        owners[pixels[is_nearest]] = triangle[is_nearest]
    return owners.reshape(size[1], size[0]), buffer.reshape(size[1], size[0])


def fill_triangles(corners: np.ndarray, colors: np.ndarray, size: tuple[int, int], background: float = 0.0) -> np.ndarray:
    """Return an image (H, W, C) of triangles (T, 3, 2) in pixels, filled with `colors` (T, C); where they overlap the last one wins."""
    image = np.full((size[0] * size[1], colors.shape[1]), background, np.float32)
    for triangle, pixels, _ in rasterize(corners, size):
        image[pixels] = colors[triangle]
    return image.reshape(size[1], size[0], -1)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross products (N,) of vectors (2, N)."""
    return first[0] * second[1] - first[1] * second[0]
