"""Meshes are filled completely, filled again, and kept up to a limit."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.geometry import mesh_arrays, mesh_pool
from farfield.addon.bridge.geometry.mesh_pool import PENDING_KEY, SPARE_KEY, PendingMeshes, fill_mesh
from farfield.addon.core.errors import GeometryError

pytestmark = pytest.mark.usefixtures("empty_scene")
VERTICES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def unit_vectors(*shape):
    vectors = np.random.default_rng(3).normal(size=(*shape, 3)) + [0.0, 0.0, 4.0]
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def corner_normals(mesh):
    return mesh_arrays.read_values(mesh.corner_normals, "vector", 3)


def test_everything_that_is_filled_is_read_back():
    mesh = bpy.data.meshes.new("Tile")
    normals, uvs = unit_vectors(4), np.random.default_rng(1).random((2, 3, 2)).astype(np.float32)
    fill_mesh(mesh, VERTICES, TRIANGLES, normals, uvs, np.array([1, 0]))
    np.testing.assert_array_equal(mesh_arrays.read_positions(mesh), VERTICES.astype(np.float32))
    np.testing.assert_array_equal(mesh_arrays.read_loop_vertices(mesh), TRIANGLES.ravel())
    np.testing.assert_allclose(corner_normals(mesh), normals[TRIANGLES.ravel()], atol=1e-3)
    np.testing.assert_array_equal(mesh_arrays.read_uvs(mesh.uv_layers["UVMap"]), uvs.reshape(-1, 2))
    assert mesh.uv_layers.active.name == "UVMap" and mesh.uv_layers.active.active_render
    assert [polygon.material_index for polygon in mesh.polygons] == [1, 0]
    assert len(mesh.edges) == 5 and not mesh.validate()


def test_normals_of_corners_may_differ_at_a_vertex():
    mesh, normals = bpy.data.meshes.new("Tile"), unit_vectors(2, 3)
    fill_mesh(mesh, VERTICES, TRIANGLES, normals)
    np.testing.assert_allclose(corner_normals(mesh), normals.reshape(-1, 3), atol=1e-3)


def test_a_mesh_that_is_filled_again_keeps_nothing_but_its_materials():
    mesh, material = bpy.data.meshes.new("Tile"), bpy.data.materials.new("Ground")
    mesh.materials.append(material)
    fill_mesh(mesh, VERTICES, TRIANGLES, unit_vectors(4), np.zeros((2, 3, 2)), np.array([0, 0]))
    fill_mesh(mesh, VERTICES[:3], TRIANGLES[:1])
    assert len(mesh.polygons) == 1 and not mesh.uv_layers and not mesh.has_custom_normals
    assert "material_index" not in mesh.attributes and not mesh.polygons[0].use_smooth and mesh.materials[0] == material
    fill_mesh(mesh, VERTICES, TRIANGLES, unit_vectors(4))
    assert mesh.has_custom_normals and mesh.polygons[0].use_smooth
    fill_mesh(mesh, np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty((0, 3)))
    assert not len(mesh.vertices) and not len(mesh.polygons)


def show(pending, item_of):
    """Show all pending meshes; the ones before become spare."""
    for key in pending.names:
        before, item = None, item_of.get(key)
        if item is None:
            item = item_of[key] = bpy.data.objects.new("Tile", pending.claim(key))
            bpy.context.collection.objects.link(item)
        else:
            before, item.data = item.data, pending.claim(key)
            mesh_pool.mark_spare(before, "test")


def test_two_sets_of_meshes_serve_any_number_of_changes():
    item_of = {}
    for _ in range(5):
        pending = PendingMeshes("test", "Tile")
        for key in range(4):
            pending.fill(key, VERTICES, TRIANGLES)
        assert all(bpy.data.meshes[name].users == 0 for name in pending.names.values())
        show(pending, item_of)
        assert not any({SPARE_KEY, PENDING_KEY} & set(item.data.keys()) for item in item_of.values())
    assert len(bpy.data.meshes) == 8 and len(mesh_pool.spare_meshes("test")) == 4


def test_pending_meshes_that_are_never_shown_become_spare():
    for _ in range(3):
        pending = PendingMeshes("test", "Tile")
        pending.fill("a", VERTICES, TRIANGLES)
    assert len(bpy.data.meshes) == 1


def test_pools_have_meshes_of_their_own():
    PendingMeshes("test", "Tile").fill("a", VERTICES, TRIANGLES)
    PendingMeshes("other", "Tile").fill("a", VERTICES, TRIANGLES)
    assert len(mesh_pool.spare_meshes("test")) == len(mesh_pool.spare_meshes("other")) == 1


def test_a_pool_shrinks_to_its_limit():
    pending = PendingMeshes("test", "Tile")
    for key in range(150):
        pending.fill(key, VERTICES, TRIANGLES)
    for _ in range(4):
        PendingMeshes("test", "Tile", max_spare=10)
    assert len(mesh_pool.spare_meshes("test")) == len(bpy.data.meshes) == 10


def test_a_spare_mesh_that_somebody_uses_or_removes_is_not_filled():
    first = PendingMeshes("test", "Tile")
    for key in "ab":
        first.fill(key, VERTICES, TRIANGLES)
    second = PendingMeshes("test", "Tile")
    used, removed = (bpy.data.meshes[name] for name in first.names.values())
    item = bpy.data.objects.new("Mine", used)
    bpy.data.meshes.remove(removed)
    for key in "ab":
        second.fill(key, VERTICES[:3], TRIANGLES[:1])
    assert len(item.data.polygons) == 2 and len(bpy.data.meshes) == 3


def use(mesh):
    bpy.data.objects.new("Mine", mesh)


def forget(mesh):
    """Bring back the mesh of an earlier undo step, which was spare or shown."""
    del mesh[PENDING_KEY]


def fill_again(mesh):
    PendingMeshes("test", "Tile").fill("c", VERTICES[:3], TRIANGLES[:1])


def remove(mesh):
    bpy.data.meshes.remove(mesh)


@pytest.mark.parametrize("change", [use, forget, fill_again, remove])
def test_pending_meshes_that_have_changed_are_not_shown(change):
    pending = PendingMeshes("test", "Tile")
    for key in "ab":
        pending.fill(key, VERTICES, TRIANGLES)
    pending.check()
    change(bpy.data.meshes[pending.names["b"]])
    with pytest.raises(GeometryError, match="Undo has removed meshes"):
        pending.check()


def test_a_new_mesh_with_the_name_of_a_removed_one_is_noticed():
    pending = PendingMeshes("test", "Tile")
    pending.fill("a", VERTICES, TRIANGLES)
    bpy.data.meshes.remove(bpy.data.meshes[pending.names["a"]])
    pending.fill("b", VERTICES, TRIANGLES)
    assert pending.names["a"] == pending.names["b"]
    with pytest.raises(GeometryError, match="Undo has removed meshes"):
        pending.check()


def test_no_mesh_is_filled_twice_if_spare_meshes_were_removed():
    first = PendingMeshes("test", "Tile")
    for key in "ab":
        first.fill(key, VERTICES, TRIANGLES)
    second = PendingMeshes("test", "Tile")
    for name in first.names.values():
        bpy.data.meshes.remove(bpy.data.meshes[name])
    for key in "abc":
        second.fill(key, VERTICES, TRIANGLES)
    second.check()
    assert len(set(second.names.values())) == 3
