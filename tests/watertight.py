"""Checks whether surfaces are closed, by their edges."""

import numpy as np


def directed_edges(polygons: np.ndarray) -> np.ndarray:
    """Return the edges (E, 2) of polygons (F, C) in the direction of their orientation."""
    return np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=-1).reshape(-1, 2).astype(np.int64)


def directed_edge_counts(polygons: np.ndarray) -> np.ndarray:
    """Return how many polygons use each unique directed edge: 1 everywhere on a manifold."""
    return np.unique(directed_edges(polygons), axis=0, return_counts=True)[1]


def open_edges(polygons: np.ndarray) -> np.ndarray:
    """Return the directed edges (E, 2) that no polygon uses in the opposite direction: none on a closed surface."""
    edges = directed_edges(polygons)
    if len(edges) == 0:
        return edges
    count = int(edges.max()) + 1
    return edges[~np.isin(edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0])]
