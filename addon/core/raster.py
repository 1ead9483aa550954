"""Triangles drawn into pixels: which pixels each covers, and which is nearest in each."""

from collections.abc import Iterator

import numpy as np

CHUNK = 1 << 21  # pixels tried at once


def covered_pixels(corners: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Pixels whose middles lie in triangles, some triangles at a time: numbers of triangles (N,), of pixels (N,), row by row from the
    bottom, and barycentric coordinates (N, 3).

    Args:
        corners: (T, 3, 2) float64 in pixels, from the lower left corner of the picture. size: width and height.
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
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK, side="right")), start + 1)
        chosen = order[start:stop]
        owner = np.repeat(chosen, counts[chosen])
        place = np.arange(len(owner)) - np.repeat(np.cumsum(counts[chosen]) - counts[chosen], counts[chosen])
        x, y = low[owner, 0] + place % spans[owner, 0], low[owner, 1] + place // spans[owner, 0]
        shares = _barycentric(corners[owner], x + 0.5, y + 0.5)
        inside = shares.min(axis=1) >= 0.0
        yield owner[inside], (y * width + x)[inside], shares[inside]
        start = stop


def nearest(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The least depth (H, W) in every pixel, infinite where there is none.

    Args:
        corners: (T, 3, 2) in pixels. depths: (T, 3), linear over the picture, smaller is nearer. size: width and height.
    """
    buffer = np.full(size[0] * size[1], np.inf)
    for owner, pixels, shares in covered_pixels(corners, size):
        np.minimum.at(buffer, pixels, np.einsum("ni,ni->n", shares, depths[owner]))
    return buffer.reshape(size[1], size[0])


def painted(corners: np.ndarray, colors: np.ndarray, size: tuple[int, int], background: float = 0.0) -> np.ndarray:
    """A picture (H, W, C) of triangles (T, 3, 2) in pixels, each in its own of `colors` (T, C); where they overlap the last one shows."""
    picture = np.full((size[0] * size[1], colors.shape[1]), background, np.float32)
    for owner, pixels, _ in covered_pixels(corners, size):
        picture[pixels] = colors[owner]
    return picture.reshape(size[1], size[0], -1)


def _barycentric(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (N, 3) of points in triangles (N, 3, 2), below 0 outside; those without area hold no point."""
    (ax, ay), (bx, by), (cx, cy) = corners.transpose(1, 2, 0)
    first = (bx - x) * (cy - y) - (by - y) * (cx - x)
    second = (cx - x) * (ay - y) - (cy - y) * (ax - x)
    third = (ax - x) * (by - y) - (ay - y) * (bx - x)
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.stack([first, second, third], axis=1) / doubled[:, None], nan=-1.0, posinf=-1.0, neginf=-1.0)
