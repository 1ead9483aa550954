"""Leaves, trunk and solids are told apart, and what several quads share is known."""

import numpy as np

from farfield.addon.core.billboards.primitives import from_mesh, from_points
from farfield.addon.core.billboards.surfaces import shared_surfaces, surfaces_of
from farfield.addon.core.mesh import PointCloud, merge
from shapes import cards, cylinder, sheet, sphere


def test_a_ball_a_trunk_and_leaves():
    ball, trunk, leaves = sphere(6), cylinder(radius=0.1), cards(100)
    surfaces = surfaces_of(from_mesh(merge([ball, trunk, leaves])))
    kinds = np.repeat(["ball", "trunk", "leaf"], [len(part.triangles) for part in (ball, trunk, leaves)])
    np.testing.assert_array_equal(surfaces.solid, kinds == "ball")
    np.testing.assert_array_equal(surfaces.loose, kinds == "leaf")
    assert len(np.unique(surfaces.parts)) == 102


def test_points_are_one_part():
    points = sphere(4).vertices
    surfaces = surfaces_of(from_points(PointCloud(points, points, np.full(len(points), 0.1))))
    assert not surfaces.parts.any() and not surfaces.solid.any() and not surfaces.loose.any()


def test_a_surface_is_shared_when_two_quads_own_pieces_of_it():
    surfaces = surfaces_of(from_mesh(merge([sheet(2), sphere(4), cards(60)])))
    owner = np.zeros(len(surfaces.parts), np.int32)
    assert not shared_surfaces(surfaces, owner).any()
    owner[10:20] = 1  # some of the sphere
    owner[-61:-60] = 1  # half of a leaf: leaves do not count
    shared = shared_surfaces(surfaces, owner)
    np.testing.assert_array_equal(shared, surfaces.parts == surfaces.parts[10])
