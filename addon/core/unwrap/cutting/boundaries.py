"""Boundaries of charts: edges of a single triangle and the loops that they form."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...geometry.edges import find_edges


def boundary_edges(triangles: np.ndarray) -> np.ndarray:
    """Return the boundary edges (B, 2) of `triangles` (T, 3), oriented like their triangle: the interior is to the left."""
    edges = find_edges(triangles)
    is_boundary = edges.face_counts[edges.face_edges] == 1  # By opposite corner.
    corners = np.flatnonzero(np.roll(is_boundary, 1, axis=1))  # By the corner at the start of the edge.
    return np.stack([triangles.ravel()[corners], np.roll(triangles, -1, axis=1).ravel()[corners]], axis=1)


def boundary_loops(triangles: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """Return the boundary loops of a mesh as vertex indices in order, sorted by decreasing length on the surface.

    triangles: (T, 3) of `vertices` (V, 3), in which no vertex belongs to two loops.
    """
    edges = boundary_edges(triangles)
    successor = np.full(len(vertices), -1)
    successor[edges[:, 0]] = edges[:, 1]
    count, label = connected_components(coo_array((np.ones(len(edges), bool), tuple(edges.T)), shape=(len(vertices),) * 2), directed=False)
    lengths = np.bincount(label[edges[:, 0]], np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1), count)
    first = np.full(count, -1)
    first[label[edges[::-1, 0]]] = edges[::-1, 0]
    return [_trace_loop(successor, int(first[index])) for index in np.argsort(-lengths, kind="stable") if first[index] >= 0]


def _trace_loop(successor: np.ndarray, start: int) -> np.ndarray:
    loop = [start]
    while successor[loop[-1]] != start:
        loop.append(int(successor[loop[-1]]))
    return np.array(loop)


def fill_holes(vertices: np.ndarray, triangles: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Fill each of `holes`, boundary loops, with a triangle fan around a new vertex at its center; return vertices and triangles."""
    centers = [vertices[hole].mean(axis=0)[None] for hole in holes]
    fans = [np.column_stack([np.roll(hole, -1), hole, np.full(len(hole), len(vertices) + index)]) for index, hole in enumerate(holes)]
    return np.concatenate([vertices, *centers]), np.concatenate([triangles, *fans]).astype(np.int32)
