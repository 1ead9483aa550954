"""What files give terrains: a map of heights, or a block of voxels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError

MOST_BYTES = 2**31  # of samples: more would not stay in memory beside the boxes and a scene
NO_NUMBER = 1e30  # and beyond: some programs write such where they know no value, without saying so
KINDS = "buif"  # of numbers that can be sampled, as NumPy names them


@dataclass(frozen=True)
class HeightMap:
    """A map of heights.

    heights: (H, W) numbers, row 0 in the south, which is -y. pixel: width (along x) and depth (along y) of a pixel in the unit of the
    heights, which are elevations then; None where they are the grey of a picture, 0 for black and 1 for white. no_data: the number that
    stands where no height is known, if the file names one.
    """

    heights: np.ndarray
    pixel: tuple[float, float] | None = None
    no_data: float | None = None


@dataclass(frozen=True)
class Voxels:
    """A block of voxels.

    values: (X, Y, Z) numbers, the larger the more solid. spacing: sides of a voxel, of which only the ratios count. outside: the value
    around the block, where the file tells; else it is the smallest one within.
    """

    values: np.ndarray
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    outside: float | None = None


Source = HeightMap | Voxels


def is_number(values: np.ndarray) -> np.ndarray:
    """Which of `values` are numbers to reckon with, truths of the same shape."""
    return np.abs(values) < NO_NUMBER if values.dtype.kind == "f" else np.ones(values.shape, bool)


def are_sides(sides: tuple[float, ...]) -> bool:
    """Whether what a header gives can be the sides of a pixel or voxel; many writers leave zeros there."""
    return all(1e-9 < side < 1e9 for side in sides)


def check_size(path: Path, count: int, bytes_each: int) -> None:
    """Raise FileError when the file `path` holds nothing, or more than can be kept."""
    if count <= 0:
        raise FileError(f'"{path}" holds no samples at all.')
    if count * bytes_each > MOST_BYTES:
        raise FileError(f'"{path}" holds {count * bytes_each / 2**30:.1f} GiB of samples, more than 2 GiB; make it smaller first.')


def native(path: Path, values: np.ndarray) -> np.ndarray:
    """`values` of a file in this machine's order of bytes.

    Raises:
        FileError: when they are not numbers that can be sampled.
    """
    if values.dtype.kind not in KINDS:
        raise FileError(f'"{path}" holds samples of the type {values.dtype}; only truths, integers and real numbers can be read.')
    return np.asarray(values, values.dtype.newbyteorder("="))
