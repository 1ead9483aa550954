"""Patches become quads that show what they should: owned once, drawn where it is seen, lost nowhere."""

import numpy as np
import pytest

from farfield.addon.core.billboards.patches import Covering, Patch, members_of, overlapping, owners_of_groups, squarest, to_quads
from farfield.addon.core.billboards.primitives import Primitives, from_mesh
from farfield.addon.core.billboards.rectangles import bounds_of, inside
from farfield.addon.core.mesh import TriangleMesh
from shapes import sheet

NORMAL = np.array([0.0, 0.0, 1.0])
AXES = np.eye(3)[:2]


def row(count: int) -> Primitives:
    """Unit squares side by side along X, two triangles each, in the plane z = 0; square i holds the primitives 2 i and 2 i + 1."""
    square = sheet(1)
    vertices = np.concatenate([square.vertices + [float(place), 0.0, 0.0] for place in range(count)])
    triangles = np.concatenate([square.triangles + 4 * place for place in range(count)])
    return from_mesh(TriangleMesh(vertices, triangles.astype(np.int32)))


def patch(primitives: Primitives, low: float, high: float) -> Patch:
    """A patch over low..high along X; its region is everything."""
    rectangle = np.array([low, high, 0.0, 1.0])
    shown = np.flatnonzero(inside(bounds_of(primitives.positions, AXES), rectangle))
    return Patch(NORMAL, 0.0, AXES, rectangle, shown, np.arange(len(primitives)))


def test_members_and_labels_are_two_ways_to_say_one_thing():
    labels = np.random.default_rng(0).integers(0, 7, 100)
    for label, members in enumerate(members_of(labels)):
        np.testing.assert_array_equal(members, np.flatnonzero(labels == label))


def test_a_face_belongs_to_the_patch_that_it_faces_most_squarely():
    primitives = row(3)
    slanted = Patch(np.array([0.0, 0.6, 0.8]), 0.0, AXES, np.array([0.0, 3.0, 0.0, 1.0]), np.arange(4), np.arange(4))
    np.testing.assert_array_equal(squarest(primitives, [slanted, patch(primitives, 1.0, 2.0)]), [0, 0, 1, 1, -1, -1])


def test_a_group_belongs_whole_to_the_patch_that_shows_most_of_it():
    primitives = row(5)
    patches = [patch(primitives, 0.0, 2.0), patch(primitives, 2.0, 5.0)]
    groups = np.repeat([0, 1], [6, 4])
    np.testing.assert_array_equal(owners_of_groups(primitives, patches, groups), np.repeat([0, 1], [6, 4]))


class TestOverlapping:
    """What is drawn on which patch."""

    def test_a_shared_surface_is_drawn_across_the_seam(self):
        primitives = row(6)
        patches = [patch(primitives, 0.0, 3.0), patch(primitives, 3.0, 6.0)]
        covering = Covering(patches, np.repeat([0, 1], 6).astype(np.int32))
        drawn = overlapping(primitives, covering, np.ones(12, bool), 0.25)
        np.testing.assert_allclose(drawn.patches[0].rectangle, [-0.25, 3.25, -0.25, 1.25])
        np.testing.assert_array_equal(drawn.patches[0].shown, np.arange(8))
        np.testing.assert_array_equal(drawn.patches[1].shown, np.arange(4, 12))
        np.testing.assert_array_equal(drawn.owner, covering.owner)

    def test_leaves_are_drawn_once(self):
        primitives = row(4)
        patches = [patch(primitives, 0.0, 3.0), patch(primitives, 1.0, 4.0)]
        covering = Covering(patches, np.repeat([0, 1], 4).astype(np.int32))
        drawn = overlapping(primitives, covering, np.zeros(8, bool), 0.25)
        for number, each in enumerate(drawn.patches):
            np.testing.assert_array_equal(each.shown, np.flatnonzero(covering.owner == number))
            np.testing.assert_array_equal(each.rectangle, patches[number].rectangle)

    def test_a_leaf_beyond_its_owner_s_rectangle_is_drawn_by_another(self):
        """A coarse quad owns whole groups, and may reach only part of one."""
        primitives = row(5)
        patches = [patch(primitives, 0.0, 2.0), patch(primitives, 2.0, 5.0)]
        groups = np.repeat([0, 1], [6, 4])
        covering = Covering(patches, owners_of_groups(primitives, patches, groups))
        drawn = overlapping(primitives, covering, np.zeros(10, bool), 0.25)
        np.testing.assert_array_equal(np.sort(np.concatenate([each.shown for each in drawn.patches])), np.arange(10))
        np.testing.assert_array_equal(drawn.owner, groups)

    def test_a_patch_that_draws_nothing_goes(self):
        primitives = row(4)
        patches = [patch(primitives, 0.0, 3.0), patch(primitives, 1.0, 2.0), patch(primitives, 3.0, 4.0)]
        covering = Covering(patches, np.repeat([0, 2], [6, 2]).astype(np.int32))
        drawn = overlapping(primitives, covering, np.zeros(8, bool), 0.25)
        assert drawn.patches[1].rectangle is patches[2].rectangle
        np.testing.assert_array_equal(drawn.owner, np.repeat([0, 1], [6, 2]))

    def test_an_outline_stays(self):
        primitives = row(2)
        cut = Patch(NORMAL, 0.0, AXES, np.array([0.0, 2.0, 0.0, 1.0]), np.arange(4), np.arange(4), np.eye(3)[:, :2])
        drawn = overlapping(primitives, Covering([cut], np.zeros(4, np.int32)), np.ones(4, bool), 0.25)
        assert drawn.patches[0] is cut


def test_quads_are_the_rectangles_in_space():
    normal = np.array([0.0, -0.6, 0.8])
    axes = np.array([[1.0, 0.0, 0.0], np.cross(normal, [1.0, 0.0, 0.0])])
    rectangle = np.array([-1.0, 3.0, 2.0, 5.0])
    patches = [Patch(normal, 7.0, axes, rectangle, np.array([2, 0]), np.arange(3)), patch(row(2), 0.0, 1.0)]
    quads = to_quads(patches, np.array([0, 1, 0]))
    corners = quads.corners()[0]
    np.testing.assert_allclose(corners @ normal, 7.0)
    np.testing.assert_allclose(corners @ axes.T, [[-1.0, 2.0], [3.0, 2.0], [3.0, 5.0], [-1.0, 5.0]])
    assert quads.areas.tolist() == pytest.approx([12.0, 1.0])
    np.testing.assert_allclose(np.linalg.det(quads.frames), 1.0)
    assert quads.drawn_offsets.tolist() == [0, 2, 4] and quads.drawn.tolist() == [0, 2, 0, 1]
