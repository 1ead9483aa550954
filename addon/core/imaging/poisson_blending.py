"""Screened Poisson blending: an image with the gradients of one image and roughly the colors of another.

Minimizes the squared differences between neighboring pixels and given ones, plus the squared difference to given colors times a small
weight (Bhat et al., "Fourier Analysis of the 2D Screened Poisson Equation for Gradient Domain Problems", 2008). Only parts of the image are
used, of any shape.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix

from .grid_solver import solve_grid

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
