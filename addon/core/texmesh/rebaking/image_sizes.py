"""The size of the images of a level: at least as many texels as the image of the level has pixels where it is shown nearest."""

import math

import numpy as np

from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas

TEXELS_PER_PIXEL = 1.5  # At least, where texels are longest: with one, thin lines are blurred visibly.
MIN_SIDE = 128  # Pixels of the longer side of an image; in smaller ones, which save little, UV islands run together.
# Fractions of the area that have so many texels, by the root of their area and in the direction in which they are longest: thin islands
# are stretched, and would otherwise determine the size of the image.
MEAN_FRACTION, LONGEST_FRACTION = 0.9, 0.5


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
    used = np.flatnonzero((signed_areas(corner_uvs) != 0.0) & (areas > 0.0))
    most = max(math.floor(math.log2(max(size) / MIN_SIDE)), 0)
    if not len(used):
        return most
    means, longest = _find_texel_lengths(corners[used], corner_uvs[used] * size)
    length = max(_find_quantile(means, areas[used], MEAN_FRACTION), _find_quantile(longest, areas[used], LONGEST_FRACTION))
    return int(np.clip(math.floor(math.log2(max(pixel_size, length * 1e-9) / (TEXELS_PER_PIXEL * length)) + 1e-9), 0, most))


def _find_quantile(values: np.ndarray, weights: np.ndarray, fraction: float) -> float:
    """Return the value up to which values (N,) have a fraction of the weights (N,)."""
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, fraction * cumulative[-1])])


def _find_texel_lengths(corners: np.ndarray, texels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the root of the area of a texel (T,) on triangles, and how long it is (T,) in the direction in which it is longest.

    Args:
        corners: (T, 3, 3) on the surface. texels: (T, 3, 2) in the image.
    """
    first, second = (corners[:, index] - corners[:, 0] for index in (1, 2))
    (first_u, first_v), (second_u, second_v) = ((texels[:, index] - texels[:, 0]).T[..., None] for index in (1, 2))
    determinant = first_u * second_v - second_u * first_v
    along_u = (first * second_v - second * first_v) / determinant
    along_v = (second * first_u - first * second_u) / determinant
    sums = (along_u**2 + along_v**2).sum(axis=1)
    area = np.linalg.norm(np.cross(along_u, along_v), axis=1)
    largest = np.sqrt(0.5 * (sums + np.sqrt(np.maximum(sums**2 - 4.0 * area**2, 0.0))))  # the largest singular value
    return np.sqrt(area), largest
