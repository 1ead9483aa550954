"""Arc ASCII grids by window. Esri, ArcGIS documentation, Esri ASCII raster format: a header, then the heights row by row from the north.

One pass over the file notes where every row begins; the rows of a window are parsed when they are read.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..files.file_access import convert_os_errors
from ..files.height_maps import MAX_SAMPLES, are_valid_sizes
from ..files.segment_cache import SegmentCache
from ..geometry.coordinate_systems import seem_degrees
from ..geometry.placements import Placement
from .auxiliary_files import read_projection

MAX_HEADER_BYTES = 4096
BLOCK_BYTES = 4 << 20  # bytes of the file that are searched at once
BLOCK_SAMPLES = 1 << 18  # samples that are parsed at once and kept in the cache
DEFAULT_NO_DATA = -9999.0  # the format's number, where the header has none
SIZE_KEYS = {"ncols", "nrows"}
ALIASES = {"nodata": "nodata_value", "xcellsize": "dx", "xdim": "dx", "ycellsize": "dy", "ydim": "dy", "columns": "ncols", "rows": "nrows"}
KEYS = SIZE_KEYS | {"xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "dx", "dy", "nodata_value"}
HEADER_LINE = re.compile(rb"\s*([A-Za-z_][A-Za-z0-9_]*)[ \t]*[ \t:=][ \t]*([^\r\n]*?)[ \t]*(?:\r\n?|\n)")
UNKNOWN_WORDS = {"nan", "null"}  # for heights
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MAX_NUMBER_BYTES = 64  # mean length of a height and the space after it
BAD_NUMBERS = '"{path}" contains something other than numbers in its rows of heights; save it again with decimal points.'


@dataclass(frozen=True, eq=False)
class AsciiGrid:
    """An open grid.

    Attributes:
        path: the file.
        shape: rows and columns.
        placement: position of the grid.
        no_data: the number for unknown heights.
        row_offsets: (rows + 1,) int64, bytes where the rows begin, row 0 in the north, and the end of the file.
        warnings: sentences for the user.
    """

    path: Path
    shape: tuple[int, int]
    placement: Placement
    no_data: float
    row_offsets: np.ndarray
    warnings: tuple[str, ...]

    def read(self, rows: slice, columns: slice, cache: SegmentCache) -> np.ndarray:
        """Return the numbers (h, w) float64 of a window, row 0 in the north.

        Raises:
            FileError: there is something other than numbers, or the file has changed.
        """
        step, parts = self.block_rows, []
        for block in range(rows.start // step, -(-rows.stop // step)):
            start, stop = block * step, min((block + 1) * step, self.shape[0])
            values = cache.get((self.path, block), lambda start=start, stop=stop: self._parse(start, stop))
            parts.append(values[max(rows.start - start, 0) : min(rows.stop, stop) - start, columns])
        return np.concatenate(parts) if parts else np.empty((0, columns.stop - columns.start))

    @property
    def block_rows(self) -> int:
        """Rows that are parsed together."""
        return max(1, BLOCK_SAMPLES // self.shape[1])

    def _parse(self, start: int, stop: int) -> np.ndarray:
        size = int(self.row_offsets[stop] - self.row_offsets[start])
        if size > MAX_NUMBER_BYTES * ((stop - start) * self.shape[1] + 1):
            raise FileError(BAD_NUMBERS.format(path=self.path))
        with convert_os_errors(f'"{self.path}" cannot be read'), self.path.open("rb") as file:
            file.seek(int(self.row_offsets[start]))
            text = file.read(size)
        try:
            return _parse_numbers(text).reshape(stop - start, self.shape[1])
        except ValueError as error:
            raise FileError(BAD_NUMBERS.format(path=self.path)) from error


def _parse_numbers(text: bytes) -> np.ndarray:
    """Return numbers (N,) float64, which may have decimal commas. Asterisks and "null" are unknown. Raises ValueError."""
    try:
        return np.array(text.split(), np.float64)
    except ValueError:
        return np.array(text.lower().replace(b",", b".").replace(b"*", b"nan").replace(b"null", b"nan").split(), np.float64)


def open_ascii_grid(path: Path) -> AsciiGrid:
    """Read the header of an Arc ASCII grid and find its rows. A .prj file of the same name tells degrees, feet and meters apart.

    Raises:
        FileError: it is no such grid, or has fewer or more numbers than its header declares.
    """
    header, start = _read_header(path)
    rows, columns = int(header["nrows"]), int(header["ncols"])
    size = path.stat().st_size
    if rows <= 0 or columns <= 0 or 2 * rows * columns > size - start + 1:
        raise FileError(f'"{path}" cannot contain {columns:,} by {rows:,} heights in {size:,} bytes; it is truncated, so copy it again.')
    if max(rows, columns) > MAX_SAMPLES:
        raise FileError(f'"{path}" has {columns:,} by {rows:,} heights; the maximum is {MAX_SAMPLES:,} along each side.')
    placement, warnings = _place(path, header)
    row_offsets = _find_rows(path, start, rows, columns)
    return AsciiGrid(path, (rows, columns), placement, header.get("nodata_value", DEFAULT_NO_DATA), row_offsets, warnings)


def _read_header(path: Path) -> tuple[dict[str, float], int]:
    """Return the numbers of the header by lower-case keys, and the byte where the heights begin. Keys that are unknown are skipped."""
    with path.open("rb") as file:
        text = file.read(MAX_HEADER_BYTES)
    header: dict[str, float] = {}
    position = len(BYTE_ORDER_MARK) if text.startswith(BYTE_ORDER_MARK) else 0
    while (match := HEADER_LINE.match(text, position)) and (key := match[1].decode("ascii").lower()) not in UNKNOWN_WORDS:
        key, position = ALIASES.get(key, key), match.end()
        try:
            if key in KEYS:
                header[key] = float(match[2].replace(b",", b"."))
        except ValueError as error:
            if key != "nodata_value":
                raise FileError(f'"{path}" has a header with a wrong number for "{key}"; save it again.') from error
            header[key] = math.nan  # GRASS writes an asterisk there, 12D a word, and among the heights too
    is_complete = header.keys() >= SIZE_KEYS and ("cellsize" in header or {"dx", "dy"} <= header.keys())
    if not is_complete or not all(header[key] == int(header[key]) for key in SIZE_KEYS if abs(header[key]) < 2**53):
        raise FileError(f'"{path}" is no Arc ASCII grid: its header lacks ncols, nrows or cellsize.')
    if not all(abs(header[key]) < 2**53 for key in SIZE_KEYS):
        raise FileError(f'"{path}" is no Arc ASCII grid: its header declares an impossible size.')
    return header, position


def _place(path: Path, header: dict[str, float]) -> tuple[Placement, tuple[str, ...]]:
    step = (header["cellsize"],) * 2 if "cellsize" in header else (header["dx"], header["dy"])
    if not are_valid_sizes(step):
        raise FileError(f'"{path}" has cells of size {step[0]:g}; the size must be positive.')
    first = tuple(header.get(f"{axis}llcenter", header.get(f"{axis}llcorner", 0.0) + 0.5 * step[index]) for index, axis in enumerate("xy"))
    is_placed = "xllcorner" in header or "xllcenter" in header
    projection, warnings = read_projection(path), ()
    if projection is not None:
        unit, is_geographic, code = projection.unit, projection.is_geographic, projection.code
    else:
        unit, is_geographic, code = 1.0, is_placed and seem_degrees(first, step), None
        if is_geographic:
            warnings = (f'"{path}" has no .prj file; its cells are so small that its coordinates are taken as degrees.',)
    return Placement((first[0] * unit, first[1] * unit), (step[0] * unit, step[1] * unit), is_geographic, code, is_placed), warnings


def _starts_with_letter(path: Path, position: int) -> bool:
    """Return whether notes begin at a byte of a file, which some programs write after the last row. Words for unknown heights are none."""
    with path.open("rb") as file:
        file.seek(position)
        word = file.read(MAX_NUMBER_BYTES).split(maxsplit=1)[0].decode("latin-1").lower()
    return word[0].isalpha() and word not in UNKNOWN_WORDS


def _find_rows(path: Path, start: int, rows: int, columns: int) -> np.ndarray:
    """Return the bytes (rows + 1,) int64 where the rows begin, and the end of the last one. A row may run over several lines."""
    offsets, count, follows_space, footer = [], 0, True, None
    with path.open("rb") as file:
        file.seek(start)
        position = start
        while block := file.read(BLOCK_BYTES):
            if b"\0" in block:
                raise FileError(BAD_NUMBERS.format(path=path))
            is_text = np.frombuffer(block, np.uint8) > ord(" ")
            begins = is_text.copy()
            begins[1:] &= ~is_text[:-1]
            begins[0] &= follows_space
            words = np.flatnonzero(begins)
            if footer is None and count + len(words) > rows * columns:
                footer = position + int(words[rows * columns - count])
            if count < rows * columns:
                offsets.append(position + words[-count % columns :: columns])
            count, follows_space, position = count + len(words), not is_text[-1], position + len(block)
    if footer is not None and _starts_with_letter(path, footer):
        count, position = rows * columns, footer
    if count != rows * columns:
        advice = "it is truncated, so copy it again" if count < rows * columns else "save it again"
        raise FileError(f'"{path}" contains {count:,} heights; according to its header it must have {rows * columns:,}: {advice}.')
    return np.concatenate([np.concatenate(offsets)[:rows], [position]])
