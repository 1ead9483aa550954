"""Elevation models in TIFF files by window, with their masks and alpha, as GDAL and others write them."""

from pathlib import Path

import numpy as np

from ..errors import FileError
from ..files.tiffs import PALETTE, TiffImage, open_tiff
from .positions import complete_georeference, find_position
from .sources import HeightSource, SourceContext, find_void_heights, flip, to_heights, warn_of_steps

MAX_CHANNELS = 16  # Images with more are no height maps.
MAX_STEP_ERROR = 1e-6  # steps by which an offset may differ from a whole number of them


def open_tiff_source(path: Path, context: SourceContext) -> HeightSource:
    """Open the first image of a TIFF file as an elevation model.

    Unsigned integers without any tag of a map or a world file are gray values; all other samples are elevations. Where a mask or alpha is
    0, heights are unknown.

    Raises:
        FileError: it holds no heights, is damaged, or cannot be read by window.
    """
    tiff = open_tiff(path)
    _check_heights(tiff, context)
    tiff.check_complete()
    reference = complete_georeference(path, tiff.georeference)
    position = find_position(path, reference, tiff.shape, context.cell_size)
    is_gray = tiff.dtype.kind in "ub" and not tiff.is_map and reference.affine is None and (reference.scale, reference.offset) == (1.0, 0.0)
    scale, offset = reference.scale * reference.vertical_unit, reference.offset * reference.vertical_unit
    if is_gray:
        scale, offset = _scale_gray(tiff, context.image_height)

    def read(rows: slice, columns: slice) -> np.ndarray:
        window = rows if position.is_south_up else flip(rows, tiff.shape[0])
        samples = tiff.read(window, columns, context.cache)
        heights = to_heights(_select_heights(samples, tiff), reference.no_data, scale, offset)
        if is_gray and tiff.palette is not None:
            colors = tiff.palette.mean(axis=1, dtype=np.float32).take(samples[:, :, 0].astype(np.int64), mode="clip")
            heights = np.where(np.isnan(heights), heights, colors * np.float32(scale))
        if tiff.alpha is not None:
            heights[samples[:, :, tiff.alpha] == 0] = np.nan
        if tiff.mask is not None:
            heights[tiff.mask.read(window, columns, context.cache)[:, :, 0] == 0] = np.nan
        return heights if position.is_south_up else heights[::-1]

    has_steps = tiff.dtype.kind in "iu" and (is_gray or abs(offset / scale - round(offset / scale)) < MAX_STEP_ERROR)
    bits = 8 * tiff.dtype.itemsize if tiff.dtype.kind == "u" else 1
    return HeightSource(
        path=path,
        shape=tiff.shape,
        placement=position.placement,
        read=read,
        height_step=abs(scale) if has_steps else None,
        warnings=(*position.warnings, *_warn_of_images(tiff), *(warn_of_steps(path, bits) if is_gray else ())),
        is_gray=is_gray,
        block_rows=tiff.segment_shape[0] if tiff.is_compressed else 1,
        is_south_up=position.is_south_up,
        void_heights={} if is_gray or reference.no_data is not None else find_void_heights(tiff.dtype, scale, offset),
        scale=scale,
    )


def _check_heights(tiff: TiffImage, context: SourceContext) -> None:
    path = tiff.path
    tiff.check_color_space()
    if not context.accepts_colors:
        if tiff.photometric == PALETTE:
            raise FileError(f'"{path}" is an image with a palette, no elevation model; save it as gray values.')
        if tiff.channels > 2 or tiff.dtype.kind == "b":
            kind = "a color image" if tiff.channels > 2 else "a black-and-white image"
            raise FileError(f'"{path}" is {kind}, no elevation model; use a file with one height per pixel.')
    if tiff.channels > MAX_CHANNELS:
        raise FileError(f'"{path}" has {tiff.channels:,} channels, no elevation model; use a file with one height per pixel.')
    if tiff.max_segment_bytes > context.max_segment_bytes:
        size = f"{tiff.max_segment_bytes / 2**20:,.0f} MiB"
        raise FileError(f'"{path}" is compressed in parts of {size}, which cannot be read by window; save it with tiles.')


def _scale_gray(tiff: TiffImage, image_height: float) -> tuple[float, float]:
    """Return meters per number of a gray value, or of a color in a palette, and the height of the number 0, which is black or white."""
    if tiff.palette is not None:
        return image_height / np.iinfo(tiff.palette.dtype).max, 0.0
    largest = 1 if tiff.dtype.kind == "b" else np.iinfo(tiff.dtype).max
    return (-image_height / largest, image_height) if tiff.is_inverted else (image_height / largest, 0.0)


def _select_heights(samples: np.ndarray, tiff: TiffImage) -> np.ndarray:
    """Return the channel with the heights, or the mean of the colors, of samples (h, w, channels)."""
    if tiff.channels < 3:
        return samples[:, :, 0]
    with np.errstate(all="ignore"):  # Damaged floats become missing heights.
        return samples[:, :, :3].mean(axis=2, dtype=np.float32)


def _warn_of_images(tiff: TiffImage) -> tuple[str, ...]:
    """Return warnings about what of a file is not read as it is."""
    if tiff.channels == 2 and tiff.alpha is None:
        return (*tiff.warnings, f'"{tiff.path}" has 2 channels; the first one is used.')
    if tiff.channels > 2 and tiff.is_map:
        return (*tiff.warnings, f'"{tiff.path}" is a color image; the mean of its colors is taken as the height.')
    return tiff.warnings
