"""Contents of terrain files: a height map or voxels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError

MAX_BYTES = 2**31  # of samples; more would not fit into memory beside the boxes and a scene
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


def is_valid(values: np.ndarray) -> np.ndarray:
    """Return a mask of the values that are finite and not so large that they mean "no data"."""
    return np.abs(values) < NO_DATA_MAGNITUDE if values.dtype.kind == "f" else np.ones(values.shape, bool)


def are_valid_sizes(sizes: tuple[float, ...]) -> bool:
    """Return whether numbers from a header can be pixel or voxel sizes. Many programs write zeros there."""
    return all(1e-9 < size < 1e9 for size in sizes)


def check_size(path: Path, count: int, bytes_per_sample: int) -> None:
    """Raise FileError when the file `path` has no samples, or more than fit into memory."""
    if count <= 0:
        raise FileError(f'"{path}" contains no samples.')
    if count * bytes_per_sample > MAX_BYTES:
        raise FileError(f'"{path}" contains {count * bytes_per_sample / 2**30:.1f} GiB of samples, more than 2 GiB; reduce its size.')


def to_native_byte_order(path: Path, values: np.ndarray) -> np.ndarray:
    """Return `values` of a file in the byte order of this machine.

    Raises:
        FileError: they are not numbers that can be sampled.
    """
    if values.dtype.kind not in NUMERIC_KINDS:
        raise FileError(f'"{path}" contains samples of type {values.dtype}; only booleans, integers and real numbers are supported.')
    return np.asarray(values, values.dtype.newbyteorder("="))
