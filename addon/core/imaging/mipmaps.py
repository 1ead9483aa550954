"""Mipmaps: a texture at halved resolutions, sampled by the size of what a sample covers; and images resized by area."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..arrays import concatenate_ranges
from ..geometry.transforms import cross

STRIP_ROWS = 512  # Rows that are halved at once; even.
CHUNK_SAMPLES = 1 << 16  # Sampled at once, so that intermediate arrays stay in the cache.


@dataclass(frozen=True, eq=False)
class Mipmaps:
    """A texture and its halved versions down to one texel.

    texels: (M, C) float32, all levels one after the other, finest first, row by row from the bottom. starts: (L,) int64, first row of each
    level. sizes: (L, 2) int64, width and height of each level.
    """

    texels: np.ndarray
    starts: np.ndarray
    sizes: np.ndarray

    def level(self, index: int) -> np.ndarray:
        """Return the image (H, W, C) of a level, a view."""
        width, height = (int(side) for side in self.sizes[index])
        start = int(self.starts[index])
        return self.texels[start : start + width * height].reshape(height, width, -1)


def build_mipmaps(texture: np.ndarray, values: np.ndarray | None = None, min_side: int = 1) -> Mipmaps:
    """Return the mipmaps of `texture` (H, W, C), linear values, row 0 at the bottom.

    Each texel is the mean of 2 x 2 texels; where a side is odd, the last texel is the mean of what there is.

    values: (256,) float32, the linear value of each byte of a `texture` of uint8, None if it is linear already. min_side: of the longer
    side, at which halving ends.
    """
    height, width, channels = texture.shape
    sizes = [(width, height)]
    while max(sizes[-1]) > min_side:
        sizes.append(tuple((side + 1) // 2 for side in sizes[-1]))
    counts = np.array([side * other for side, other in sizes], np.int64)
    starts = np.cumsum(counts) - counts
    mipmaps = Mipmaps(np.empty((int(counts.sum()), channels), np.float32), starts, np.array(sizes, np.int64))
    if values is None:
        mipmaps.level(0)[:] = texture
    else:
        for start in range(0, height, STRIP_ROWS):
            rows = slice(start, start + STRIP_ROWS)
            np.take(values, texture[rows], out=mipmaps.level(0)[rows], mode="clip")  # other modes need a buffer
    for index in range(1, len(sizes)):
        fine, coarse = mipmaps.level(index - 1), mipmaps.level(index)
        for start in range(0, len(fine), STRIP_ROWS):
            strip = fine[start : start + STRIP_ROWS]
            coarse[start // 2 : start // 2 + (len(strip) + 1) // 2] = _halve(strip)
    return mipmaps


def sample_mipmaps(mipmaps: Mipmaps, uvs: np.ndarray, footprints: np.ndarray) -> np.ndarray:
    """Sample a texture trilinearly: return the colors (N, C) float32 of samples that cover `footprints` texels of the finest level.

    Args:
        uvs: (N, 2) floats, texture coordinates, v upwards; the texture repeats outside of 0..1. footprints: (N,), side in texels.
    """
    colors = np.empty((len(uvs), mipmaps.texels.shape[1]), np.float32)
    last = len(mipmaps.sizes) - 1
    for start in range(0, len(uvs), CHUNK_SAMPLES):
        chunk = slice(start, start + CHUNK_SAMPLES)
        levels = np.clip(np.log2(np.maximum(footprints[chunk], 1.0)), 0.0, last)
        fine = np.minimum(levels.astype(np.int64), max(last - 1, 0))
        wrapped = uvs[chunk] - np.floor(uvs[chunk])
        found = _sample_level(mipmaps, wrapped, fine)
        if last:
            coarse = _sample_level(mipmaps, wrapped, fine + 1)
            coarse -= found
            coarse *= (levels - fine).astype(np.float32)[:, None]
            found += coarse
        colors[chunk] = found
    return colors


def resize_by_area(image: np.ndarray, size: int) -> np.ndarray:
    """Return a square `image` (S, S, C) float32 resized to (size, size, C), with size <= S: each pixel is the mean over its area."""
    return shrink_by_area(image, (size, size))


def shrink_by_area(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return an `image` (H, W, C) float32 with a `size`, width and height, that is no larger: each pixel is the mean over its area."""
    if size == image.shape[1::-1]:
        return image
    width, height, channels = *size, image.shape[2]
    rows = _area_weights(image.shape[0], height) @ image.reshape(len(image), -1)
    rows = np.ascontiguousarray(rows.reshape(height, -1, channels).swapaxes(0, 1))
    columns = _area_weights(image.shape[1], width) @ rows.reshape(len(rows), -1)
    return np.ascontiguousarray(columns.reshape(width, height, channels).swapaxes(0, 1))


