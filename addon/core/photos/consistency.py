"""How far each photograph agrees with the others about the color of the surface.

What only one photograph shows, such as a passer-by, a branch in front of the surface or a reflection, differs from the median of all
photographs. Weights are computed per triangle and smoothed over the surface, so that outliers are connected regions instead of single
texels.
"""

import numpy as np

from ..geometry.edges import Edges

MIN_PHOTOGRAPHS = 4  # that must show a triangle: with fewer, nobody knows which one is wrong
MIN_DEVIATION = 0.08  # of encoded colors: the spread of photographs that agree
MIN_WEIGHT = 1e-3  # a photograph that does not agree is still better than none
SMOOTHINGS = 2


def rate_consistency(colors: np.ndarray, visible: np.ndarray, edges: Edges, triangles: np.ndarray) -> np.ndarray:
    """Return weights (V, K) float32 in 0..1 of K photographs at the vertices.

    colors: (K, T, 3) encoded colors of the triangles after exposures were adjusted. visible: (K, T) bool. triangles: (T, 3).
    """
    masked = np.where(visible[..., None], colors, np.nan)
    enough = visible.sum(axis=0) >= MIN_PHOTOGRAPHS
    weights = np.ones(visible.shape)
    if enough.any():
        center = np.nanmedian(masked[:, enough], axis=0)
        distances = np.linalg.norm(masked[:, enough] - center, axis=2)
        spread = np.maximum(np.nanmedian(distances, axis=0), MIN_DEVIATION)
        weights[:, enough] = np.nan_to_num(np.exp(-np.square(0.5 * distances / spread)), nan=1.0)
    count = edges.vertex_count
    first, second = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    degrees = np.maximum(np.bincount(first, minlength=count), 1)
    result = np.empty((count, len(weights)), np.float32)
    around = np.maximum(np.bincount(triangles.ravel(), minlength=count), 1)
    for index, values in enumerate(weights):
        at_vertices = np.bincount(triangles.ravel(), np.repeat(values, 3), count) / around
        for _ in range(SMOOTHINGS):
            at_vertices = 0.5 * at_vertices + 0.5 * np.bincount(first, at_vertices[second], count) / degrees
        result[:, index] = np.maximum(at_vertices, MIN_WEIGHT)
    return result
