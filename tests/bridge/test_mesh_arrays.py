"""Meshes written from arrays are read back unchanged."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.geometry import mesh_arrays

POSITIONS = np.random.default_rng(0).random((5, 3))
LOOP_VERTICES, POLYGON_STARTS = np.array([0, 1, 2, 2, 1, 3, 4]), np.array([0, 3])


@pytest.fixture
def mesh(extension) -> bpy.types.Mesh:
    """A triangle and a quadrilateral."""
    blender_scenes.reset_scene()
    mesh = bpy.data.meshes.new("Test")
    mesh_arrays.write_geometry(mesh, POSITIONS, LOOP_VERTICES, POLYGON_STARTS)
    return mesh


def test_polygons_round_trip(mesh):
    np.testing.assert_array_equal(mesh_arrays.read_positions(mesh), POSITIONS.astype(np.float32))
    np.testing.assert_array_equal(mesh_arrays.read_loop_vertices(mesh), LOOP_VERTICES)
    assert [list(polygon.vertices) for polygon in mesh.polygons] == [[0, 1, 2], [2, 1, 3, 4]]
    assert len(mesh.edges) == 6 and not mesh.validate()
    mesh_arrays.write_positions(mesh, 2.0 * POSITIONS)
    np.testing.assert_array_equal(mesh_arrays.read_positions(mesh), (2.0 * POSITIONS).astype(np.float32))
    loops, polygons = mesh_arrays.read_loop_triangles(mesh)
    assert loops.shape == (3, 3) and polygons.tolist() == [0, 1, 1]


def test_geometry_is_replaced(mesh):
    mesh_arrays.write_triangles(mesh, POSITIONS[:3], np.array([[0, 1, 2]]))
    assert [list(polygon.vertices) for polygon in mesh.polygons] == [[0, 1, 2]]
    mesh_arrays.write_geometry(mesh, np.empty((0, 3)), np.empty(0, int), np.empty(0, int))
    assert not len(mesh.vertices) and not len(mesh.loops) and not len(mesh.polygons)


@pytest.mark.parametrize(("domain", "count"), [("POINT", 5), ("CORNER", 7), ("FACE", 2)])
@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_attributes_round_trip(mesh, domain, count, width):
    values = np.random.default_rng(width).random((count, width)).astype(np.float32)
    values = values[:, 0] if width == 1 else values
    for factor in (1.0, 0.5):  # created, then overwritten
        mesh_arrays.write_attribute(mesh, "Test", domain, factor * values)
        np.testing.assert_array_equal(mesh_arrays.read_attribute(mesh.attributes["Test"]), np.float32(factor) * values)
    assert mesh.attributes["Test"].domain == domain


def test_uv_maps_round_trip(mesh):
    uvs = np.random.default_rng(1).random((7, 2)).astype(np.float32)
    mesh_arrays.write_attribute(mesh, "UVMap", "CORNER", np.zeros((7, 2)))
    layer = mesh.uv_layers["UVMap"]
    mesh_arrays.write_uvs(layer, uvs)
    np.testing.assert_array_equal(mesh_arrays.read_uvs(layer), uvs)
