"""Division of meshes at edges with more than two triangles, so that each part is a surface."""

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...arrays import concatenate_ranges
from ...geometry.mesh import face_areas_and_normals
from ...geometry.proximity import encode_pairs
from ..textured_mesh import TexturedMesh

PAIRING_PASSES = 3
WEDGE_BONUS = 4.0  # for triangles with equal wedges at the edge, above every difference of the cosines of their angle


def divide_into_surfaces(mesh: TexturedMesh) -> tuple[TexturedMesh, np.ndarray, np.ndarray]:
    """Return `mesh` with copies of the vertices at which several surfaces touch.

    At an edge with more than two triangles, or two with the same direction, those of opposite directions are connected that have the same
    wedges, or else continue each other with the smallest angle.

    Returns:
        The mesh, whose wedges are those of the input; the vertex (V',) int32 of the input for each of its vertices; and which (V',) bool
        were at such edges.
    """
    starts, ends = mesh.triangles.reshape(-1), np.roll(mesh.triangles, -1, axis=1).reshape(-1)
    keys = encode_pairs(starts, ends, len(mesh.vertices))
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.concatenate([[True], keys[order][1:] != keys[order][:-1]]))
    counts = np.diff(np.append(first, len(keys)))
    is_regular = counts == 2
    pairs = np.stack([order[first[is_regular]], order[first[is_regular] + 1]])
    is_oriented = starts[pairs[0]] != starts[pairs[1]]
    is_ambiguous = counts > 2
    is_ambiguous[np.flatnonzero(is_regular)[~is_oriented]] = True
    if not is_ambiguous.any():
        return mesh, np.arange(len(mesh.vertices), dtype=np.int32), np.zeros(len(mesh.vertices), bool)
    halfedges = order[concatenate_ranges(first[is_ambiguous], counts[is_ambiguous])]
    touched = np.zeros(len(mesh.vertices), bool)
    touched[starts[halfedges]] = touched[ends[halfedges]] = True
    joined = np.concatenate([pairs[:, is_oriented], _pair(mesh, halfedges, keys[halfedges], starts[halfedges] < ends[halfedges])], axis=1)
    following = joined - joined % 3 + (joined + 1) % 3
    first_corners, second_corners = np.concatenate([joined[0], following[0]]), np.concatenate([following[1], joined[1]])
    graph = coo_array((np.ones(len(first_corners), bool), (first_corners, second_corners)), shape=(len(starts),) * 2)
    labels = connected_components(graph, directed=False)[1]
    _, examples, triangles = np.unique(labels, return_index=True, return_inverse=True)
    sources = starts[examples].astype(np.int32)
    divided = replace(mesh, vertices=mesh.vertices[sources], triangles=triangles.reshape(-1, 3).astype(np.int32))
    return divided, sources, touched[sources]


def _pair(mesh: TexturedMesh, halfedges: np.ndarray, keys: np.ndarray, is_forward: np.ndarray) -> np.ndarray:
    """Return pairs (2, P) of `halfedges` (N,), which begin at their corners, that have the same key (N,) and opposite directions."""
    normals = face_areas_and_normals(mesh.vertices[mesh.triangles])[1]
    flat_wedges, end_wedges = mesh.wedge_triangles.reshape(-1), np.roll(mesh.wedge_triangles, -1, axis=1).reshape(-1)
    result = [np.zeros((2, 0), halfedges.dtype)]
    for _ in range(PAIRING_PASSES):
        forward, backward = np.flatnonzero(is_forward), np.flatnonzero(~is_forward)
        low = np.searchsorted(keys[backward], keys[forward], "left")
        counts = np.searchsorted(keys[backward], keys[forward], "right") - low
        one, other = np.repeat(forward, counts), backward[concatenate_ranges(low, counts)]
        if not len(one):
            break
        a, b = halfedges[one], halfedges[other]
        scores = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3])
        scores += WEDGE_BONUS * ((flat_wedges[a] == end_wedges[b]) & (end_wedges[a] == flat_wedges[b]))
        best = np.full((2, len(halfedges)), -1)
        ascending = np.argsort(scores, kind="stable")
        best[0, one[ascending]], best[1, other[ascending]] = ascending, ascending  # the last assignment stays
        mutual = np.flatnonzero(best[0, one] == best[1, other])
        mutual = np.intersect1d(mutual, best[0])
        result.append(np.stack([a[mutual], b[mutual]]))
        is_left = np.ones(len(halfedges), bool)
        is_left[one[mutual]] = is_left[other[mutual]] = False
        halfedges, keys, is_forward = halfedges[is_left], keys[is_left], is_forward[is_left]
    return np.concatenate(result, axis=1)
