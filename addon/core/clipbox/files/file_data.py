"""Contents of terrain files: a height map or voxels."""

from dataclasses import dataclass

import numpy as np

from ...files.height_maps import CHUNK_SAMPLES, is_valid
from ...jobs.chunks import slices


@dataclass(frozen=True)
class HeightMap:
    """A height map.

    heights: (H, W) float32, row 0 in the south (-y), NaN where unknown. pixel_size: width (along x) and depth (along y) of a pixel in the
    unit of the heights, which are elevations; None where the heights are the gray values of an image, 0 for black and 1 for white.
    warnings: sentences for the user.
    """

    heights: np.ndarray
    pixel_size: tuple[float, float] | None = None
    warnings: tuple[str, ...] = ()


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
