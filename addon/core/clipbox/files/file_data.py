"""Contents of terrain files: a height map or voxels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...jobs.chunks import slices

MAX_BYTES = 2**31  # of samples in memory; more would not fit beside the boxes and a scene
MAX_PRINTED_BYTES = 2**50  # larger sizes come from damaged headers and may have hundreds of digits
HEIGHT_BYTES = 4  # of a height in memory, whatever its type in the file
CHUNK_SAMPLES = 1 << 20  # samples that are converted at once, so that temporary arrays stay small
NO_DATA_MAGNITUDE = 1e30  # some programs write numbers this large for unknown values without declaring it
NUMERIC_KINDS = "buif"  # NumPy kinds of numbers that can be sampled


@dataclass(frozen=True)
class HeightMap:
    """A height map.

    heights: (H, W) numbers, row 0 in the south (-y). pixel_size: width (along x) and depth (along y) of a pixel in the unit of the heights,
    which are elevations; None where the heights are the gray values of an image, 0 for black and 1 for white. no_data: the number that the
    file declares for unknown heights.
    """

    heights: np.ndarray
    pixel_size: tuple[float, float] | None = None
    no_data: float | None = None


@dataclass(frozen=True)
class Voxels:
    """A voxel model.

    values: (X, Y, Z) numbers, larger values are more solid. spacing: sides of a voxel; only their ratios count. outside: value around the
    model where the file declares it, otherwise it is the smallest of the values.
    """

    values: np.ndarray
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    outside: float | None = None


FileData = HeightMap | Voxels


def min_max_valid(values: np.ndarray) -> tuple[float, float] | None:
    """Return the smallest and the largest valid number of an array of any shape, None if there is none."""
    flat, ranges = values.reshape(-1), []
    for rows in slices(flat.size, CHUNK_SAMPLES):
        chunk = flat[rows]
        chunk = chunk[is_valid(chunk)]
        if chunk.size:
            ranges.append((float(chunk.min()), float(chunk.max())))
    return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None


def is_valid(values: np.ndarray) -> np.ndarray:
    """Return a mask of the values that are finite and not so large that they mean "no data"."""
    return np.abs(values) < NO_DATA_MAGNITUDE if values.dtype.kind == "f" else np.ones(values.shape, bool)


def are_valid_sizes(sizes: tuple[float, ...]) -> bool:
    """Return whether numbers from a header can be pixel or voxel sizes. Many programs write zeros there."""
    return all(1e-9 < size < 1e9 for size in sizes)


def check_size(path: Path, count: int, bytes_per_sample: int) -> None:
    """Raise FileError when the file `path` has no samples, or more than fit into memory.

    bytes_per_sample: of what the reader makes of the samples, 4 or more where it makes floats of them.
    """
    if count <= 0:
        raise FileError(f'"{path}" contains no samples.')
    byte_count = count * bytes_per_sample
    if byte_count > MAX_BYTES:
        size = f"{byte_count / 2**30:,.1f}" if byte_count < MAX_PRINTED_BYTES else f"over {MAX_PRINTED_BYTES // 2**30:,}"
        limit = f"{MAX_BYTES / 2**30:g} GiB"
        raise FileError(f'"{path}" needs {size} GiB of memory for its samples; the maximum is {limit}, so reduce its size.')


def to_native_byte_order(path: Path, values: np.ndarray) -> np.ndarray:
    """Return `values` of a file in the byte order of this machine.

    Raises:
        FileError: they are not numbers that can be sampled.
    """
    if values.dtype.kind not in NUMERIC_KINDS:
        raise FileError(f'"{path}" contains samples of type {values.dtype}; only booleans, integers and real numbers are supported.')
    return np.asarray(values, values.dtype.newbyteorder("="))
