"""Connects triangles across doubled vertices, as importers leave them where normals, UVs or materials are split."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...geometry.edges import Edges, halfedge_ends
from ...geometry.mesh import longest_side, scaled_normals
from ...geometry.proximity import counting_argsort, encode_pairs
from ...geometry.transforms import normalize

MAX_DISTANCE = 1e-6  # Between doubled vertices, relative to the longest side of the surface.
MAX_DISTANCE_PER_EDGE = 1e-3  # The same, relative to the median length of boundary edges: a far vertex must not weld all others.
MIN_NORMAL_COSINE = -0.999  # Between both triangles; a card with two sides stays in two parts.


def pair_doubled_edges(vertices: np.ndarray, triangles: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the pairs (P, 2) of boundary halfedges, 3 t + c, at the same position and in opposite directions.

    Where more than two boundary edges are at the same position, none of them is paired.

    Args:
        vertices: (V, 3). triangles: (T, 3). edges: of the triangles.
    """
    is_boundary = edges.face_counts[edges.face_edges.ravel()] == 1
    halfedges = np.flatnonzero(is_boundary)
    ends = halfedge_ends(triangles, halfedges)
    if len(ends) == 0:
        return np.zeros((0, 2), np.int64)
    used, ends = np.unique(ends, return_inverse=True)
    ends, points = ends.reshape(-1, 2), vertices[used]
    lengths = np.linalg.norm(np.subtract(*points[ends.T]), axis=1)
    distance = min(MAX_DISTANCE * longest_side(vertices[np.unique(triangles)]), MAX_DISTANCE_PER_EDGE * float(np.median(lengths)))
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(len(points),) * 2)
    count, position = connected_components(links, directed=False)
    starts, stops = position[ends].T
    _, keys, counts = np.unique(encode_pairs(starts, stops, count), return_inverse=True, return_counts=True)
    order = counting_argsort(keys.reshape(-1), len(counts))
    first = order[(np.cumsum(counts) - counts)[counts == 2]]
    second = order[(np.cumsum(counts) - counts)[counts == 2] + 1]
    normals = normalize(scaled_normals(vertices[triangles[halfedges // 3]]))
    is_pair = (starts[first] == stops[second]) & (starts[first] != stops[first])
    is_pair &= np.einsum("pi,pi->p", normals[first], normals[second]) > MIN_NORMAL_COSINE
    return np.stack([halfedges[first[is_pair]], halfedges[second[is_pair]]], axis=1)
