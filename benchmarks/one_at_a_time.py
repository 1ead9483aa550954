"""Clustering one pair at a time, as section 4.3 has it: what the rounds of `hierarchy.merge_in_rounds` are held against.

It takes the cheapest pair of all, merges it, and looks again; far too slow for a real mesh, but no order of merges is greedier.
"""

import numpy as np

import environment

environment.import_farfield()

from farfield.addon.core.billboards.hierarchy import ClusterBounds, Clusters
from farfield.addon.core.billboards.primitives import Primitives


def merge_one_at_a_time(primitives: Primitives, pairs: np.ndarray, bounds: ClusterBounds, level: int) -> np.ndarray:
    """Merge `primitives` over the proximity graph `pairs` (E, 2) until no merge is left within `level`.

    Returns:
        The cluster number (P,) of every primitive, from 0 without gaps.
    """
    clusters = Clusters(primitives, np.arange(len(primitives), dtype=np.int32))
    labels = np.arange(len(primitives))
    cost = clusters.pair_costs(pairs, bounds, level)
    while len(pairs) and np.isfinite(cost.min()):
        a, b = pairs[cost.argmin()]
        clusters.merge(np.array([a]), np.array([b]))
        labels[labels == b] = a
        touching = np.isin(pairs, (a, b)).any(axis=1)
        others = np.setdiff1d(pairs[touching], (a, b))
        renewed = np.stack([np.full_like(others, a), others], axis=1)
        pairs = np.concatenate([pairs[~touching], renewed])
        cost = np.concatenate([cost[~touching], clusters.pair_costs(renewed, bounds, level)])
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def texture_waste(primitives: Primitives, labels: np.ndarray) -> float:
    """What merging keeps low: summed area of the clusters' rectangles along their main axes, over the area of the primitives."""
    total = 0.0
    for number in range(int(labels.max()) + 1):
        points = primitives.positions[labels == number].reshape(-1, 3)
        axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
        total += float(np.ptp(points @ axes[:2].T, axis=0).prod())
    return total / float(primitives.areas.sum())
