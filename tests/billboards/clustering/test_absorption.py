"""Tests of the absorption: specks and slivers within the error of a larger quad move to it, others stay."""

import numpy as np
import pytest

from farfield.addon.core.billboards.clustering.absorption import absorb_small_patches, complete_regions
from farfield.addon.core.billboards.clustering.patches import Patch
from farfield.addon.core.billboards.primitives import from_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from shapes import sheet

ERROR = 0.05


def speck(size, height):
    """Return a wall of `size` on the sheet, from z = `height` on."""
    corners = np.array([[0.5, 0.5, height], [0.5 + size, 0.5, height], [0.5, 0.5, height + size]])
    return TriangleMesh(corners, np.array([[0, 1, 2]], np.int32))


def absorb(size, height, kind=False):
    """Return the patches of a sheet and of a wall on it, after absorption, and the mesh."""
    ground = sheet(4)
    mesh = concatenate([TriangleMesh(ground.vertices - ground.vertices.min(axis=0), ground.triangles), speck(size, height)])
    primitives = from_mesh(mesh)
    members, wall = np.arange(len(ground.triangles)), np.array([len(ground.triangles)])
    axes = np.eye(3)
    patches = [
        Patch(axes[2], 0.0, axes[:2], np.array([0.0, 1.0, 0.0, 1.0]), members, members),
        Patch(-axes[1], -0.5, axes[[0, 2]], np.array([0.5, 0.5 + size, height, height + size]), wall, wall),
    ]
    kinds = np.zeros(len(primitives), bool)
    kinds[wall] = kind
    return absorb_small_patches(primitives, kinds, patches, ERROR)


@pytest.mark.parametrize(
    ("size", "height", "kind", "count"), [(0.04, 0.0, False, 1), (0.04, 0.02, False, 2), (0.04, 0.0, True, 2), (0.2, 0.0, False, 2)]
)
def test_only_specks_of_one_kind_within_the_error_are_absorbed(size, height, kind, count):
    patches = absorb(size, height, kind)
    assert len(patches) == count
    if count == 1:
        assert patches[0].drawn.tolist() == list(range(len(patches[0].drawn)))
        assert len(patches[0].drawn) == len(patches[0].region) == 33


def test_nothing_happens_without_a_large_quad():
    patches = absorb(0.04, 0.0)[:0]
    assert patches == []


def square(height, side, normal=1.0):
    """Return two triangles of a horizontal square around the origin at `height`, facing up or down."""
    corners = 0.5 * side * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) + [0.0, 0.0, height]
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return TriangleMesh(corners, triangles if normal > 0.0 else triangles[:, ::-1].copy())


def horizontal_patch(members, height, side, normal=1.0):
    """Return the patch of a `square`."""
    axes = np.diag([1.0, normal, normal])
    rectangle = 0.5 * side * np.array([-1.0, 1.0, -1.0, 1.0])
    return Patch(axes[2], normal * height, axes[:2], rectangle, members, members)


@pytest.mark.parametrize(("host", "count"), [(0.13, 2), (0.16, 1)], ids=["hardly larger", "half again as large"])
def test_a_speck_needs_a_clearly_larger_host(host, count):
    """Otherwise the sides of something round, which are all specks but one, would leave only that one."""
    primitives = from_mesh(concatenate([square(0.0, host), square(0.02, 0.1)]))
    patches = [horizontal_patch(np.arange(2), 0.0, host), horizontal_patch(np.arange(2, 4), 0.02, 0.1)]
    assert len(absorb_small_patches(primitives, np.zeros(4, bool), patches, ERROR)) == count


def test_a_host_that_faces_the_same_way_is_preferred_to_a_nearer_one():
    primitives = from_mesh(concatenate([square(0.0, 1.0, -1.0), square(0.045, 1.0), square(0.01, 0.04)]))
    patches = [
        horizontal_patch(np.arange(2), 0.0, 1.0, -1.0),
        horizontal_patch(np.arange(2, 4), 0.045, 1.0),
        horizontal_patch(np.arange(4, 6), 0.01, 0.04),
    ]
    below, above = absorb_small_patches(primitives, np.zeros(6, bool), patches, ERROR)
    assert below.drawn.tolist() == [0, 1] and above.drawn.tolist() == [2, 3, 4, 5]


def test_a_picture_shows_all_that_faces_its_quad_within_the_error():
    primitives = from_mesh(concatenate([square(0.0, 1.0), square(0.04, 0.2), square(0.02, 0.2, -1.0), square(0.2, 0.2)]))
    patches = [horizontal_patch(np.arange(2), 0.0, 1.0)]
    sheets = np.zeros(8, bool)
    assert complete_regions(primitives, sheets, patches, ERROR)[0].region.tolist() == [0, 1, 2, 3]
    sheets[2:] = True
    assert complete_regions(primitives, sheets, patches, ERROR)[0].region.tolist() == [0, 1]
