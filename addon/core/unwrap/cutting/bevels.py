"""Rounded and chamfered edges: narrow bands of high curvature between faces that are flat or developable.

A box with rounded edges has no sharp edge, but a person would cut it in the middle of these bands, and not keep it in one piece.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ...arrays import TINY
from ...geometry.edges import halfedge_ends
from ...geometry.mesh import face_areas_and_normals
from .chart import label_components, split_vertices
from .creases import fold_angles

COPLANAR_FOLD = np.radians(1.0)  # Triangles with a smaller fold between them are one facet.
MAX_BEVEL_FOLD = np.radians(50.0)  # Larger folds belong to no band.
MIN_CURVATURE = 10.0  # Mean curvature of a band, twice the usual one, times the square root of the area of the connected part.
MIN_FACE_AREA = 0.01  # As a fraction of the area of the connected part.
MAX_FACE_CURVATURE = 0.5  # Integral of the absolute Gaussian curvature inside a face that counts as developable, in radians.
MIN_FACES_AREA = 0.5  # Of all developable faces of a part, as a fraction of its area: other parts are too curved to be divided here.
PREFERENCE = 0.03  # Turn in radians by which the largest face gets more of a band, so that the middle of it goes to one side all along.
MIN_COMMON_BORDER = 0.2  # Of a facet with the one from which its band is reached, as a fraction of its perimeter.


def divide_at_bevels(
    vertices: np.ndarray, triangles: np.ndarray, halfedges: np.ndarray, creases: np.ndarray, component: np.ndarray
) -> np.ndarray:
    """Return the face (T,) of each triangle in connected parts with bevels, with the half of each bevel next to it; -1 in other parts.

    Args:
        vertices: (V, 3). triangles: (T, 3).
        halfedges: (I, 2), 3 t + c, pairs across which triangles are connected.
        creases: (I,) bool, which of them are sharp edges.
        component: (T,) the connected part.
    """
    count, pairs = len(triangles), halfedges // 3
    folds, areas = fold_angles(vertices, triangles, halfedges), face_areas_and_normals(vertices[triangles])[0]
    lengths = np.linalg.norm(np.subtract(*vertices[halfedge_ends(triangles, halfedges[:, 0])].transpose(1, 0, 2)), axis=1)
    part_areas = np.bincount(component, areas)
    total, facets = label_components(count, halfedges[folds < COPLANAR_FOLD])
    facet_areas = np.bincount(facets, areas, total)
    is_side = facets[pairs[:, 0]] != facets[pairs[:, 1]]
    sides, folds, lengths = facets[pairs[is_side]], folds[is_side], lengths[is_side]
    turns = np.where(folds < MAX_BEVEL_FOLD, lengths * folds, 0.0)
    curvature = np.bincount(sides.ravel(), np.repeat(0.5 * turns, 2), total) / np.maximum(facet_areas, TINY)
    facet_parts = np.zeros(total, np.int64)
    facet_parts[facets] = component
    is_band = curvature * np.sqrt(part_areas[facet_parts]) > MIN_CURVATURE
    is_inside = ~creases & ~is_band[facets[pairs]].any(axis=1)
    face_count, faces = label_components(count, halfedges[is_inside])
    face_areas, face_parts = np.bincount(faces, areas, face_count), np.zeros(face_count, np.int64)
    face_parts[faces] = component
    is_face = face_areas > MIN_FACE_AREA * part_areas[face_parts]
    is_face[faces[is_band[facets]]] = False
    is_good = is_face & (_integrate_curvature(vertices, triangles, halfedges[is_inside], faces, face_count) < MAX_FACE_CURVATURE)
    good_areas = np.bincount(face_parts, face_areas * is_good, len(part_areas))
    has_bands = np.bincount(component, is_band[facets], len(part_areas)) > 0
    is_beveled = has_bands & (good_areas > MIN_FACES_AREA * part_areas) & (np.bincount(face_parts, is_face, len(part_areas)) > 1)
    if not is_beveled.any():
        return np.full(count, -1)
    facet_faces = np.zeros(total, np.int64)
    facet_faces[facets] = faces  # A facet of a face is inside of it.
    ranks = np.empty(face_count)
    ranks[np.argsort(-face_areas, kind="stable")] = np.arange(face_count) / face_count
    owners = _grow(sides, folds, lengths, is_band, PREFERENCE * ranks[facet_faces])
    labels = np.where(owners >= 0, facet_faces[owners], face_count + np.arange(total))[facets]
    is_left = labels >= face_count
    _, rest = label_components(count, halfedges[~creases & is_left[pairs].all(axis=1)])
    labels = np.where(is_left, face_count + rest, labels)
    return np.where(is_beveled[component], labels, -1)


def _grow(sides: np.ndarray, folds: np.ndarray, lengths: np.ndarray, is_band: np.ndarray, handicaps: np.ndarray) -> np.ndarray:
    """Return for each of F facets the one outside of bands from which it is reached with the smallest turn, -1 where from none.

    sides: (I, 2) facets at edges. folds, lengths: (I,). is_band: (F,) bool. handicaps: (F,) turn that is added to those from each facet.
    """
    total = len(is_band)
    perimeters = np.bincount(sides.ravel(), np.repeat(lengths, 2), total)
    starts, ends = np.concatenate([sides, sides[:, ::-1]]).T
    keys, indices = np.unique(starts * total + ends, return_inverse=True)
    borders = np.bincount(indices, np.concatenate([lengths, lengths]))
    turns = np.bincount(indices, np.concatenate([lengths * folds] * 2)) / np.maximum(borders, TINY)
    starts, ends = np.divmod(keys, total)
    is_used = is_band[ends] & (borders > MIN_COMMON_BORDER * perimeters[ends]) & (turns < MAX_BEVEL_FOLD)
    costs = np.where(is_band[starts], turns, turns + handicaps[starts])[is_used] + TINY
    graph = coo_array((costs, (starts[is_used], ends[is_used])), shape=(total, total)).tocsr()
    distances, _, owners = dijkstra(graph, indices=np.flatnonzero(~is_band), return_predecessors=True, min_only=True)
    return np.where(np.isfinite(distances), owners, -1)


def _integrate_curvature(
    vertices: np.ndarray, triangles: np.ndarray, halfedges: np.ndarray, faces: np.ndarray, face_count: int
) -> np.ndarray:
    """Return the integral of the absolute Gaussian curvature inside each of `faces` (T,), connected across `halfedges` (I, 2)."""
    corner_vertices = split_vertices(triangles, halfedges)
    total = int(corner_vertices.max()) + 1
    corners = vertices[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    cosines = -np.einsum("tci,tci->tc", edges, np.roll(edges, 1, axis=1))
    sines = np.linalg.norm(np.cross(edges, np.roll(edges, 1, axis=1)), axis=2)
    defects = 2.0 * np.pi - np.bincount(corner_vertices.ravel(), np.arctan2(sines, cosines).ravel(), total)
    is_boundary = np.ones(triangles.size, bool)
    is_boundary[halfedges.ravel()] = False
    triangle, corner = np.divmod(np.flatnonzero(is_boundary), 3)
    for step in (1, 2):
        defects[corner_vertices[triangle, (corner + step) % 3]] = 0.0
    vertex_faces = np.zeros(total, np.int64)
    vertex_faces[corner_vertices] = faces[:, None]
    return np.bincount(vertex_faces, np.abs(defects), face_count)
