"""How far a simplified mesh is from the original, and from which size of a pixel that is not seen."""

import numpy as np

from ..geometry.distance import TriangleTree

SAMPLES = 4000  # Vertices of the original that are compared.
QUANTILE = 0.99  # Of their distances; single points that are farther away do not count.
DETAIL_SIZE = (
    4.0  # The shortest length of detail relative to its height: bumps that are lower than a pixel, but wider, are seen by their shading.
)


def measure_pixel_size(vertices: np.ndarray, corners: np.ndarray) -> float:
    """Return the size of a pixel above which the triangles `corners` (T, 3, 3) look like the original with `vertices` (V, 3), a length."""
    sampled = np.unique(np.linspace(0, len(vertices) - 1, SAMPLES).astype(int))
    distances, _ = TriangleTree(np.asarray(corners, np.float64)).find_closest(np.asarray(vertices[sampled], np.float64))
    return DETAIL_SIZE * float(np.quantile(distances, QUANTILE))
