"""The size of the images of a level: as many texels as the image of the level has pixels where it is shown nearest."""

import math

import numpy as np

from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas

TEXELS_PER_PIXEL = 1.5  # along a side, at least, where texels are largest: with one, thin lines are blurred visibly
MIN_SIDE = 128  # Pixels of the longer side of an image; in smaller ones, which save little, UV islands run together.
SHARP_FRACTION = 0.9  # This fraction of the area has so many texels.


def halve_size(size: tuple[int, int], halvings: int) -> tuple[int, int]:
    """Return width and height after some halvings, rounded up."""
    return tuple(-(-side // 2**halvings) for side in size)


def choose_halvings(corners: np.ndarray, corner_uvs: np.ndarray, pixel_size: float, size: tuple[int, int]) -> int:
    """Return how often the sides of an image can be halved on a surface that is shown where pixels are at least `pixel_size` large.

    Args:
        corners: (T, 3, 3) of triangles in the object's unit. corner_uvs: (T, 3, 2), 1 for a side of the image. pixel_size: in the object's
            unit. size: width and height of the image.
    """
    areas, _ = face_areas_and_normals(corners)
    uv_areas = np.abs(signed_areas(corner_uvs))
    used = np.flatnonzero((uv_areas > 0.0) & (areas > 0.0))
    most = max(math.floor(math.log2(max(size) / MIN_SIDE)), 0)
    if not len(used):
        return most
    lengths = np.sqrt(areas[used] / (uv_areas[used] * size[0] * size[1]))  # Lengths of a texel on the surface.
    order = np.argsort(lengths)
    cumulative = np.cumsum(areas[used][order])
    longest = float(lengths[order][np.searchsorted(cumulative, SHARP_FRACTION * cumulative[-1])])
    return int(np.clip(math.floor(math.log2(max(pixel_size, longest * 1e-9) / (TEXELS_PER_PIXEL * longest)) + 1e-9), 0, most))
