"""Thinning of features: of several that are closer together than their scale can tell apart, one persists. And the order of the rest."""

import numpy as np
from scipy.spatial import cKDTree

MAX_NEIGHBORS, MAX_HALVINGS = 64, 40  # of a point on average, and of the radius until there are no more


def thin_features(positions: np.ndarray, last_scales: np.ndarray, strengths: np.ndarray, sigmas: np.ndarray, spacing: float) -> np.ndarray:
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
        candidates = _drop_close(positions, candidates, kept, radius)
        thinned[candidates[_select_spaced(positions[candidates], rank[candidates], radius)]] = scale
    thinned[(last_scales > 0) & (thinned == 0)] = 1
    return thinned


def rank_coverage(positions: np.ndarray, last_scales: np.ndarray, contrasts: np.ndarray, sigmas: np.ndarray, spacing: float) -> np.ndarray:
    """Return strengths (V,) of the vertices that are no features: the number of the scale up to which they are a sample of the surface
    between features, `spacing` standard deviations from each other and from all features, plus a part below 1 that grows with `contrasts`
    (V,). 0 for features.

    Arguments as for `thin_features`, except that last_scales is its result.
    """
    strengths = np.where(last_scales > 0, 0.0, contrasts / (1.0 + contrasts))
    rank = np.argsort(np.lexsort((np.arange(len(positions)), contrasts)), kind="stable")
    features, samples = np.flatnonzero(last_scales > 0), np.flatnonzero(last_scales == 0)
    for scale in range(1, len(sigmas)):
        samples = _drop_close(positions, samples, features, spacing * sigmas[scale])
        samples = samples[_select_spaced(positions[samples], rank[samples], spacing * sigmas[scale])]
        strengths[samples] += 1.0
    return strengths


def _drop_close(positions: np.ndarray, candidates: np.ndarray, kept: np.ndarray, radius: float) -> np.ndarray:
    """Return those of `candidates` (N,), indices into positions, that are at least `radius` from all `kept` (K,)."""
    if not len(candidates) or not len(kept):
        return candidates
    return candidates[cKDTree(positions[kept]).query(positions[candidates], distance_upper_bound=radius)[0] >= radius]


def _select_spaced(positions: np.ndarray, rank: np.ndarray, radius: float, depth: int = 0) -> np.ndarray:
    """Return the indices of points that are at least `radius` apart, those of higher `rank` (N,) first, as if chosen one after the other.
    Points that are much denser than that are first thinned to half the radius."""
    if not len(positions) or radius <= 0.0:
        return np.arange(len(positions))
    tree = cKDTree(positions)
    if depth < MAX_HALVINGS and tree.count_neighbors(tree, radius) > MAX_NEIGHBORS * len(positions):
        finer = _select_spaced(positions, rank, 0.5 * radius, depth + 1)
        return finer[_select_spaced(positions[finer], rank[finer], radius, MAX_HALVINGS)]
    first, second = tree.query_pairs(radius, output_type="ndarray").T
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
