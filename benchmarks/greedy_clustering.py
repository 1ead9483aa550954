"""Clustering one pair at a time, as in section 4.3: the reference for the rounds of `hierarchy.merge_in_rounds`.

Repeatedly merges the cheapest of all pairs. It is far too slow for a real mesh, but no order of merges is greedier.
"""

import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.core.billboards.clustering.hierarchy import ClusterBounds, Clusters
from farfield.addon.core.billboards.primitives import Primitives


def merge_one_at_a_time(primitives: Primitives, pairs: np.ndarray, bounds: ClusterBounds, level: int) -> np.ndarray:
    """Merge `primitives` over the proximity graph `pairs` (E, 2) until no merge within `level` is left.

    Returns:
        The cluster (P,) of every primitive, numbered from 0 without gaps.
    """
    clusters = Clusters(primitives, np.arange(len(primitives), dtype=np.int32))
    labels = np.arange(len(primitives))
    costs = clusters.pair_costs(pairs, bounds, level)
    while len(pairs) and np.isfinite(costs.min()):
        a, b = pairs[costs.argmin()]
        clusters.merge(np.array([a]), np.array([b]))
        labels[labels == b] = a
        is_stale = np.isin(pairs, (a, b)).any(axis=1)
        neighbors = np.setdiff1d(pairs[is_stale], (a, b))
        new_pairs = np.stack([np.full_like(neighbors, a), neighbors], axis=1)
        pairs = np.concatenate([pairs[~is_stale], new_pairs])
        costs = np.concatenate([costs[~is_stale], clusters.pair_costs(new_pairs, bounds, level)])
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def texture_waste(primitives: Primitives, labels: np.ndarray) -> float:
    """Return the summed area of the clusters' rectangles along their principal axes, over the area of the primitives."""
    total = 0.0
    for index in range(int(labels.max()) + 1):
        points = primitives.positions[labels == index].reshape(-1, 3)
        axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
        total += float(np.ptp(points @ axes[:2].T, axis=0).prod())
    return total / float(primitives.areas.sum())
