"""Tests of the slabs: any number of quads from six on, and more of them are closer to the surface."""

from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.clustering.slabs import cover_with_slabs
from farfield.addon.core.billboards.primitives import from_mesh
from shapes import box, soup, sphere


def max_distance(primitives, covering):
    """Return the largest distance of a corner to the plane of the patch that owns it."""
    patches = [covering.patches[index] for index in covering.owner]
    normals, offsets = np.array([patch.normal for patch in patches]), np.array([patch.offset for patch in patches])
    return np.abs(np.einsum("pci,pi->pc", primitives.positions, normals) - offsets[:, None]).max()


@pytest.mark.parametrize("mesh", [sphere(24), soup(100)], ids=["sphere", "soup"])
def test_more_slabs_have_smaller_errors(mesh):
    primitives = from_mesh(mesh)
    found = [cover_with_slabs(primitives, 2.0, count) for count in (6, 12, 24, 48)]
    for count, (covering, error) in zip((6, 12, 24, 48), found, strict=True):
        assert 0.9 * count <= len(covering.patches) <= count
        assert max_distance(primitives, covering) <= 2.0 * error <= 1.01 * max_distance(primitives, covering)
        np.testing.assert_array_equal(np.sort(np.concatenate([patch.drawn for patch in covering.patches])), np.arange(len(primitives)))
        for patch in covering.patches:
            np.testing.assert_allclose(np.cross(*patch.axes), patch.normal, atol=1e-12)
    assert all(coarse[1] > fine[1] for coarse, fine in pairwise(found))


def test_a_box_has_six_sides_and_no_error():
    covering, error = cover_with_slabs(from_mesh(box(cuts=2)), 1.0, 50)
    assert len(covering.patches) == 6 and error < 0.01