def _area_weights(length: int, size: int) -> csr_array:
    """Return the fractions (size, length) float32 of pixels that texels cover, where `length` texels become `size` pixels."""
    borders = np.arange(size + 1) * (length / size)
    first, last = np.floor(borders[:-1]).astype(np.int64), np.minimum(np.ceil(borders[1:]).astype(np.int64), length)
    counts = last - first
    pixels, texels = np.repeat(np.arange(size), counts), concatenate_ranges(first, counts)
    overlaps = np.minimum(borders[pixels + 1], texels + 1) - np.maximum(borders[pixels], texels)
    return csr_array(((overlaps * (size / length)).astype(np.float32), (pixels, texels)), shape=(size, length))


def measure_footprints(corners: np.ndarray, corner_uvs: np.ndarray, size: tuple[int, int], max_anisotropy: float = 4.0) -> np.ndarray:
    """Return the side (T,) in texels of what a pixel covers of the texture of each triangle.

    The footprint of a pixel is a parallelogram; the result is the square root of its area, but at least its longest axis divided by
    `max_anisotropy`. 1 for triangles without area in the image.

    Args:
        corners: (T, 3, 2) in pixels of the image. corner_uvs: (T, 3, 2). size: width and height of the texture in texels.
    """
    edges = corners[:, 1:] - corners[:, :1]
    uv_edges = (corner_uvs[:, 1:] - corner_uvs[:, :1]) * size
    areas = cross(edges[:, 0], edges[:, 1])
    safe = np.where(areas != 0.0, areas, 1.0)[:, None]
    across = (edges[:, 1, 1, None] * uv_edges[:, 0] - edges[:, 0, 1, None] * uv_edges[:, 1]) / safe  # texels per pixel along x
    along = (edges[:, 0, 0, None] * uv_edges[:, 1] - edges[:, 1, 0, None] * uv_edges[:, 0]) / safe
    sum_of_squares = (across**2 + along**2).sum(axis=1)
    determinant = np.abs(cross(across, along))
    longest = np.sqrt(0.5 * (sum_of_squares + np.sqrt(np.maximum(sum_of_squares**2 - 4.0 * determinant**2, 0.0))))
    return np.where(areas != 0.0, np.maximum(np.sqrt(determinant), longest / max_anisotropy), 1.0)


def _halve(image: np.ndarray) -> np.ndarray:
    """Return the means (ceil(H / 2), ceil(W / 2), C) of 2 x 2 texels of `image`."""
    rows = 0.5 * (image[0::2] + image[1::2]) if len(image) % 2 == 0 else _halve_odd(image)
    columns = rows.swapaxes(0, 1)
    columns = 0.5 * (columns[0::2] + columns[1::2]) if len(columns) % 2 == 0 else _halve_odd(columns)
    return columns.swapaxes(0, 1)


def _halve_odd(rows: np.ndarray) -> np.ndarray:
    """Return the means of pairs of an odd number of `rows`, and the last row."""
    return np.concatenate([0.5 * (rows[0:-1:2] + rows[1::2]), rows[-1:]])


def _sample_level(mipmaps: Mipmaps, uvs: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return bilinear samples (N, C) float32 at `uvs` (N, 2), within 0 to 1, of the level of each sample."""
    widths, heights = (mipmaps.sizes[:, axis].take(levels) for axis in range(2))
    (left, right, x), (below, above, y) = _locate_texels(uvs[:, 0], widths), _locate_texels(uvs[:, 1], heights)
    starts = mipmaps.starts.take(levels)
    below = starts + below * widths
    above = starts + above * widths
    texels = mipmaps.texels
    bottom, top = texels.take(below + left, axis=0), texels.take(above + left, axis=0)
    for row, first in ((bottom, below), (top, above)):
        change = texels.take(first + right, axis=0)
        change -= row
        change *= x
        row += change
    top -= bottom
    top *= y
    bottom += top
    return bottom


def _locate_texels(positions: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the texels (N,) int64 before and after `positions` (N,), fractions of sides with `sizes` (N,) texels that repeat, and the
    fraction (N, 1) float32 of the way between their centers."""
    scaled = positions * sizes - 0.5
    low = np.floor(scaled)
    scaled -= low
    first = low.astype(np.int64)
    second = first + 1
    first += np.where(first < 0, sizes, 0)
    second -= np.where(second >= sizes, sizes, 0)
    return first, second, scaled.astype(np.float32)[:, None]
