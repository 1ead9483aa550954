"""Colors of vertices that no photograph shows, interpolated over the surface (Textures Revisited, section 4.1)."""

import numpy as np

from ..geometry.edges import Edges

FRACTIONS = (0.8, 0.6, 0.4, 0.2, 0.0)  # of the neighbors of a vertex that must have a color, one stage after the other


def interpolate_colors(colors: np.ndarray, known: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Return the colors (V, C) of all vertices that are connected to known ones, and which vertices have a color (V,) bool.

    colors: (V, C). known: (V,) bool. A vertex gets the mean of its neighbors as soon as enough of them have a color; all vertices of one
    sweep at once, so that their order does not matter.
    """
    colors, known = np.where(known[:, None], colors, 0.0), known.copy()
    first, second = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    neighbors = np.bincount(first, minlength=len(colors))
    for fraction in FRACTIONS:
        while not known.all():
            has_color = known[second]
            counts = np.bincount(first[has_color], minlength=len(colors))
            ready = ~known & (counts > 0) & (counts >= fraction * neighbors)
            if not ready.any():
                break
            used = has_color & ready[first]
            for channel in range(colors.shape[1]):
                sums = np.bincount(first[used], colors[second[used], channel], len(colors))
                colors[ready, channel] = sums[ready] / counts[ready]
            known |= ready
    return colors, known
