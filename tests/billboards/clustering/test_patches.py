"""Tests of the patches: every primitive is owned once and drawn on the right quads."""

import numpy as np
import pytest

from farfield.addon.core.billboards.clustering.patches import (
    Covering,
    Patch,
    assign_groups,
    best_facing_patch,
    extend_overlaps,
    group_by_label,
    to_quads,
)
from farfield.addon.core.billboards.clustering.rectangles import compute_bounds, is_inside
from farfield.addon.core.billboards.primitives import Primitives, from_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh
from shapes import sheet

NORMAL = np.array([0.0, 0.0, 1.0])
AXES = np.eye(3)[:2]


def make_row(count: int) -> Primitives:
    """Return adjacent unit squares along X, two triangles each, in the plane z = 0. Square i has the primitives 2 i and 2 i + 1."""
    square = sheet(1)
    vertices = np.concatenate([square.vertices + [float(index), 0.0, 0.0] for index in range(count)])
    triangles = np.concatenate([square.triangles + 4 * index for index in range(count)])
    return from_mesh(TriangleMesh(vertices, triangles.astype(np.int32)))


def make_patch(primitives: Primitives, low: float, high: float) -> Patch:
    """Return a patch over low..high along X whose region has all primitives."""
    rectangle = np.array([low, high, 0.0, 1.0])
    drawn = np.flatnonzero(is_inside(compute_bounds(primitives.positions, AXES), rectangle))
    return Patch(NORMAL, 0.0, AXES, rectangle, drawn, np.arange(len(primitives)))


def test_members_of_labels():
    labels = np.random.default_rng(0).integers(0, 7, 100)
    for label, members in enumerate(group_by_label(labels)):
        np.testing.assert_array_equal(members, np.flatnonzero(labels == label))


def test_best_facing_patch_has_the_smallest_angle():
    primitives = make_row(3)
    oblique = Patch(np.array([0.0, 0.6, 0.8]), 0.0, AXES, np.array([0.0, 3.0, 0.0, 1.0]), np.arange(4), np.arange(4))
    np.testing.assert_array_equal(best_facing_patch(primitives, [oblique, make_patch(primitives, 1.0, 2.0)]), [0, 0, 1, 1, -1, -1])


def test_groups_are_assigned_to_the_patch_that_shows_most_of_them():
    primitives = make_row(5)
    patches = [make_patch(primitives, 0.0, 2.0), make_patch(primitives, 2.0, 5.0)]
    groups = np.repeat([0, 1], [6, 4])
    np.testing.assert_array_equal(assign_groups(primitives, patches, groups), np.repeat([0, 1], [6, 4]))


class TestOverlapping:
    """Primitives drawn on each patch."""

    def test_shared_surfaces_are_drawn_across_the_seam(self):
        primitives = make_row(6)
        patches = [make_patch(primitives, 0.0, 3.0), make_patch(primitives, 3.0, 6.0)]
        covering = Covering(patches, np.repeat([0, 1], 6).astype(np.int32))
        extended = extend_overlaps(primitives, covering, np.ones(12, bool), 0.1)
        np.testing.assert_allclose(extended.patches[0].rectangle, [-0.05, 3.05, -0.05, 1.05])
        np.testing.assert_array_equal(extended.patches[0].drawn, np.arange(8))
        np.testing.assert_array_equal(extended.patches[1].drawn, np.arange(4, 12))
        np.testing.assert_array_equal(extended.owner, covering.owner)

    @pytest.mark.parametrize(("error", "margin"), [(0.1, 0.05), (0.2, 0.0625), (0.5, 0.125)])
    def test_narrow_patches_are_extended_by_fewer_errors(self, error, margin):
        primitives = make_row(6)
        patches = [make_patch(primitives, 0.0, 3.0), make_patch(primitives, 3.0, 6.0)]
        covering = Covering(patches, np.repeat([0, 1], 6).astype(np.int32))
        (first, _) = extend_overlaps(primitives, covering, np.ones(12, bool), error).patches
        np.testing.assert_allclose(first.rectangle, [-margin, 3.0 + margin, -margin, 1.0 + margin])

    def test_leaves_are_drawn_once(self):
        primitives = make_row(4)
        patches = [make_patch(primitives, 0.0, 3.0), make_patch(primitives, 1.0, 4.0)]
        covering = Covering(patches, np.repeat([0, 1], 4).astype(np.int32))
        extended = extend_overlaps(primitives, covering, np.zeros(8, bool), 0.25)
        for index, patch in enumerate(extended.patches):
            np.testing.assert_array_equal(patch.drawn, np.flatnonzero(covering.owner == index))
            np.testing.assert_array_equal(patch.rectangle, patches[index].rectangle)

    def test_leaf_outside_its_owners_rectangle_is_drawn_on_another_patch(self):
        """A coarse quad owns whole groups, but its rectangle may contain only part of one."""
        primitives = make_row(5)
        patches = [make_patch(primitives, 0.0, 2.0), make_patch(primitives, 2.0, 5.0)]
        groups = np.repeat([0, 1], [6, 4])
        covering = Covering(patches, assign_groups(primitives, patches, groups))
        extended = extend_overlaps(primitives, covering, np.zeros(10, bool), 0.25)
        np.testing.assert_array_equal(np.sort(np.concatenate([patch.drawn for patch in extended.patches])), np.arange(10))
        np.testing.assert_array_equal(extended.owner, groups)

    def test_patches_that_draw_nothing_are_removed(self):
        primitives = make_row(4)
        patches = [make_patch(primitives, 0.0, 3.0), make_patch(primitives, 1.0, 2.0), make_patch(primitives, 3.0, 4.0)]
        covering = Covering(patches, np.repeat([0, 2], [6, 2]).astype(np.int32))
        extended = extend_overlaps(primitives, covering, np.zeros(8, bool), 0.25)
        assert extended.patches[1].rectangle is patches[2].rectangle
        np.testing.assert_array_equal(extended.owner, np.repeat([0, 1], [6, 2]))

    def test_patches_with_outline_do_not_change(self):
        primitives = make_row(2)
        outlined = Patch(NORMAL, 0.0, AXES, np.array([0.0, 2.0, 0.0, 1.0]), np.arange(4), np.arange(4), np.eye(3)[:, :2])
        extended = extend_overlaps(primitives, Covering([outlined], np.zeros(4, np.int32)), np.ones(4, bool), 0.25)
        assert extended.patches[0] is outlined


def test_quads_are_rectangles_in_space():
    normal = np.array([0.0, -0.6, 0.8])
    axes = np.array([[1.0, 0.0, 0.0], np.cross(normal, [1.0, 0.0, 0.0])])
    rectangle = np.array([-1.0, 3.0, 2.0, 5.0])
    patches = [Patch(normal, 7.0, axes, rectangle, np.array([2, 0]), np.arange(3)), make_patch(make_row(2), 0.0, 1.0)]
    quads = to_quads(patches, np.array([0, 1, 0]))
    corners = quads.corners()[0]
    np.testing.assert_allclose(corners @ normal, 7.0)
    np.testing.assert_allclose(corners @ axes.T, [[-1.0, 2.0], [3.0, 2.0], [3.0, 5.0], [-1.0, 5.0]])
    assert quads.areas.tolist() == pytest.approx([12.0, 1.0])
    np.testing.assert_allclose(np.linalg.det(quads.frames), 1.0)
    assert quads.drawn_offsets.tolist() == [0, 2, 4] and quads.drawn.tolist() == [0, 2, 0, 1]
