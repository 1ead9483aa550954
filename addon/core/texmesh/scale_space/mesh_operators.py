"""Operators on triangle meshes: the cotangent Laplacian, and mean curvature as a measure.

The Laplacian is robust against thin triangles by intrinsic mollification after Sharp and Crane, "A Laplacian for Nonmanifold Triangle
Meshes" (2020), section 4.5: all edges are lengthened by the same small amount, so that no triangle is degenerate. Positions do not change.
Curvature that is integrated over the surface does not depend on the triangulation.
"""

import numpy as np
from scipy import sparse

from ...geometry.edges import Edges, halfedge_ends
from ...geometry.mesh import face_areas_and_normals

MOLLIFICATION = 1e-5  # of the mean edge length, by which two sides of a triangle together are longer than the third


def mollify_lengths(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the lengths (T, 3) of the edges opposite to the corners of `triangles` (T, 3), mollified. vertices: (V, 3)."""
    corners = vertices[triangles]
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1), axis=2)
    excess = lengths.sum(axis=1, keepdims=True) - 2.0 * lengths
    return lengths + max(0.0, MOLLIFICATION * float(lengths.mean()) - float(excess.min()))


def triangle_areas(lengths: np.ndarray) -> np.ndarray:
    """Return the areas (T,) of triangles with edge `lengths` (T, 3), by Kahan's stable form of Heron's formula."""
    c, b, a = np.sort(lengths, axis=1).T
    return 0.25 * np.sqrt(np.maximum((a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c)), 0.0))


def assemble_laplacian(triangles: np.ndarray, lengths: np.ndarray, vertex_count: int) -> sparse.csc_array:
    """Return the positive semidefinite cotangent Laplacian (V, V), the integral of the product of gradients of hat functions.

    triangles: (T, 3). lengths: (T, 3), of the edges opposite to each corner, none degenerate (`mollify_lengths`).
    """
    squared = lengths**2
    half_cotangents = (squared.sum(axis=1, keepdims=True) - 2.0 * squared) / (8.0 * triangle_areas(lengths))[:, None]
    starts, ends = np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, -2, axis=1).ravel()
    weights = half_cotangents.ravel()
    rows, columns = np.concatenate([starts, ends, starts, ends]), np.concatenate([ends, starts, starts, ends])
    values = np.concatenate([-weights, -weights, weights, weights])
    return sparse.coo_array((values, (rows, columns)), shape=(vertex_count, vertex_count)).tocsc()


def integrate_over_vertices(triangles: np.ndarray, areas: np.ndarray, corner_values: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return the integrals (V,) of `corner_values` (T, 3), each over a third of its triangle's area. areas: (T,)."""
    return np.bincount(triangles.ravel(), (areas[:, None] / 3.0 * corner_values).ravel(), minlength=vertex_count)


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
