"""Distances between points of equal texture coordinates, of the benchmark of ordinary assets: known distances of overlapping, empty and
missing texture coordinates."""

from dataclasses import replace

import numpy as np
import pytest
from texmesh_equal_uvs import MeasuredSurface, measure_largest, measure_texture

from farfield.addon.core.geometry.mesh import concatenate
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import sheet

COUNT = 2000


def build_sheets(offsets: tuple[float, ...], shift: float = 0.0, uv_scale: float = 1.0) -> TexturedMesh:
    """Return sheets side by side along x, whose texture coordinates are x and y of the first one: all use the same ones."""
    single = sheet(4, lambda x, y: 0.0 * (x + y))
    mesh = concatenate([replace(single, vertices=single.vertices + [offset, 0.0, 0.0]) for offset in offsets])
    uvs = np.tile(uv_scale * single.vertices[:, :2] + [shift, 0.0], (len(offsets), 1))
    return build_textured_mesh(mesh, uvs[mesh.triangles])


def measure(source: TexturedMesh, target: TexturedMesh):
    return measure_texture(MeasuredSurface(source, COUNT), MeasuredSurface(target, COUNT))


@pytest.mark.parametrize("uv_scale", [1.0, 0.0])
def test_surfaces_with_repeated_or_empty_texture_coordinates_do_not_deviate_from_themselves(uv_scale):
    mesh = build_sheets((0.0, 2.0, 4.0), uv_scale=uv_scale)
    found = measure(mesh, mesh)
    assert found.distances.max() < 1e-9 and not found.is_lost.any()


def test_the_nearest_of_several_places_with_equal_texture_coordinates_counts():
    both, one = build_sheets((0.0, 2.0)), build_sheets((0.0,))
    assert measure(one, both).distances.max() < 1e-9
    distances = measure(both, one).distances
    assert np.isclose(distances, 2.0).mean() == pytest.approx(0.5, abs=0.01)
    assert measure_largest(MeasuredSurface(one, COUNT), MeasuredSurface(both, COUNT)) == pytest.approx(2.0)


def test_a_point_without_partner_gets_the_nearest_point_and_is_lost():
    shift = 0.25
    fine, level = build_sheets((0.0,)), build_sheets((0.0,), shift=shift)
    found = measure(fine, level)
    assert found.is_lost.mean() == pytest.approx(shift, abs=0.01)
    assert found.distances[found.is_lost].max() < 1e-9
    np.testing.assert_allclose(found.distances[~found.is_lost], shift)


def test_texture_coordinates_of_another_material_do_not_count():
    first, second = build_sheets((0.0,)), build_sheets((0.0, 2.0))
    first = replace(first, materials=np.zeros_like(first.materials))
    second = replace(second, materials=np.repeat([1, 0], len(second.triangles) // 2).astype(np.int32))
    found = measure(first, second)
    np.testing.assert_allclose(found.distances, 2.0)
