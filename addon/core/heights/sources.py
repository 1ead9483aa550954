"""An open elevation model, whatever its format: heights in meters by window, NaN where nothing is known."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..files.height_maps import find_missing
from ..files.segment_cache import SegmentCache
from ..geometry.placements import Placement
from .voids import VOID_NUMBERS

MAX_SEGMENT_BYTES = 256 << 20  # bytes of a strip or tile that must be decoded as a whole

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
        is_gray: whether the heights are gray values of an image times `SourceContext.image_height`.
        block_rows: rows that are decoded together.
        is_south_up: whether blocks of rows begin in the south, not in the north.
        void_heights: heights that numbers of `VOID_NUMBERS` become, by number; empty where the file declares what is unknown.
        scale: meters per number of the file.
    """

    path: Path
    shape: tuple[int, int]
    placement: Placement
    read: Callable[[slice, slice], np.ndarray]
    height_step: float | None = None
    warnings: tuple[str, ...] = ()
    is_gray: bool = False
    block_rows: int = 1
    is_south_up: bool = False
    void_heights: dict[float, np.float32] = field(default_factory=dict)
    scale: float = 1.0

    def bands(self, samples: int) -> Iterator[slice]:
        """Yield all rows in slices of about `samples` heights, in the order of the file and in whole blocks."""
        count = max(1, samples // (self.shape[1] * self.block_rows)) * self.block_rows
        for start in range(0, self.shape[0], count):
            rows = slice(start, min(start + count, self.shape[0]))
            yield rows if self.is_south_up else flip(rows, self.shape[0])


@dataclass(frozen=True)
class SourceContext:
    """What readers need in addition to the file.

    Attributes:
        cell_size: meters between two samples of a file without a position.
        image_height: meters between black and white of an image.
        read_image: reads images, None where they cannot be read.
        cache: keeps decoded parts of files.
        accepts_colors: whether images with colors, with a palette or in black and white are height maps too.
        max_segment_bytes: bytes of a strip or tile that may be decoded as a whole.
    """

    cell_size: float
    image_height: float
    read_image: ReadImage | None
    cache: SegmentCache
    accepts_colors: bool = False
    max_segment_bytes: int = MAX_SEGMENT_BYTES


def to_heights(values: np.ndarray, no_data: float | None, scale: float, offset: float = 0.0) -> np.ndarray:
    """Return samples of a file, of any shape, as heights float32 in meters, NaN where they mean "no data".

    scale, offset: a height is a sample times the scale, plus the offset.
    """
    with np.errstate(all="ignore"):  # numbers that are no heights may overflow
        precision = np.float64 if values.itemsize > 2 or offset else np.float32
        heights = values if scale == 1.0 else np.multiply(values, scale, dtype=precision)
        heights = (heights + offset if offset else heights).astype(np.float32)
        heights[find_missing(values, no_data)] = np.nan
    return heights


def find_void_heights(dtype: np.dtype, scale: float, offset: float = 0.0) -> dict[float, np.float32]:
    """Return the heights that `to_heights` makes of those of `VOID_NUMBERS` that samples of a type can be."""
    if dtype.kind not in "if":
        return {}
    limits = np.iinfo(dtype) if dtype.kind == "i" else np.finfo(dtype)
    numbers = [number for number in VOID_NUMBERS if limits.min <= number <= limits.max]
    heights = to_heights(np.array(numbers, dtype.newbyteorder("=")), None, scale, offset)
    return {number: height for number, height in zip(numbers, heights, strict=True) if np.isfinite(height)}


def warn_of_steps(path: Path, bits: int) -> tuple[str, ...]:
    """Return a warning if gray values of an image have too few bits for heights."""
    if bits > 8:
        return ()
    return (f'"{path}" has {bits} bits per pixel, so it has at most {2**bits} different heights; use an image with 16 bits or more.',)


def flip(rows: slice, count: int) -> slice:
    """Return the rows counted from the other side of a grid with `count` rows."""
    return slice(count - rows.stop, count - rows.start)
