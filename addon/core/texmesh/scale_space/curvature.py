"""Mean curvature of triangle meshes as a measure: integrated over the surface it does not depend on the triangulation."""

import numpy as np

from ...geometry.edges import Edges, halfedge_ends
from ...geometry.mesh import face_areas_and_normals


def integrate_mean_curvature(vertices: np.ndarray, triangles: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the mean curvature integrated around each vertex, (V,) float64, positive where the surface is convex (Steiner's formula).

    An edge has half its dihedral angle times its length, divided among its ends. Boundaries and edges with more than two triangles, or with
    two of opposite orientation, have none. The value of a vertex stays bounded however small its triangles are, so that filtering averages
    the noise of fine meshes, and a crease has the same strength at all densities.
    """
    corners = vertices[triangles]
    normals = face_areas_and_normals(corners)[1]
    first, second = edges.interior_halfedges.T
    starts, ends = halfedge_ends(triangles, first).T
    is_oriented = starts == halfedge_ends(triangles, second)[:, 1]
    first, second, starts, ends = first[is_oriented], second[is_oriented], starts[is_oriented], ends[is_oriented]
    left, right, along = normals[first // 3], normals[second // 3], vertices[ends] - vertices[starts]
    lengths = np.linalg.norm(along, axis=1)
    sines = np.einsum("ij,ij->i", np.cross(left, right), along / np.where(lengths > 0.0, lengths, 1.0)[:, None])
    angles = np.arctan2(sines, np.einsum("ij,ij->i", left, right))
    halves = 0.25 * angles * lengths
    return np.bincount(starts, halves, minlength=len(vertices)) + np.bincount(ends, halves, minlength=len(vertices))
