"""Thinning of features: of several that are closer together than their scale can tell apart, one persists."""

import numpy as np
from scipy.spatial import cKDTree


def thin_features(
    positions: np.ndarray, last_scales: np.ndarray, strengths: np.ndarray, sigmas: np.ndarray, spacing: float
) -> np.ndarray:
    """Return the last scale (V,) int8 of each vertex at which no feature that is more persistent, or as persistent and stronger, is closer
    than `spacing` times the standard deviation. All features remain at scale 1.

    positions: (V, 3). last_scales: (V,) int8. strengths: (V,). sigmas: (21,), ascending, in the unit of the positions.
    """
    thinned = np.zeros_like(last_scales)
    order = np.lexsort((np.arange(len(positions)), strengths, last_scales))
    rank = np.empty(len(positions), np.int64)
    rank[order] = np.arange(len(positions))
    for scale in range(len(sigmas) - 1, 1, -1):
        radius = spacing * sigmas[scale]
        kept = np.flatnonzero(thinned > 0)
        candidates = np.flatnonzero((last_scales >= scale) & (thinned == 0))
        if len(kept) and len(candidates):
            distances = cKDTree(positions[kept]).query(positions[candidates], distance_upper_bound=radius)[0]
            candidates = candidates[distances >= radius]
        thinned[candidates[_select_spaced(positions[candidates], rank[candidates], radius)]] = scale
    thinned[(last_scales > 0) & (thinned == 0)] = 1
    return thinned


def _select_spaced(positions: np.ndarray, rank: np.ndarray, radius: float) -> np.ndarray:
    """Return the indices of points that are at least `radius` apart, those of higher `rank` (N,) first, as if chosen one after the other."""
    first, second = cKDTree(positions).query_pairs(radius, output_type="ndarray").T if len(positions) else np.empty((2, 0), np.int64)
    lower, upper = np.where(rank[first] < rank[second], (first, second), (second, first))
    is_open, is_selected = np.ones(len(positions), bool), np.zeros(len(positions), bool)
    while is_open.any():
        is_beaten = np.zeros(len(positions), bool)
        is_beaten[lower[is_open[upper]]] = True
        is_selected |= is_open & ~is_beaten
        is_open &= is_beaten
        is_open[lower[is_selected[upper]]] = False
        used = is_open[lower] & is_open[upper]
        lower, upper = lower[used], upper[used]
    return np.flatnonzero(is_selected)
