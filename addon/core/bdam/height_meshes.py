"""Triangles over samples of a height field: gradients of their planes, and what meshes of several modules have in common."""

import numpy as np


def weigh_gradients(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of z along x and y times twice the area, and twice the area, (T,) each, of triangles.

    They are sums and products only, so that a triangle without area has values, too, and means weighted by area are sums.

    Args:
        x, y, z: (3, T) float64, the corners, counterclockwise seen from above.
    """
    (x1, y1, z1), (x2, y2, z2) = ((x[corner] - x[0], y[corner] - y[0], z[corner] - z[0]) for corner in (1, 2))
    return z1 * y2 - z2 * y1, z2 * x1 - z1 * x2, x1 * y2 - y1 * x2


def sum_gradients(axes: np.ndarray, corners: np.ndarray) -> list[np.ndarray]:
    """Return the sums (V,) of the three results of `weigh_gradients` over the triangles of each vertex.

    Args:
        axes: (3, V) float64, x, y and z of the vertices. corners: (3, T) intp, corners of the triangles.
    """
    weights = weigh_gradients(*axes.take(corners, axis=1))
    return [np.bincount(corners.ravel(), np.concatenate([values] * 3), axes.shape[1]) for values in weights]


def triangulate_cells(cells: int) -> np.ndarray:
    """Return the counterclockwise triangles (T, 3) int32 of a square of `cells` x `cells` cells, whose corners are numbered along x, then
    y.

    The diagonals of the cells alternate: they meet at samples with an even sum of coordinates, as the hypotenuses of the bintree do.
    """
    number = np.arange((cells + 1) ** 2, dtype=np.int32).reshape(cells + 1, cells + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    is_even = np.add.outer(np.arange(cells), np.arange(cells))[..., None] % 2 == 0
    first = np.where(is_even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(is_even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def find_used(triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which of `count` vertices triangles (T, 3) use, (V,) bool, and the same triangles of these vertices alone."""
    is_used = np.zeros(count, bool)
    is_used[triangles] = True
    return is_used, triangles if is_used.all() else (np.cumsum(is_used, dtype=np.int32) - np.int32(1))[triangles]
