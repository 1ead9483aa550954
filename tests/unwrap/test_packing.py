"""Packing and xatlas: charts keep their shapes, do not overlap, and neither size nor extreme proportions take long."""

import numpy as np
import pytest

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.atlas_seams import find_atlas_seams
from farfield.addon.core.unwrap.packing import pack_charts
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import unwrap
from shapes import box, cylinder

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SQUARE_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def pack_rectangles(sides, margin=0.01):
    """Pack rectangles and return their lower and upper corners (C, 2)."""
    packed = pack_charts([SQUARE * side for side in sides], [SQUARE_TRIANGLES] * len(sides), margin)
    return np.array([uv.min(axis=0) for uv in packed]), np.array([uv.max(axis=0) for uv in packed])


def assert_separate(low, high):
    assert low.min() >= 0.0 and high.max() <= 1.0 + 1e-9
    for first in range(len(low)):
        for second in range(first):
            assert (low[first] >= high[second]).any() or (low[second] >= high[first]).any()


@pytest.mark.parametrize("unit", [1e-30, 1e-6, 1.0, 1e6, 1e19, 1e30])
def test_the_unit_of_length_does_not_matter(unit):
    """xatlas does not end when the squares of coordinates exceed single precision."""
    sides = np.array([[1.0, 2.0], [3.0, 1.0], [0.5, 0.5]])
    low, high = pack_rectangles(unit * sides)
    assert_separate(low, high)
    expected_low, expected_high = pack_rectangles(sides)
    np.testing.assert_allclose(high - low, expected_high - expected_low, rtol=1e-5)


@pytest.mark.parametrize("length", [1e3, 1e6, 1e12, 1e30])
def test_thin_charts_of_any_length_are_packed(length):
    low, high = pack_rectangles([[length, 1.0], [length, 1.0 / length], [1.0, 1.0]])
    assert_separate(low, high)
    assert 0.95 < (high - low)[0].max() <= 0.98 + 1e-9


@pytest.mark.parametrize("unit", [1e-30, 1e-3, 1.0, 1e6, 1e19, 1e36])
def test_seams_do_not_depend_on_the_unit_of_length(unit):
    mesh = cylinder(radius=0.5, length=2.0, sides=12, cuts=2)
    expected = find_atlas_seams(mesh, np.arange(len(mesh.triangles)))
    seams = find_atlas_seams(TriangleMesh(unit * mesh.vertices, mesh.triangles), np.arange(len(mesh.triangles)))
    assert len(seams) > 0
    np.testing.assert_array_equal(seams, expected)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("islands", ["one", "atlas"])
@pytest.mark.parametrize("length", [1e4, 1e10])
def test_a_surface_with_a_far_vertex_is_unwrapped(islands, length):
    mesh = box(cuts=2)
    vertices = mesh.vertices.copy()
    vertices[0, 1] = -length
    triangle_count = len(mesh.triangles)
    steps = unwrap(
        TriangleMesh(vertices, mesh.triangles),
        np.arange(triangle_count),
        np.zeros((0, 2), np.int64),
        np.zeros(triangle_count),
        UnwrapSettings(islands=islands),
    )
    assert np.isfinite(run_to_end(steps).corner_uvs).all()
