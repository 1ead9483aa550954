"""Blending of images of which only parts are known, of any shape.

Screened Poisson blending returns an image with the gradients of one image and roughly the colors of another. It minimizes the squared
differences between neighboring pixels and given ones, plus the squared difference to given colors times a small weight (Bhat et al.,
"Fourier Analysis of the 2D Screened Poisson Equation for Gradient Domain Problems", 2008).

The multi-resolution spline blends images in frequency bands, wide bands over long distances and fine ones over short distances (Burt and
Adelson, "A Multiresolution Spline with Application to Image Mosaics", 1983, as in Textures Revisited, section 4.2), with normalized
convolution where parts are not known.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix

from .grid_solver import solve_grid
from .pyramids import expand_weighted, reduce_image, reduce_weighted

TOLERANCE = 1e-4  # relative residual


class PixelLinks(NamedTuple):
    """Pairs of neighbors among the U used pixels of an image: first and second (L,), their indices; positions (U, 2), rows and columns."""

    first: np.ndarray
    second: np.ndarray
    positions: np.ndarray


def find_links(used: np.ndarray) -> PixelLinks:
    """Return the pairs of neighbors in a row or column among the `used` pixels (H, W) bool."""
    indices = np.full(used.shape, -1)
    indices[used] = np.arange(np.count_nonzero(used))
    across, up = used[:, :-1] & used[:, 1:], used[:-1] & used[1:]
    first = np.concatenate([indices[:, :-1][across], indices[:-1][up]])
    second = np.concatenate([indices[:, 1:][across], indices[1:][up]])
    return PixelLinks(first, second, np.argwhere(used))


def solve_screened_poisson(links: PixelLinks, differences: np.ndarray, colors: np.ndarray, length: float) -> np.ndarray:
    """Return colors (U, C) float32 whose second pixel of each link exceeds the first by `differences` (L, C), near given `colors` (U, C).

    length: in pixels, over which the differences outweigh the colors.
    """
    count, weight = len(colors), 1.0 / length**2
    ones = np.ones(len(links.first))
    neighbors = coo_matrix((ones, (links.first, links.second)), shape=(count, count))
    neighbors = (neighbors + neighbors.T).tocsr()
    diagonal = np.asarray(neighbors.sum(axis=1)).ravel() + weight
    everything = np.arange(count)
    matrix = coo_matrix((diagonal, (everything, everything)), shape=(count, count)).tocsr() - neighbors
    right_side = weight * colors.astype(np.float64)
    for channel in range(colors.shape[1]):
        right_side[:, channel] += np.bincount(links.second, differences[:, channel], count)
        right_side[:, channel] -= np.bincount(links.first, differences[:, channel], count)
    return solve_grid(matrix, links.positions, right_side, colors, TOLERANCE).astype(np.float32)


class Layer(NamedTuple):
    """An image (H, W, C) float32, where it is known (H, W) bool, and its fraction (H, W) float32 of the result, 0 where it is not known."""

    image: np.ndarray
    known: np.ndarray
    fraction: np.ndarray


def blend_bands(layers: Iterable[Layer], shape: tuple[int, int, int], levels: int) -> np.ndarray:
    """Return the blend (H, W, C) float32 of `layers` of this `shape` in `levels` bands; zero where no layer has a fraction.

    Layers are used one after the other, so that they may be computed as they are needed.
    """
    sizes = [shape[:2]]
    for _ in range(levels - 1):
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    sums = [np.zeros((*size, shape[2]), np.float32) for size in sizes]
    fractions = [np.zeros(size, np.float32) for size in sizes]
    for layer in layers:
        image, weights, fraction = layer.image, layer.known.astype(np.float32), layer.fraction
        for level in range(levels):
            band = image
            if level + 1 < levels:
                image, coarse_weights = reduce_weighted(image, weights)
                band = band - expand_weighted(image, (coarse_weights > 0.0).astype(np.float32), sizes[level])[0]
                band[weights == 0.0] = 0.0
                weights = coarse_weights
            sums[level] += fraction[..., None] * band
            fractions[level] += fraction
            if level + 1 < levels:
                fraction = reduce_image(fraction)
    result = _divide(sums[-1], fractions[-1])
    for level in reversed(range(levels - 1)):
        coarse = expand_weighted(result, (fractions[level + 1] > 0.0).astype(np.float32), sizes[level])[0]
        result = _divide(sums[level], fractions[level]) + np.where(fractions[level][..., None] > 0.0, coarse, 0.0)
    return result


def _divide(sums: np.ndarray, fractions: np.ndarray) -> np.ndarray:
    return np.where(fractions[..., None] > 0.0, sums / np.where(fractions > 0.0, fractions, 1.0)[..., None], 0.0)
