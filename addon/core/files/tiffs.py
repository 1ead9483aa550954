"""Pixels of TIFF files by window: only the strips or tiles that a window touches are read and decoded (TIFF Revision 6.0; BigTIFF).

tifffile parses the header. Uncompressed files, deflate, LZW, PackBits and Zstandard with the predictors 1 to 3 are decoded here, JPEG and
WebP by Pillow, and everything else by tifffile, as far as it can without the package imagecodecs. imagecodecs would add 26 MB and rasterio
36 MB to the zip of every platform, and neither limits memory by window and cache as terrain of any size needs it.
"""

import logging
import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from ..errors import FileError
from .array_files import read_raw_window
from .file_access import has_companion
from .geotiff import GEO_TAGS, GeoReference, has_elevations, read_georeference
from .height_maps import check_numeric, check_size
from .segment_cache import SegmentCache
from .tiff_codecs import MAX_RATIOS, NONE, decode_segment
from .tiff_pictures import JPEG, WEBP, decode_picture

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

try:
    from lzma import LZMAError
except ImportError:  # Python can be built without it
    LZMAError = EOFError

PREDICTORS = (1, 2, 3)
WHITE_IS_ZERO, PALETTE, YCBCR, OTHER_COLORS = 0, 3, 6, (5, 8, 9, 10)  # values of the tag PhotometricInterpretation; CMYK and kinds of Lab
REDUCED, MASK = 1, 4  # bits of the tag NewSubfileType
ALPHAS = (1, 2)  # values of the tag ExtraSamples
MAX_PAGES = 64  # images of a file that are looked at
AXES = ("YX", "YXS", "SYX")  # Axes of a single image, with its channels last or first.
UNSUPPORTED = re.compile("imagecodecs|COMPRESSION|PREDICTOR")  # in tifffile's messages about what it cannot decode
NAMED = re.compile(r"(COMPRESSION|PREDICTOR)\.(\w+)")
TIFFFILE_ERRORS = (  # raised by tifffile and by decompression for damaged files
    *(ArithmeticError, AttributeError, EOFError, LookupError, RuntimeError, TypeError, ValueError),
    *(LZMAError, struct.error, zlib.error),
)

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its remarks on damaged files do not go to stderr: an error names the file


