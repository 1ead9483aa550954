"""Creases of a surface: edges along which a person would cut it, since it is sharply folded there."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...arrays import concatenate_ranges
from ...geometry.edges import halfedge_ends
from ...geometry.mesh import scaled_normals
from ...geometry.proximity import counting_argsort
from ...geometry.transforms import normalize

STRONG_FOLD = np.radians(40.0)  # An edge with a larger fold is a crease,
WEAK_FOLD = np.radians(22.0)  # and so is one with a larger fold than this that continues a crease.
MAX_TURN = np.radians(35.0)  # Between an edge and the one that continues it.


def find_creases(vertices: np.ndarray, triangles: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return which pairs of `halfedges` (I, 2), 3 t + c, are creases, (I,) bool.

    vertices: (V, 3). triangles: (T, 3).
    """
    folds = fold_angles(vertices, triangles, halfedges)
    is_strong, candidates = folds > STRONG_FOLD, np.flatnonzero(folds > WEAK_FOLD)
    ends = halfedge_ends(triangles, halfedges[candidates, 0])
    directions = normalize(vertices[ends[:, 1]] - vertices[ends[:, 0]])
    first, second = _pairs_at_vertices(ends, len(vertices))
    # Both edges point away from their common vertex if they start there.
    is_continued = -np.einsum("pi,pi->p", *(_outward(directions, edge) for edge in (first, second))) > np.cos(MAX_TURN)
    links = coo_array(
        (np.ones(int(is_continued.sum()), bool), (first[is_continued] // 2, second[is_continued] // 2)), shape=(len(ends),) * 2
    )
    count, line = connected_components(links, directed=False)
    creases = np.zeros(len(halfedges), bool)
    creases[candidates] = np.bincount(line, is_strong[candidates], count)[line] > 0
    return creases


def fold_angles(vertices: np.ndarray, triangles: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return the angles (I,) between the normals of both triangles at pairs of `halfedges` (I, 2); 0 at triangles without area."""
    normals = normalize(scaled_normals(vertices[triangles]))
    first, second = normals[halfedges.T // 3]
    angles = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), np.einsum("ei,ei->e", first, second))
    return np.where(first.any(axis=1) & second.any(axis=1), angles, 0.0)


def _outward(directions: np.ndarray, edge_ends: np.ndarray) -> np.ndarray:
    """Return the directions (P, 3) of edges away from one end each. edge_ends: (P,) 2 e + end."""
    return directions[edge_ends // 2] * np.where(edge_ends % 2 == 0, 1.0, -1.0)[:, None]


def _pairs_at_vertices(ends: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return all pairs of edge ends, 2 e + end, at the same vertex, (P,) each. ends: (E, 2) vertices."""
    order = counting_argsort(ends.ravel(), vertex_count).astype(np.int64)
    degrees = np.bincount(ends.ravel(), minlength=vertex_count)
    starts = np.repeat(np.cumsum(degrees) - degrees, degrees)
    counts = np.repeat(degrees, degrees)
    first = np.repeat(order, counts)
    second = order[concatenate_ranges(starts, counts)]
    return first[first < second], second[first < second]
