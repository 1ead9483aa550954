"""Gradients of the planes of triangles over a height field."""

import numpy as np


def weigh_gradients(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of z along x and y times twice the area, and twice the area, (T,) each, of triangles.

    They are sums and products only, so that a triangle without area has values, too, and means weighted by area are sums.

    Args:
        x, y, z: (3, T) float64, the corners, counterclockwise seen from above.
    """
    (x1, y1, z1), (x2, y2, z2) = ((x[corner] - x[0], y[corner] - y[0], z[corner] - z[0]) for corner in (1, 2))
    return z1 * y2 - z2 * y1, z2 * x1 - z1 * x2, x1 * y2 - y1 * x2
