"""Readers of elevation models by file name extension. Both terrain tools open them here."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..files.array_files import map_array, read_raw_window
from ..files.complete_files import PNG_SIGNATURE
from ..files.file_access import convert_os_errors
from ..files.geotiff import GeoReference
from ..files.height_maps import check_numeric, check_size
from ..geometry.placements import Placement, unplaced
from .ascii_grids import open_ascii_grid
from .positions import complete_georeference, find_position
from .sources import HeightSource, SourceContext, find_void_heights, flip, to_heights, warn_of_steps
from .tiff_sources import open_tiff_source

HGT_NAME = re.compile(r"(?:^|[^A-Za-z])([NS])(\d\d)_?([EW])(\d{3})(?![0-9])", re.IGNORECASE)
HGT_SHAPES = {  # rows and columns by bytes of the file: 3", 1", 1" with 2" along parallels in the far north, and 0.5"
    2 * rows * columns: (rows, columns) for rows, columns in ((1201, 1201), (3601, 1801), (3601, 3601), (7201, 7201))
}
FLOAT_IMAGES = (".exr", ".hdr")
IMAGE_EXTENSIONS = (".png", *FLOAT_IMAGES, ".jpg", ".jpeg", ".webp", ".bmp")
PNG_DEPTH, PNG_COLOR_TYPE, PNG_PALETTE = 24, 25, 3  # bytes of the header, and the value of a palette


def open_source(path: Path, context: SourceContext) -> HeightSource:
    """Open one elevation model by its file name extension.

    Raises:
        FileError: it is none, or is damaged.
    """
    opener = OPENERS.get(path.suffix.lower())
    if opener is None:
        raise FileError(f'"{path}" is no elevation model; its name must end in one of {", ".join(sorted(OPENERS))}.')
    with convert_os_errors(f'"{path}" cannot be read'):
        if path.stat().st_size == 0:
            raise FileError(f'The file "{path}" is empty.')
        return opener(path, context)


def _open_hgt_source(path: Path, _context: SourceContext) -> HeightSource:
    match = HGT_NAME.search(path.name)
    if match is None:
        raise FileError(f'The name of "{path}" must have the position of its south-west corner, as in "N46E008.hgt".')
    size = path.stat().st_size
    shape = HGT_SHAPES.get(size)
    if shape is None:
        *sizes, last = (f"{count:,}" for count in HGT_SHAPES)
        raise FileError(f'"{path}" has {size:,} bytes; an SRTM tile has {", ".join(sizes)} or {last}, so unpack or copy it again.')
    south, west = (int(match[2 * axis + 2]) * (-1 if match[2 * axis + 1] in "SsWw" else 1) for axis in range(2))
    step = (1.0 / (shape[1] - 1), 1.0 / (shape[0] - 1))
    placement = Placement((float(west), float(south)), step, is_geographic=True, code="EPSG:4326")
    dtype = np.dtype(">i2")
    return HeightSource(path, shape, placement, _raw_reader(path, 0, dtype, shape), 1.0, void_heights=find_void_heights(dtype, 1.0))


def _open_array_source(path: Path, context: SourceContext) -> HeightSource:
    mapped = map_array(path)
    if mapped.ndim != 2:
        raise FileError(f'"{path}" contains an array with {mapped.ndim} axes; heights have 2.')
    check_numeric(path, mapped.dtype)
    read = _raw_reader(path, mapped.offset, mapped.dtype, mapped.shape, is_transposed=not mapped.flags.c_contiguous)
    step = 1.0 if mapped.dtype.kind in "iu" else None
    placement = unplaced(context.cell_size)
    return HeightSource(path, mapped.shape, placement, read, step, void_heights=find_void_heights(mapped.dtype, 1.0))


def _raw_reader(
    path: Path, offset: int, dtype: np.dtype, shape: tuple[int, int], is_transposed: bool = False
) -> Callable[[slice, slice], np.ndarray]:
    """Return the reader of an uncompressed array (H, W) with row 0 in the north, stored column by column if it is transposed."""

    def read(rows: slice, columns: slice) -> np.ndarray:
        window = flip(rows, shape[0])
        try:
            with path.open("rb", buffering=0) as file:
                if is_transposed:
                    values = read_raw_window(file, offset, dtype, shape[0], columns, window).T
                else:
                    values = read_raw_window(file, offset, dtype, shape[1], window, columns)
        except EOFError as error:
            raise FileError(f'"{path}" is truncated; copy the file again.') from error
        return to_heights(values.astype(dtype.newbyteorder("=")), None, 1.0)[::-1]

    return read


def _open_ascii_source(path: Path, context: SourceContext) -> HeightSource:
    grid = open_ascii_grid(path)

    def read(rows: slice, columns: slice) -> np.ndarray:
        return to_heights(grid.read(flip(rows, grid.shape[0]), columns, context.cache), grid.no_data, 1.0)[::-1]

    return HeightSource(path, grid.shape, grid.placement, read, None, grid.warnings, block_rows=grid.block_rows)


def _open_image_source(path: Path, context: SourceContext) -> HeightSource:
    if context.read_image is None:
        raise FileError(f'"{path}" is an image, which only Blender can read; convert it to a GeoTIFF, or use Farfield in Blender.')
    bits = None if path.suffix.lower() in FLOAT_IMAGES else 8
    with path.open("rb") as file:
        header = file.read(PNG_COLOR_TYPE + 1)
    if header.startswith(PNG_SIGNATURE) and len(header) > PNG_COLOR_TYPE:
        bits = header[PNG_DEPTH]
        if header[PNG_COLOR_TYPE] == PNG_PALETTE and not context.accepts_colors:
            raise FileError(f'"{path}" is an image with a palette, no elevation model; save it as gray values with 16 bits.')
    heights = context.read_image(path)
    check_size(path, heights.size, heights.itemsize)
    step = None if bits is None else context.image_height / (2**bits - 1)
    position = find_position(path, complete_georeference(path, GeoReference()), heights.shape, context.cell_size)
    flipped = position.is_south_up  # Row 0 of `heights` is the last row of the file.

    def read(rows: slice, columns: slice) -> np.ndarray:
        window = to_heights(heights[flip(rows, len(heights)) if flipped else rows, columns], None, context.image_height)
        return window[::-1] if flipped else window

    warnings = (*position.warnings, *(warn_of_steps(path, bits) if bits is not None else ()))
    return HeightSource(path, heights.shape, position.placement, read, step, warnings, is_gray=True)


OPENERS: dict[str, Callable[[Path, SourceContext], HeightSource]] = {
    ".tif": open_tiff_source,
    ".tiff": open_tiff_source,
    ".hgt": _open_hgt_source,
    ".asc": _open_ascii_source,
    ".npy": _open_array_source,
    **dict.fromkeys(IMAGE_EXTENSIONS, _open_image_source),
}
