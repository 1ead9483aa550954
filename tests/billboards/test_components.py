"""Tests of the connected components: solids, components and leaves are distinguished, and shared components are found."""

import numpy as np

from farfield.addon.core.billboards.primitives import find_components, find_shared_surfaces, from_mesh, from_points
from farfield.addon.core.geometry.mesh import PointCloud, concatenate
from shapes import cylinder, leaf_cards, sheet, sphere


def test_ball_trunk_and_leaves_are_distinguished():
    ball, trunk, leaves = sphere(6), cylinder(radius=0.1), leaf_cards(100)
    components = find_components(from_mesh(concatenate([ball, trunk, leaves])))
    kinds = np.repeat(["ball", "trunk", "leaf"], [len(part.triangles) for part in (ball, trunk, leaves)])
    np.testing.assert_array_equal(components.solid, kinds == "ball")
    np.testing.assert_array_equal(components.loose, kinds == "leaf")
    assert len(np.unique(components.labels)) == 102


def test_points_are_one_component():
    points = sphere(4).vertices
    components = find_components(from_points(PointCloud(points, points, np.full(len(points), 0.1))))
    assert not components.labels.any() and not components.solid.any() and not components.loose.any()


def test_surface_is_shared_if_two_quads_own_parts_of_it():
    components = find_components(from_mesh(concatenate([sheet(2), sphere(4), leaf_cards(60)])))
    owner = np.zeros(len(components.labels), np.int32)
    assert not find_shared_surfaces(components, owner).any()
    owner[10:20] = 1  # some of the sphere
    owner[-61:-60] = 1  # half of a leaf: loose parts are never shared
    shared = find_shared_surfaces(components, owner)
    np.testing.assert_array_equal(shared, components.labels == components.labels[10])
