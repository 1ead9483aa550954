"""Rasterization of triangles: covered pixels, depth buffer, flat colors."""

from collections.abc import Iterator

import numpy as np

from ..arrays import concatenate_ranges

CHUNK_PIXELS = 1 << 21  # candidates at once


def rasterize(corners: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels whose centers lie in triangles, some triangles at a time: triangle indices (N,), pixel indices (N,), row by row
    from the bottom, and barycentric coordinates (N, 3).

    Args:
        corners: (T, 3, 2) float64 in pixels, from the lower left corner of the image. size: width and height.
    """
    width = size[0]
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) - 0.5), -1, np.array(size) - 1).astype(np.int64)
    spans = np.maximum(high - low + 1, 0)
    counts = spans.prod(axis=1)
    order = np.flatnonzero(counts)
    ends = np.cumsum(counts[order])
    start = 0
    while start < len(order):
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK_PIXELS, side="right")), start + 1)
        chunk = order[start:stop]
        triangle = np.repeat(chunk, counts[chunk])
        cell = concatenate_ranges(0, counts[chunk])
        x, y = low[triangle, 0] + cell % spans[triangle, 0], low[triangle, 1] + cell // spans[triangle, 0]
        barycentric = _barycentric(corners[triangle], x + 0.5, y + 0.5)
        is_inside = barycentric.min(axis=1) >= 0.0
        yield triangle[is_inside], (y * width + x)[is_inside], barycentric[is_inside]
        start = stop


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


def _barycentric(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates (N, 3) of points in triangles (N, 3, 2), negative outside and in triangles without area."""
    (ax, ay), (bx, by), (cx, cy) = corners.transpose(1, 2, 0)
    first = (bx - x) * (cy - y) - (by - y) * (cx - x)
    second = (cx - x) * (ay - y) - (cy - y) * (ax - x)
    third = (ax - x) * (by - y) - (ay - y) * (bx - x)
    twice_area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.stack([first, second, third], axis=1) / twice_area[:, None], nan=-1.0, posinf=-1.0, neginf=-1.0)
