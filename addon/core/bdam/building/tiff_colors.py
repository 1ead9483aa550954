"""Colors of TIFF files by window, as `textures.images.ImageSource` has them."""

import numpy as np

from ...errors import FileError
from ...files.segment_cache import SegmentCache
from ...files.tiffs import PALETTE, TiffImage
from ...imaging.colors import decode_signed_srgb

MAX_SEGMENT_BYTES = 64 << 20  # bytes of a strip or tile that must be decoded as a whole, in every worker
MAX_SAMPLES = 1 << 20  # along each side
MAX_CHANNELS = 4
BIT_DEPTHS = {np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float16), np.dtype(np.float32)}


def check_colors(tiff: TiffImage) -> None:
    """Check that a file holds gray values or colors, with or without alpha, that can be read by window.

    Raises:
        FileError: it does not.
    """
    path = tiff.path
    if tiff.photometric == PALETTE:
        raise FileError(f'"{path}" is an image with a palette; save it as RGB.')
    tiff.check_color_space()
    if tiff.channels > MAX_CHANNELS:
        raise FileError(f'"{path}" has {tiff.channels} channels; save the red, green and blue ones as an RGB file.')
    if tiff.dtype not in BIT_DEPTHS:
        raise FileError(f'"{path}" has pixels of type {tiff.dtype}; save it with 8 or 16 bits per channel.')
    if max(tiff.shape) > MAX_SAMPLES:
        raise FileError(f'"{path}" has {tiff.shape[1]:,} by {tiff.shape[0]:,} pixels; the maximum is {MAX_SAMPLES:,} along each side.')
    if tiff.max_segment_bytes > MAX_SEGMENT_BYTES:
        size = f"{tiff.max_segment_bytes / 2**20:,.0f} MiB"
        raise FileError(f'"{path}" is compressed in parts of {size}, which cannot be read by window; save it with tiles.')
    tiff.check_complete()


class TiffColors:
    """An image source: a TIFF file whose first row is the northern one.

    Integers are sRGB-encoded, floats scene-linear. Pixels whose channels all have the file's number for "no data" are unknown.
    """

    def __init__(self, tiff: TiffImage, cache: SegmentCache) -> None:
        self.shape = (*tiff.shape, self.count_channels(tiff))
        self._tiff, self._cache = tiff, cache
        self._table = decode_signed_srgb(np.arange(65536) / 65535.0).astype(np.float32) if tiff.dtype == np.uint16 else None

    @staticmethod
    def count_channels(tiff: TiffImage) -> int:
        """Return 3 for opaque images, 4 for those with alpha, a mask or a number for "no data"."""
        return 4 if tiff.channels in (2, 4) or tiff.mask is not None or tiff.georeference.no_data is not None else 3

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 3 or 4): uint8, sRGB-encoded, or float32, scene-linear. Raises FileError."""
        values = self._tiff.read(rows, columns, self._cache)
        has_alpha = values.shape[2] in (2, 4)
        colors, alpha = (values[..., :-1], values[..., -1:]) if has_alpha else (values, None)
        is_known = None
        if self._tiff.georeference.no_data is not None:
            is_known = (colors != self._tiff.georeference.no_data).any(axis=2, keepdims=True)
        if self._tiff.mask is not None:
            is_valid = self._tiff.mask.read(rows, columns, self._cache) != 0
            is_known = is_valid if is_known is None else is_known & is_valid
        if self._tiff.is_inverted and colors.dtype.kind == "u":
            colors = ~colors
        opaque = 1
        if values.dtype == np.uint8:
            opaque = 255
        elif values.dtype == np.uint16:
            colors = self._table[colors]
            alpha = None if alpha is None else alpha * np.float32(1.0 / 65535.0)
        else:
            colors = colors.astype(np.float32)
        if colors.shape[2] == 1:
            colors = np.repeat(colors, 3, axis=2)
        if self.shape[2] == 3:
            return colors
        if alpha is None:
            alpha = np.full(colors.shape[:2] + (1,), opaque, colors.dtype)
        if is_known is not None:
            alpha = np.where(is_known, alpha, 0)
        return np.concatenate([colors, alpha], axis=2, dtype=colors.dtype)
