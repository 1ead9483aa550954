"""Elevation models in one file each: heights in meters by window, NaN where nothing is known."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.array_files import map_array, read_raw_window
from ...files.ascii_grids import open_ascii_grid
from ...files.file_access import error_reason
from ...files.height_maps import check_numeric, check_size, find_missing
from ...files.segment_cache import SegmentCache
from ...files.tiffs import open_tiff
from ...geometry.placements import Placement, place_map, unplaced

MAX_SEGMENT_BYTES = 256 << 20  # bytes of a strip or tile that must be decoded as a whole
MIN_SAMPLES = 2  # along each side
MAX_SAMPLES = 1 << 20  # along each side
MAX_OFFSET = 1e11  # cells from the world's zero to the field; beyond, float64 has less than five decimals of a cell
HGT_NAME = re.compile(r"([NS])(\d\d)([EW])(\d{3})(?![0-9])", re.IGNORECASE)
HGT_SIDES = {2 * side * side: side for side in (1201, 3601)}  # by bytes of the file
FLOAT_IMAGES = (".exr", ".hdr")
IMAGE_EXTENSIONS = (".png", *FLOAT_IMAGES, ".jpg", ".jpeg", ".webp", ".bmp")
PNG_SIGNATURE, PNG_DEPTH, PNG_COLOR_TYPE, PNG_PALETTE = b"\x89PNG\r\n\x1a\n", 24, 25, 3  # bytes of the header and their value

ReadImage = Callable[[Path], np.ndarray]  # gray values (H, W) float32, row 0 at the bottom, 1 for white


@dataclass(frozen=True, eq=False)
class HeightSource:
    """An open elevation model.

    Attributes:
        path: the file.
        shape: rows and columns, row 0 in the south.
        placement: position of the grid.
        read: returns heights (h, w) float32 of a window within the grid, meters, NaN where unknown.
        height_step: meters between two heights that the file can tell apart, None for floats.
        warnings: sentences for the user.
    """

    path: Path
    shape: tuple[int, int]
    placement: Placement
    read: Callable[[slice, slice], np.ndarray]
    height_step: float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceContext:
    """What readers need in addition to the file: see `terrain_field.FieldSettings`."""

    cell_size: float
    image_height: float
    read_image: ReadImage | None
    cache: SegmentCache


def open_source(path: Path, context: SourceContext) -> HeightSource:
    """Open one elevation model by its file name extension.

    Raises:
        FileError: it is none, is damaged, or has too few or too many samples.
    """
    opener = OPENERS.get(path.suffix.lower())
    if opener is None:
        raise FileError(f'"{path}" is no elevation model; its name must end in one of {", ".join(sorted(OPENERS))}.')
    try:
        if path.stat().st_size == 0:
            raise FileError(f'The file "{path}" is empty.')
        source = opener(path, context)
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error_reason(error)}.') from error
    rows, columns = source.shape
    if min(source.shape) < MIN_SAMPLES:
        raise FileError(f'"{path}" has {columns} by {rows} heights; terrain needs at least {MIN_SAMPLES} along each side.')
    if max(source.shape) > MAX_SAMPLES:
        raise FileError(f'"{path}" has {columns:,} by {rows:,} heights; the maximum is {MAX_SAMPLES:,} along each side.')
    if not all(abs(first) < MAX_OFFSET * step for first, step in zip(source.placement.first, source.placement.step, strict=True)):
        raise FileError(f'"{path}" has its corner at {source.placement.first}, too far away for its cells; correct its position.')
    return source


def to_heights(values: np.ndarray, no_data: float | None, unit: float) -> np.ndarray:
    """Return samples of a file, of any shape, as heights float32 in meters, NaN where they mean "no data". unit: meters of a sample."""
    with np.errstate(all="ignore"):  # numbers that are no heights may overflow
        precision = np.float64 if values.itemsize > 2 else np.float32
        heights = (values if unit == 1.0 else np.multiply(values, unit, dtype=precision)).astype(np.float32)
        heights[find_missing(values, no_data)] = np.nan
    return heights


def _open_tiff_source(path: Path, context: SourceContext) -> HeightSource:
    tiff = open_tiff(path)
    if tiff.is_palette:
        raise FileError(f'"{path}" is an image with a palette, no elevation model; save it as gray values.')
    if tiff.channels > 2 or tiff.dtype.kind == "b":
        kind = "a color image" if tiff.channels > 2 else "a black-and-white image"
        raise FileError(f'"{path}" is {kind}, no elevation model; use a file with one height per pixel.')
    if tiff.max_segment_bytes > MAX_SEGMENT_BYTES:
        size = f"{tiff.max_segment_bytes / 2**20:,.0f} MiB"
        raise FileError(f'"{path}" is compressed in parts of {size}, which cannot be read by window; save it with tiles.')
    tiff.check_complete()
    placement, is_south_up = place_map(path, tiff.georeference, tiff.shape, context.cell_size)
    is_integer = tiff.dtype.kind in "iu"
    is_gray = tiff.dtype.kind == "u" and not tiff.is_map
    unit = context.image_height / np.iinfo(tiff.dtype).max if is_gray else tiff.georeference.vertical_unit

    def read(rows: slice, columns: slice) -> np.ndarray:
        values = tiff.read(rows if is_south_up else _flip(rows, tiff.shape[0]), columns, context.cache)[:, :, 0]
        heights = to_heights(values, tiff.georeference.no_data, unit)
        return heights if is_south_up else heights[::-1]

    warnings = _warn_of_steps(path, unit) if is_gray and tiff.dtype.itemsize == 1 else ()
    return HeightSource(path, tiff.shape, placement, read, unit if is_integer else None, warnings)


def _open_hgt_source(path: Path, _context: SourceContext) -> HeightSource:
    match = HGT_NAME.match(path.name)
    if match is None:
        raise FileError(f'The name of "{path}" must begin with the position of its south-west corner, as in "N46E008.hgt".')
    size = path.stat().st_size
    side = HGT_SIDES.get(size)
    if side is None:
        sizes = " or ".join(f"{count:,}" for count in HGT_SIDES)
        raise FileError(f'"{path}" has {size:,} bytes; an SRTM tile has {sizes}, so unpack or copy it again.')
    south, west = (int(match[2 * axis + 2]) * (-1 if match[2 * axis + 1] in "SsWw" else 1) for axis in range(2))
    placement = Placement((float(west), float(south)), (1.0 / (side - 1),) * 2, is_geographic=True, code="EPSG:4326")
    return HeightSource(path, (side, side), placement, _raw_reader(path, 0, np.dtype(">i2"), (side, side)), 1.0)


def _open_array_source(path: Path, context: SourceContext) -> HeightSource:
    mapped = map_array(path)
    if mapped.ndim != 2:
        raise FileError(f'"{path}" contains an array with {mapped.ndim} axes; heights have 2.')
    check_numeric(path, mapped.dtype)
    read = _raw_reader(path, mapped.offset, mapped.dtype, mapped.shape, is_transposed=not mapped.flags.c_contiguous)
    step = 1.0 if mapped.dtype.kind in "iu" else None
    return HeightSource(path, mapped.shape, unplaced(context.cell_size), read, step)


def _raw_reader(
    path: Path, offset: int, dtype: np.dtype, shape: tuple[int, int], is_transposed: bool = False
) -> Callable[[slice, slice], np.ndarray]:
    """Return the reader of an uncompressed array (H, W) with row 0 in the north, stored column by column if it is transposed."""

    def read(rows: slice, columns: slice) -> np.ndarray:
        window = _flip(rows, shape[0])
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
        return to_heights(grid.read(_flip(rows, grid.shape[0]), columns, context.cache), grid.no_data, 1.0)[::-1]

    return HeightSource(path, grid.shape, grid.placement, read, None, grid.warnings)


def _open_image_source(path: Path, context: SourceContext) -> HeightSource:
    if context.read_image is None:
        raise FileError(f'"{path}" is an image, which only Blender can read; convert it to a GeoTIFF, or use Farfield in Blender.')
    bits = None if path.suffix.lower() in FLOAT_IMAGES else 8
    with path.open("rb") as file:
        header = file.read(PNG_COLOR_TYPE + 1)
    if header.startswith(PNG_SIGNATURE) and len(header) > PNG_COLOR_TYPE:
        bits = header[PNG_DEPTH]
        if header[PNG_COLOR_TYPE] == PNG_PALETTE:
            raise FileError(f'"{path}" is an image with a palette, no elevation model; save it as gray values with 16 bits.')
    heights = context.read_image(path)
    check_size(path, heights.size, heights.itemsize)
    step = None if bits is None else context.image_height / (2**bits - 1)

    def read(rows: slice, columns: slice) -> np.ndarray:
        return to_heights(heights[rows, columns], None, context.image_height)

    warnings = _warn_of_steps(path, step) if step is not None and bits <= 8 else ()
    return HeightSource(path, heights.shape, unplaced(context.cell_size), read, step, warnings)


def _warn_of_steps(path: Path, step: float) -> tuple[str, ...]:
    return (f'"{path}" has 8 bits per pixel, so its heights have steps of {step:.3g} m; use an image with 16 bits or more.',)


def _flip(rows: slice, count: int) -> slice:
    """Return the rows counted from the other side of a grid with `count` rows."""
    return slice(count - rows.stop, count - rows.start)


OPENERS: dict[str, Callable[[Path, SourceContext], HeightSource]] = {
    ".tif": _open_tiff_source,
    ".tiff": _open_tiff_source,
    ".hgt": _open_hgt_source,
    ".asc": _open_ascii_source,
    ".npy": _open_array_source,
    **dict.fromkeys(IMAGE_EXTENSIONS, _open_image_source),
}
