"""Edges of a mesh: known counts, boundary edges, adjacency."""

import numpy as np

from farfield.addon.core.geometry.edges import find_edges
from shapes import sheet, sphere


def test_a_closed_surface_has_no_boundary_and_satisfies_eulers_formula():
    triangles = sphere(8).triangles
    edges = find_edges(triangles)
    assert (edges.face_counts == 2).all()
    assert not edges.boundary_vertices.any()
    assert edges.vertex_count - len(edges.ends) + len(triangles) == 2
    assert len(edges.interior_halfedges) == len(edges.ends)


def test_the_boundary_vertices_of_a_sheet():
    mesh = sheet(5)
    edges = find_edges(mesh.triangles)
    boundary = ((mesh.vertices[:, :2] == 0.0) | (mesh.vertices[:, :2] == 1.0)).any(axis=1)
    assert np.array_equal(edges.boundary_vertices, boundary)
    assert (edges.face_counts == 1).sum() == 20


def test_face_edges_are_opposite_to_their_corners():
    triangles = sphere(6).triangles
    edges = find_edges(triangles)
    for corner in range(3):
        others = np.sort(np.delete(triangles, corner, axis=1), axis=1)
        assert np.array_equal(edges.ends[edges.face_edges[:, corner]], others)


def test_between_finds_existing_edges_only():
    edges = find_edges(np.array([[0, 1, 2], [2, 1, 5]]))
    first, second = np.triu_indices(6, 1)
    indices = edges.between(second, first)
    assert edges.ends[indices[indices >= 0]].tolist() == [[0, 1], [0, 2], [1, 2], [1, 5], [2, 5]]
    assert np.array_equal(np.stack([first, second], axis=1)[indices >= 0], edges.ends)


def test_both_halfedges_of_an_edge_have_the_same_ends_in_different_triangles():
    triangles = sphere(6).triangles
    halfedges = find_edges(triangles).interior_halfedges
    first, second = (np.stack([triangles.ravel()[3 * (h // 3) + (h % 3 + step) % 3] for step in (1, 2)]) for h in halfedges.T)
    assert (halfedges[:, 0] // 3 != halfedges[:, 1] // 3).all()
    assert np.array_equal(first, second[::-1])