@dataclass(frozen=True, eq=False)
class TiffImage:
    """The first image of a TIFF file. The file is open only while a window is read.

    Attributes:
        path, file_size: the file and its bytes.
        shape: rows and columns; row 0 is the first of the file, in the north.
        channels: samples per pixel.
        dtype: type of the samples, in the byte order of this machine.
        photometric: value of the tag PhotometricInterpretation.
        palette: (N, 3) uint8, colors of which samples are indices, None if they are none.
        is_map: whether GeoTIFF tags declare it a map.
        alpha: index of the channel that is 0 where a pixel is transparent, None if there is none.
        georeference: where it lies.
        segment_shape: rows and columns of a strip or tile.
        is_tiled, is_planar, is_big_endian: tiles rather than strips; a plane per channel; byte order of the file.
        compression, predictor: values of these tags.
        offsets, byte_counts: (N,) int64, where the segments are, row by row, plane after plane; 0, 0 for one that is not stored.
        decode_other: decodes segments that `tiff_codecs` does not decode.
        page: index of the image in the file.
        mask: the image of the file whose pixels are 0 where those of this one are unknown.
        has_further_images: whether the file contains others that are neither masks nor smaller versions.
    """

    path: Path
    shape: tuple[int, int]
    channels: int
    dtype: np.dtype
    photometric: int
    palette: np.ndarray | None
    is_map: bool
    alpha: int | None
    georeference: GeoReference
    segment_shape: tuple[int, int]
    is_tiled: bool
    is_planar: bool
    compression: int
    predictor: int
    is_big_endian: bool
    offsets: np.ndarray
    byte_counts: np.ndarray
    file_size: int
    decode_other: Callable[[bytes, int], np.ndarray] | None
    page: int = 0
    mask: "TiffImage | None" = None
    has_further_images: bool = False

    @property
    def is_inverted(self) -> bool:
        """Whether the sample 0 is white."""
        return self.photometric == WHITE_IS_ZERO

    def check_color_space(self) -> None:
        """Raise FileError if samples are colors that are not red, green and blue."""
        if self.photometric in OTHER_COLORS or (self.photometric == YCBCR and self.compression in MAX_RATIOS):
            raise FileError(f'"{self.path}" has CMYK, Lab or YCbCr colors; convert it to RGB.')

    @property
    def max_segment_bytes(self) -> int:
        """The memory that the largest strip or tile takes when it is decoded; little for uncompressed strips, which are read in part."""
        if self._is_raw:
            return self.shape[1] * self.dtype.itemsize
        return math.prod(self.segment_shape) * self._segment_channels * self.dtype.itemsize

    @property
    def is_compressed(self) -> bool:
        """Whether strips or tiles are decoded as a whole."""
        return not self._is_raw

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user about what of the file is not read."""
        return (f'"{self.path}" contains several images; the first one is used.',) if self.has_further_images else ()

    def check_complete(self) -> None:
        """Raise FileError unless the file is as long as its header says, and its strips or tiles fit into memory. Call it before `read`."""
        if self.mask is not None:
            self.mask.check_complete()
        check_size(self.path, self.max_segment_bytes, 1)
        across, down = self._segment_counts
        count = across * down * (self.channels if self.is_planar else 1)
        is_complete = len(self.offsets) == len(self.byte_counts) >= count
        if (
            not is_complete
            or (self.offsets < 0).any()
            or (self.byte_counts < 0).any()
            or (self.offsets + self.byte_counts > self.file_size).any()
        ):
            raise FileError(f'"{self.path}" is truncated; copy the file again.')
        if not self.byte_counts.any():
            raise FileError(f'"{self.path}" contains no pixels: none of its parts is stored; save it again.')
        self._check_ratios()
        self._check_decoder()

    def _check_decoder(self) -> None:
        """Raise FileError if the first segment that is stored cannot be decoded, so that nobody waits for it until a build is half done."""
        if self.decode_other is not None:
            with convert_tiff_errors(self.path), self.path.open("rb", buffering=0) as file:
                index = int(np.flatnonzero(self.byte_counts)[0])
                file.seek(int(self.offsets[index]))
                self.decode_other(file.read(int(self.byte_counts[index])), index)

    def _check_ratios(self) -> None:
        """Raise FileError if a strip or tile has fewer bytes than its pixels can be compressed to. The last strip may be shorter."""
        if self.decode_other is None and self.dtype.kind != "b":
            _, down = self._segment_counts
            is_complete = np.arange(len(self.byte_counts)) % down < self.shape[0] // self.segment_shape[0] if not self.is_tiled else True
            needed = math.prod(self.segment_shape) * self._segment_channels * self.dtype.itemsize
            if ((self.byte_counts > 0) & (self.byte_counts < needed / MAX_RATIOS[self.compression]) & is_complete).any():
                raise FileError(f'"{self.path}" is truncated; copy the file again.')

    def read(self, rows: slice, columns: slice, cache: SegmentCache | None = None) -> np.ndarray:
        """Return the samples (h, w, channels) of a window that lies within the image.

        cache: keeps decoded segments for the next windows.

        Raises:
            FileError: the file is damaged or truncated, or has an unsupported compression.
        """
        window = np.empty((rows.stop - rows.start, columns.stop - columns.start, self.channels), self.dtype)
        with convert_tiff_errors(self.path), self.path.open("rb", buffering=0) as file:
            for segment_row, segment_column in product(_touched(rows, self.segment_shape[0]), _touched(columns, self.segment_shape[1])):
                top, left = segment_row * self.segment_shape[0], segment_column * self.segment_shape[1]
                inner_rows = _intersect(rows, top, min(self.segment_shape[0], self.shape[0] - top))
                inner_columns = _intersect(columns, left, min(self.segment_shape[1], self.shape[1] - left))
                target = window[_shift(inner_rows, rows.start), _shift(inner_columns, columns.start)]
                within = _shift(inner_rows, top), _shift(inner_columns, left)
                for plane in range(self.channels if self.is_planar else 1):
                    channels = slice(plane, plane + 1) if self.is_planar else slice(None)
                    target[:, :, channels] = self._read_segment(file, (plane, segment_row, segment_column), within, cache)
        return window

    @property
    def _segment_counts(self) -> tuple[int, int]:
        """Return how many segments lie next to and below each other."""
        rows, columns = (-(-length // side) for length, side in zip(self.shape, self.segment_shape, strict=True))
        return columns, rows

    @property
    def _segment_channels(self) -> int:
        return 1 if self.is_planar else self.channels

    @property
    def _is_raw(self) -> bool:
        return self.decode_other is None and self.compression == NONE and self.predictor == 1 and self.dtype.kind != "b"

    def _read_segment(
        self, file: BinaryIO, position: tuple[int, int, int], within: tuple[slice, slice], cache: SegmentCache | None
    ) -> np.ndarray:
        """Return the part `within` of the segment at (plane, row, column), or one number if it is not stored."""
        across, down = self._segment_counts
        index = (position[0] * down + position[1]) * across + position[2]
        offset, byte_count = int(self.offsets[index]), int(self.byte_counts[index])
        if not offset and not byte_count:
            return self._empty_value()
        rows = self.segment_shape[0] if self.is_tiled else min(self.segment_shape[0], self.shape[0] - position[1] * self.segment_shape[0])
        shape = rows, self.segment_shape[1], self._segment_channels
        if self._is_raw:
            pixel = np.dtype((self._stored_dtype, (shape[2],))) if shape[2] > 1 else self._stored_dtype
            if within[0].stop * shape[1] * shape[2] * self.dtype.itemsize > byte_count:
                raise EOFError("a segment is too short for its pixels")
            return _read_raw(file, offset, pixel, shape, within)

        def decode() -> np.ndarray:
            file.seek(offset)
            data = file.read(byte_count)
            if self.decode_other is not None:
                return self.decode_other(data, index).reshape(-1, *shape[1:])
            return decode_segment(data, self.compression, self.predictor, shape, self._stored_dtype)

        segment = decode() if cache is None else cache.get((self.path, self.page, index), decode)
        return segment[within]

    @property
    def _stored_dtype(self) -> np.dtype:
        return self.dtype.newbyteorder(">" if self.is_big_endian else "<")

    def _empty_value(self) -> np.ndarray:
        """Return the number that segments hold that are not stored: no data, or 0."""
        no_data = self.georeference.no_data
        if no_data is None or (self.dtype.kind != "f" and not (math.isfinite(no_data) and no_data == np.array(no_data).astype(self.dtype))):
            return np.zeros((), self.dtype)
        return np.array(no_data).astype(self.dtype)


def open_tiff(path: Path) -> TiffImage:
    """Read the header of the first image of a TIFF file, and of its mask, which may be a file of its own (GDAL's .msk).

    Raises:
        FileError: it is not a TIFF file, is truncated, has an unsupported compression, or is not a single image of numbers.
    """
    try:
        import tifffile  # imported here so that the core needs only NumPy and SciPy
    except ImportError:
        raise FileError(
            f'"{path}" needs the Python package tifffile, which is missing; install the Farfield extension, which includes it.'
        ) from None
    with convert_tiff_errors(path), tifffile.TiffFile(path) as file:
        size = path.stat().st_size
        image = _describe(path, file.pages.first, size)
        mask, has_further_images = None, False
        for page in _read_further_pages(file):
            if page.subfiletype & MASK:
                is_own = not page.subfiletype & REDUCED and (page.imagelength, page.imagewidth) == image.shape
                mask = _describe(path, page, size) if is_own and mask is None else mask
            else:
                has_further_images |= not page.subfiletype & REDUCED
    external = path.with_name(f"{path.name}.msk")
    if mask is None and has_companion(external):
        other = open_tiff(external)
        mask = other if other.shape == image.shape else None
    return replace(image, mask=mask, has_further_images=has_further_images)


def read_layer_count(path: Path) -> int:
    """Return how many layers the first image of a TIFF file has by its tag ImageDepth, which other readers ignore; 1 if nothing tells."""
    try:
        import tifffile

        with tifffile.TiffFile(path) as file:
            return file.pages.first.imagedepth
    except (ImportError, *TIFFFILE_ERRORS):
        return 1


def _read_further_pages(file: "TiffFile") -> Iterator["TiffPage"]:
    """Yield the images after the first one, up to the first that is damaged."""
    for index in range(1, MAX_PAGES):
        try:
            page = file.pages[index]
        except TIFFFILE_ERRORS:
            return
        yield page


@contextmanager
def convert_tiff_errors(path: Path) -> Iterator[None]:
    """Raise a FileError instead of what tifffile and decompression raise for damaged files."""
    try:
        with np.errstate(all="ignore"):  # Damaged floats become missing heights.
            yield
    except TIFFFILE_ERRORS as error:
        if UNSUPPORTED.search(str(error)):
            found = NAMED.search(str(error))
            name = "an unsupported compression" if found is None else f"the unsupported {found[1].lower()} {found[2]}"
            raise FileError(f'"{path}" has {name}; save it with deflate, for example by "gdal_translate -co COMPRESS=DEFLATE".') from error
        raise FileError(f'"{path}" cannot be read as a TIFF file: it is damaged or has another format; save it again.') from error


def _describe(path: Path, page: "TiffPage", file_size: int) -> TiffImage:
    if page.dtype is None:
        raise FileError(f'"{path}" contains samples of an unknown type; save it with integers or real numbers.')
    if page.size <= 0:
        raise FileError(f'"{path}" contains no samples.')
    if page.axes not in AXES:
        raise FileError(f'"{path}" contains samples along the axes {page.axes}; a height map must be a single image.')
    if min((page.tilelength, page.tilewidth) if page.is_tiled else (page.rowsperstrip,)) <= 0:
        raise ValueError("strips or tiles have no pixels")
    dtype = np.dtype(page.dtype).newbyteorder("=")
    check_numeric(path, dtype)
    offsets, byte_counts = (np.array(numbers, np.int64) for numbers in (page.dataoffsets, page.databytecounts))
    rows, columns = page.imagelength, page.imagewidth
    compression, predictor = int(page.compression), int(page.predictor)
    is_plain = page.bitspersample == (1 if dtype.kind == "b" else 8 * dtype.itemsize) and page.fillorder == 1 and dtype.kind in "iufb"
    has_predictor = predictor in PREDICTORS and (predictor == 1 or dtype.kind != "b") and (predictor != 3 or dtype.kind == "f")
    tags = {code: page.tags[code].value for code in GEO_TAGS if page.tags.get(code) is not None}
    extra = [int(kind) for kind in page.extrasamples]
    alpha = next((page.samplesperpixel - len(extra) + index for index, kind in enumerate(extra) if kind in ALPHAS), None)
    return TiffImage(
        path=path,
        shape=(rows, columns),
        channels=page.samplesperpixel,
        dtype=dtype,
        photometric=int(page.photometric),
        palette=None if page.photometric != PALETTE or page.colormap is None else (page.colormap.T // 257).astype(np.uint8),
        is_map=has_elevations(tags),
        alpha=alpha,
        georeference=read_georeference(tags),
        segment_shape=_segment_shape(page),
        is_tiled=page.is_tiled,
        is_planar=page.axes == "SYX",
        compression=compression,
        predictor=predictor,
        is_big_endian=page.parent.byteorder == ">",
        offsets=offsets,
        byte_counts=byte_counts,
        file_size=file_size,
        decode_other=None if is_plain and compression in MAX_RATIOS and has_predictor else _find_decoder(page),
        page=page.index,
    )


def _segment_shape(page: "TiffPage") -> tuple[int, int]:
    """Return the rows and columns of a strip or tile."""
    return (page.tilelength, page.tilewidth) if page.is_tiled else (min(page.rowsperstrip, page.imagelength), page.imagewidth)


def _find_decoder(page: "TiffPage") -> Callable[[bytes, int], np.ndarray]:
    """Return the decoder of a page that is not plain; raises ValueError if there is none."""
    if page.compression in (JPEG, WEBP) and page.dtype == np.uint8:
        return _find_picture_decoder(page)
    decode, tables, header = page.decode, page.jpegtables, page.jpegheader

    def decode_other(data: bytes, index: int) -> np.ndarray:
        values = decode(data, index, jpegtables=tables, jpegheader=header, _fullsize=page.is_tiled)[0]
        if values is None:
            raise ValueError("a segment is empty")
        return values

    return decode_other


def _find_picture_decoder(page: "TiffPage") -> Callable[[bytes, int], np.ndarray]:
    shape = *_segment_shape(page), 1 if page.axes == "SYX" else page.samplesperpixel
    compression, tables, is_ycbcr = int(page.compression), page.jpegtables or b"", page.photometric == YCBCR
    return lambda data, _index: decode_picture(data, compression, shape, tables, is_ycbcr)


def _read_raw(file: BinaryIO, offset: int, pixel: np.dtype, shape: tuple[int, int, int], within: tuple[slice, slice]) -> np.ndarray:
    """Return the part (h, w, channels) of an uncompressed segment."""
    values = read_raw_window(file, offset, np.dtype((np.void, pixel.itemsize)), shape[1], *within)
    return np.ascontiguousarray(values).view(pixel.base).reshape(*values.shape, shape[2])


def _touched(window: slice, side: int) -> range:
    """Return the indices of segments of `side` pixels that a window touches."""
    return range(window.start // side, -(-window.stop // side))


def _intersect(window: slice, start: int, length: int) -> slice:
    return slice(max(window.start, start), min(window.stop, start + length))


def _shift(window: slice, start: int) -> slice:
    return slice(window.start - start, window.stop - start)
