"""Texels of the finest level from the images.

Colors are filtered in linear light with a tent whose radius is the texel, or the pixel where that is larger, so that small pixels are
averaged and large ones interpolated bilinearly. A texel belongs to the images that contain its center; later images lie over earlier ones.

A texel has the same value in every window: its weights, and the order and the grouping of its sums, depend on its position only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from ...imaging.colors import LINEAR_OF_BYTE
from .filtering import encode_premultiplied
from .grid import TextureGrid

STRIP_PIXELS = 1 << 20  # about how many pixels are read at once
FULL_COVERAGE = 1.0 - 1e-5  # coverage by a mask that counts as complete, in spite of rounding
EDGE_TOLERANCE = 1e-9  # part of an image that rounding may place beyond its last pixel, where the field ends
Axis = tuple[csr_array, np.ndarray, int, int]  # weights (N, pixels), whether each texel is in the image (N,), first pixel, end


class ImageSource(Protocol):
    """An image that is read by window.

    Attributes:
        shape: rows, columns and channels; 3 for RGB, 4 with alpha.
    """

    shape: tuple[int, int, int]

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (H, W, channels) with straight alpha: uint8, sRGB-encoded, or float32, scene-linear. NaN is unknown.

        Raises:
            FileError: the file cannot be read.
        """


@dataclass(frozen=True)
class PlacedImage:
    """An image on the field.

    Attributes:
        source: the pixels.
        corner: grid coordinates (x, y) of the outer corner of pixel (row 0, column 0).
        step: cells from one column to the next along x, and from one row to the next along y; negative where rows or columns run
            downwards. Images of files whose row 0 is the northern one have a negative step along y.
    """

    source: ImageSource
    corner: tuple[float, float]
    step: tuple[float, float]


def resample(
    grid: TextureGrid, level: int, columns: np.ndarray, rows: np.ndarray, images: Sequence[PlacedImage], mask: PlacedImage | None = None
) -> np.ndarray:
    """Return the texels (len(rows), len(columns), 4) uint8 of `images` at a level; see `filtering` for their meaning.

    columns, rows: indices of texels along x and y. Those beyond the border of the field repeat what lies on it. mask: an image over the
    whole field whose alpha, filtered like the images, is multiplied with theirs.

    Raises:
        FileError: an image cannot be read.
    """
    result = None
    for image in images:
        x = _weigh(grid, level, 0, columns, image)
        y = _weigh(grid, level, 1, rows, image)
        if x is None or y is None:
            continue
        layer = _filter_window(image, x, y, _strip_rows(grid, level, image))
        result = layer if result is None else result * (1.0 - layer[..., 3:]) + layer
    if result is None:
        return np.zeros((len(rows), len(columns), 4), np.uint8)
    if mask is not None:
        axes = _weigh(grid, level, 0, columns, mask), _weigh(grid, level, 1, rows, mask)
        coverage = _filter_window(mask, *axes, _strip_rows(grid, level, mask))[..., 3:]
        result = np.where(coverage > FULL_COVERAGE, result, result * coverage)
    return encode_premultiplied(result)


def _weigh(grid: TextureGrid, level: int, axis: int, texels: np.ndarray, image: PlacedImage) -> Axis | None:
    """Return the weights of an image's pixels along an axis, or None if no texel lies in it. Pixels beyond its border do not count."""
    count, step = image.source.shape[1 - axis], image.step[axis]
    positions = (grid.centers(level, axis, texels) - image.corner[axis]) / step  # in pixels from the corner
    tolerance = EDGE_TOLERANCE * count
    is_inside = (positions >= -tolerance) & (positions <= count + tolerance)
    if not is_inside.any():
        return None
    radius = max(1.0, grid.texel(level) / abs(step))
    centers = np.clip(positions, 0.0, count) - 0.5
    first = np.ceil(centers - radius).astype(np.int64)
    taps = first[:, None] + np.arange(int(np.floor(2.0 * radius)) + 1)
    weights = np.maximum(1.0 - np.abs(taps - centers[:, None]) / radius, 0.0) * ((taps >= 0) & (taps < count))
    weights /= weights.sum(axis=1, keepdims=True)
    pixels = np.clip(taps, 0, count - 1)
    low, high = int(pixels[is_inside].min()), int(pixels[is_inside].max()) + 1
    pixels, weights = pixels[is_inside] - low, weights[is_inside].astype(np.float32)
    ends = np.cumsum(np.where(is_inside, taps.shape[1], 0))
    matrix = csr_array((weights.reshape(-1), pixels.reshape(-1), np.concatenate([[0], ends])), shape=(len(texels), high - low))
    return matrix, is_inside, low, high


