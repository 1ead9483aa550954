"""How the pixels of an image file are stored, and their conversion to and from the pixels that image processing works with.

Files hold integers or floats, linear or encoded colors, premultiplied or straight alpha. Image processing uses float32, colors encoded for
display (sRGB) and straight alpha: equal steps are about equally visible, and colors do not change where alpha does.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from ...core.imaging.images import MIN_ALPHA
from ...core.imaging.orientation import ORIENTATIONS, UPRIGHT
from ...core.jobs.chunks import slices

CHUNK_PIXELS = 1 << 19  # converted at once, so that temporary arrays stay small


@dataclass(frozen=True)
class Storage:
    """How pixels are stored.

    dtype: uint8, uint16, float16 or float32; integers stand for 0 to 1. has_alpha: the last channel is alpha. is_linear: colors are linear
    and need the sRGB curve. is_premultiplied: colors are multiplied by alpha. Data that is no color has neither of both.
    """

    dtype: np.dtype
    has_alpha: bool = False
    is_linear: bool = False
    is_premultiplied: bool = False


@dataclass(frozen=True)
class ImageFile:
    """An image read from a file.

    Attributes:
        pixels: (H, W, C) float32, 1 to 4 channels, row 0 at the bottom: colors encoded for display (sRGB) with straight alpha, or data.
        storage: how the file holds them.
        stored: (H, W, C), the array of the file, row 0 at the top.
        format: png, tiff, jpeg or openexr.
        is_color: whether the pixels were read as colors.
        spec: the header, an OpenImageIO.ImageSpec.
    """

    pixels: np.ndarray
    storage: Storage
    stored: np.ndarray
    format: str
    is_color: bool
    spec: Any

    @property
    def orientation(self) -> int:
        """The orientation of the camera, see `core.imaging.orientation`, which is not applied to the pixels."""
        orientation = self.spec.get_int_attribute("Orientation", UPRIGHT)
        return orientation if orientation in ORIENTATIONS else UPRIGHT

    @property
    def depth(self) -> str:
        """The type of a channel: 8, 16, half or float."""
        return {"uint8": "8", "uint16": "16", "float16": "half", "float32": "float"}[self.storage.dtype.name]


def to_pixels(stored: np.ndarray, storage: Storage) -> np.ndarray:
    """Return the pixels (..., C) float32 of an array (..., C) as it is in a file. Values that are not finite stay so."""
    flat = stored.reshape(-1, stored.shape[-1])
    pixels = np.empty(flat.shape, np.float32)
    for rows in slices(len(flat), CHUNK_PIXELS):
        with np.errstate(invalid="ignore", over="ignore"):  # values that are not finite
            pixels[rows] = _decode_chunk(flat[rows], storage)
    return pixels.reshape(stored.shape)


def from_pixels(pixels: np.ndarray, storage: Storage) -> np.ndarray:
    """Return the array (..., C) of `storage.dtype` to write to a file for pixels (..., C). Values outside its range are clipped."""
    flat = pixels.reshape(-1, pixels.shape[-1])
    stored = np.empty(flat.shape, storage.dtype)
    for rows in slices(len(flat), CHUNK_PIXELS):
        with np.errstate(invalid="ignore", over="ignore"):
            stored[rows] = _encode_chunk(flat[rows], storage)
    return stored.reshape(pixels.shape)


def _decode_chunk(stored: np.ndarray, storage: Storage) -> np.ndarray:
    """Return the pixels (N, C) of stored ones."""
    pixels = stored.astype(np.float32)
    if storage.dtype.kind == "u":
        pixels /= np.iinfo(storage.dtype).max
    colors = pixels[:, : _color_count(pixels, storage)]
    if storage.is_premultiplied:
        colors /= _divisors(pixels)
    if storage.is_linear:
        colors[:] = encode_signed_srgb(colors)
    return pixels


def _encode_chunk(pixels: np.ndarray, storage: Storage) -> np.ndarray:
    """Return the pixels (N, C) as they are stored. Inverts `_decode_chunk`."""
    values = pixels.astype(np.float32)
    if storage.dtype.kind == "u":  # before the alpha: a file cannot hold more
        np.clip(values, 0.0, 1.0, out=values)
    colors = values[:, : _color_count(values, storage)]
    if storage.is_linear:
        colors[:] = decode_signed_srgb(colors)
    if storage.is_premultiplied:
        colors *= _divisors(values)
    if storage.dtype.kind == "u":
        return np.nan_to_num(np.rint(values * np.iinfo(storage.dtype).max)).astype(storage.dtype)
    limit = np.finfo(storage.dtype).max
    return np.clip(values, -limit, limit).astype(storage.dtype)


def _color_count(pixels: np.ndarray, storage: Storage) -> int:
    """Return the number of channels that follow the curve for colors: all but alpha, at most three."""
    return min(pixels.shape[1] - storage.has_alpha, 3)


def _divisors(pixels: np.ndarray) -> np.ndarray:
    """Return alpha (N, 1), or 1 where it is too small to divide by."""
    alpha = pixels[:, -1:]
    return np.where(alpha > MIN_ALPHA, alpha, np.float32(1.0))
