"""Edges of images: Canny, "A Computational Approach to Edge Detection", 1986."""

import numpy as np
from scipy.ndimage import gaussian_filter, label, map_coordinates


def find_edges(values: np.ndarray, sigma: float, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (H, W) bool of `values` (H, W), one pixel wide, and the gradient (H, W, 2), after a Gaussian filter
    of `sigma` pixels.

    low, high: magnitudes of the gradient in units of `values` per pixel. Connected edges above `low` are kept where one is above `high`.
    """
    gradient = np.stack([gaussian_filter(values.astype(np.float64), sigma, order=order) for order in ((1, 0), (0, 1))], axis=-1)
    magnitude = np.linalg.norm(gradient, axis=-1)
    direction = gradient / np.maximum(magnitude, 1e-12)[..., None]
    grid = np.moveaxis(np.indices(values.shape), 0, -1)
    ahead, behind = (map_coordinates(magnitude, np.moveaxis(grid + side * direction, -1, 0), order=1, mode="nearest") for side in (1, -1))
    is_ridge = (magnitude >= ahead) & (magnitude > behind) & (magnitude > low)
    labels, count = label(is_ridge, structure=np.ones((3, 3), bool))
    is_strong = np.zeros(count + 1, bool)
    is_strong[labels[is_ridge & (magnitude > high)]] = True
    return is_strong[labels] & is_ridge, gradient