def _strip_rows(grid: TextureGrid, level: int, image: PlacedImage) -> int:
    """Return how many rows of pixels are summed up at once, the same for all windows of a level."""
    tile_pixels = grid.size / (1 << level) / abs(image.step[0])
    return max(1, int(STRIP_PIXELS / max(tile_pixels, 1.0)))


def _filter_window(image: PlacedImage, x: Axis, y: Axis, strip_rows: int) -> np.ndarray:
    """Return the filtered, premultiplied colors (rows, columns, 4) float32, 0 outside the image."""
    (column_weights, is_inside_x, left, right), (row_weights, is_inside_y, bottom, top) = x, y
    sums = None
    by_pixel = row_weights.tocsc()  # whose columns are cut out quickly
    for start in range(bottom - bottom % strip_rows, top, strip_rows):
        low, high = max(start, bottom), min(start + strip_rows, top)
        strip = _filter_columns(image.source.read(slice(low, high), slice(left, right)), column_weights)
        channels = strip.shape[2]
        part = by_pixel[:, low - bottom : high - bottom].tocsr() @ strip.reshape(high - low, -1)
        sums = part if sums is None else sums + part
    sums = sums.reshape(len(is_inside_y), len(is_inside_x), channels)
    is_inside = is_inside_y[:, None] & is_inside_x
    if channels == 4:
        return sums * is_inside[..., None]
    return np.concatenate([sums, is_inside[..., None].astype(np.float32)], axis=2)


def _filter_columns(pixels: np.ndarray, weights: csr_array) -> np.ndarray:
    """Return a strip of `pixels` (H, W, C) with its columns filtered, (H, columns, 3 or 4) float32, scene-linear and premultiplied."""
    by_column = _to_linear(np.ascontiguousarray(pixels.transpose(1, 0, 2)))
    width, height, channels = by_column.shape
    filtered = weights @ by_column.reshape(width, height * channels)
    return np.ascontiguousarray(filtered.reshape(-1, height, channels).transpose(1, 0, 2))


def to_premultiplied(pixels: np.ndarray) -> np.ndarray:
    """Return the pixels (h, w, 3 or 4) of an `ImageSource` as (h, w, 4) float32, scene-linear and premultiplied; NaN is transparent."""
    linear = _to_linear(pixels)
    if linear.shape[2] == 4:
        return linear
    return np.concatenate([linear, np.ones((*linear.shape[:2], 1), np.float32)], axis=2)


def _to_linear(pixels: np.ndarray) -> np.ndarray:
    """Return pixels (..., 3 or 4) as float32, scene-linear and premultiplied. Opaque bytes keep three channels."""
    if pixels.dtype == np.uint8:
        colors = LINEAR_OF_BYTE.take(pixels[..., :3])
        if pixels.shape[2] == 3:
            return colors
        alpha = pixels[..., 3:] * np.float32(1.0 / 255.0)
    else:
        colors = pixels[..., :3].astype(np.float32)
        is_known = np.isfinite(pixels).all(axis=2, keepdims=True)
        alpha = np.ones(is_known.shape, np.float32) if pixels.shape[2] == 3 else np.clip(pixels[..., 3:], 0.0, 1.0)
        colors, alpha = np.where(is_known, colors, 0.0), np.where(is_known, alpha, 0.0)
    return np.concatenate([colors * alpha, alpha], axis=2, dtype=np.float32)
