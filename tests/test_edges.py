"""Edges of a mesh: known counts, and the border where only one triangle is."""

import numpy as np

from farfield.addon.core.edges import edges_of
from shapes import sheet, sphere


def test_a_closed_surface_has_no_border_and_the_edges_that_euler_asks_for():
    triangles = sphere(8).triangles
    edges = edges_of(triangles)
    assert (edges.uses == 2).all()
    assert not edges.on_border.any()
    assert edges.count - len(edges.ends) + len(triangles) == 2
    assert len(edges.inner_sides) == len(edges.ends)


def test_the_border_of_a_sheet_is_its_rim():
    mesh = sheet(5)
    edges = edges_of(mesh.triangles)
    rim = ((mesh.vertices[:, :2] == 0.0) | (mesh.vertices[:, :2] == 1.0)).any(axis=1)
    assert np.array_equal(edges.on_border, rim)
    assert (edges.uses == 1).sum() == 20


def test_edges_stand_opposite_to_their_corners():
    triangles = sphere(6).triangles
    edges = edges_of(triangles)
    for corner in range(3):
        others = np.sort(np.delete(triangles, corner, axis=1), axis=1)
        assert np.array_equal(edges.ends[edges.opposite[:, corner]], others)


def test_two_vertices_are_joined_where_an_edge_is():
    edges = edges_of(np.array([[0, 1, 2], [2, 1, 5]]))
    first, second = np.triu_indices(6, 1)
    found = edges.between(second, first)
    assert edges.ends[found[found >= 0]].tolist() == [[0, 1], [0, 2], [1, 2], [1, 5], [2, 5]]
    assert np.array_equal(np.stack([first, second], axis=1)[found >= 0], edges.ends)


def test_sides_across_an_edge_belong_to_different_triangles():
    triangles = sphere(6).triangles
    sides = edges_of(triangles).inner_sides
    first, second = (np.stack([triangles.ravel()[3 * (side // 3) + (side % 3 + turn) % 3] for turn in (1, 2)]) for side in sides.T)
    assert (sides[:, 0] // 3 != sides[:, 1] // 3).all()
    assert np.array_equal(first, second[::-1])
