"""How triangles cover a texture that repeats outside of 0 to 1."""

import numpy as np

from ...arrays import concatenate_ranges
from ...geometry.transforms import signed_areas
from ...imaging.raster import rasterize

MAX_TILES = 4  # repetitions of a texture along a side of a triangle; only narrow ones have as many without overlaps
MAX_OVERLAP = 0.01  # Fraction of the covered texels that several triangles may cover: seams of islands that touch.
MAX_CHECKED = 1024  # texels per side of the image in which overlaps are looked for
INNER = 1e-3  # smallest barycentric coordinate of a texel that is not on an edge


def wrap_triangles(corner_uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return copies (K, 3, 2) of triangles `corner_uvs` (T, 3, 2), moved by whole numbers so that they meet the square from 0 to 1, one
    per repetition of the texture, and the triangle (K,) of each copy."""
    first, counts = _find_tiles(corner_uvs)
    totals = counts.prod(axis=1)
    owners = np.repeat(np.arange(len(corner_uvs)), totals)
    order = concatenate_ranges(0, totals)
    tiles = first[owners] + np.stack([order % counts[owners, 0], order // counts[owners, 0]], axis=1)
    return corner_uvs[owners] - tiles[:, None], owners


def find_coverage(corner_uvs: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return which texels (H, W) bool of an image with `size`, width and height, triangles (T, 3, 2) cover.
    Where a triangle repeats the image many times, all are covered."""
    coverage = np.zeros(size[0] * size[1], bool)
    if (_find_tiles(corner_uvs)[1] > MAX_TILES).any():
        coverage[:] = True
    else:
        for _, texels, _ in rasterize(wrap_triangles(corner_uvs)[0] * size, size):
            coverage[texels] = True
    return coverage.reshape(size[1], size[0])


def repeats_texture(corner_uvs: np.ndarray, size: tuple[int, int]) -> bool:
    """Return whether triangles (T, 3, 2) use parts of a texture with `size` texels, width and height, more than once: overlapping islands,
    or repetitions. Such parts have no surface of their own."""
    if not len(corner_uvs):
        return False
    if (_find_tiles(corner_uvs)[1] > MAX_TILES).any() or np.abs(signed_areas(corner_uvs)).sum() > 1.0 + MAX_OVERLAP:
        return True
    halvings = max(int(np.ceil(np.log2(max(size) / MAX_CHECKED))), 0)
    width, height = (max(side >> halvings, 1) for side in size)
    counts = np.zeros(width * height, np.int64)
    for _, texels, barycentric in rasterize(wrap_triangles(corner_uvs)[0] * (width, height), (width, height)):
        counts += np.bincount(texels[barycentric.min(axis=1) > INNER], minlength=len(counts))
    return bool((counts > 1).sum() > MAX_OVERLAP * (counts > 0).sum())


def _find_tiles(corner_uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first repetition (T, 2) that each triangle meets along u and v, and their numbers (T, 2), int64."""
    first = np.floor(corner_uvs.min(axis=1)).astype(np.int64)
    last = np.ceil(corner_uvs.max(axis=1)).astype(np.int64)
    return first, np.maximum(last - first, 1)
