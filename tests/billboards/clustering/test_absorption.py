"""Tests of the absorption: specks and slivers within the error of a larger quad move to it, others stay."""

import numpy as np
import pytest

from farfield.addon.core.billboards.clustering.absorption import absorb_small_patches
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
