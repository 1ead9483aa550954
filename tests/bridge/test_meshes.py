"""What is taken out of Blender is what a viewer sees there, in world space."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.meshes import take, take_points
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.mesh import face_areas_and_normals


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.fresh()


def signed_volume(mesh) -> float:
    """Volume of a closed mesh, positive when it is wound outwards."""
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (2, -3, 0.5), (-1, -2, -1), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6)])
def test_scaled_and_mirrored_objects_keep_their_outside(scale):
    box = blender_scenes.box()
    box.scale, box.location, box.rotation_euler = scale, (3.0, -1.0, 2.0), (0.3, 0.4, 0.5)
    box.location = [value * abs(scale[0]) for value in box.location]
    bpy.context.view_layer.update()
    source = blender_scenes.taken(box)
    assert signed_volume(source.mesh) == pytest.approx(8.0 * abs(np.prod(scale)), rel=1e-3)
    assert source.origin == pytest.approx(np.array(box.location), rel=1e-6)


def test_parts_own_consecutive_triangles():
    first, second = blender_scenes.box("First"), blender_scenes.ball("Second")
    source = blender_scenes.taken(first, second)
    assert [part.name for part in source.parts] == ["First", "Second"]
    assert [part.first for part in source.parts] == [0, 12]
    assert len(source.mesh.triangles) == 12 + len(source.parts[1].surface.triangles)
    assert source.name == "First"


def test_modifiers_count():
    box = blender_scenes.box()
    box.modifiers.new("More", "SUBSURF").levels = 2
    assert len(blender_scenes.taken(box).mesh.triangles) == 6 * 4**2 * 2


def test_edit_mode_is_read_as_it_stands():
    box = blender_scenes.box()
    box.data.uv_layers.active.name = "Flat"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(5.0, 0.0, 0.0))
    source = blender_scenes.taken(box)
    assert box.mode == "EDIT"
    assert source.mesh.vertices.mean(axis=0) == pytest.approx([5.0, 0.0, 0.0], abs=1e-5)
    assert source.parts[0].surface.attributes["Flat"].values.shape == (24, 2)


def test_instances_belong_to_the_object_that_makes_them():
    leaf = blender_scenes.card("Leaf")
    collection = bpy.data.collections.new("Leaves")
    collection.objects.link(leaf)
    bpy.context.scene.collection.objects.unlink(leaf)
    tree = bpy.data.objects.new("Tree", None)
    tree.instance_type, tree.instance_collection, tree.location = "COLLECTION", collection, (0.0, 0.0, 4.0)
    bpy.context.scene.collection.objects.link(tree)
    source = blender_scenes.taken(tree)
    assert [part.name for part in source.parts] == ["Tree"]
    assert source.mesh.vertices[:, 2] == pytest.approx([4.0] * 4)


def test_what_has_no_faces_is_named_and_skipped():
    box = blender_scenes.box()
    hidden = blender_scenes.box("Hidden")
    hidden.hide_set(True)
    bpy.ops.object.camera_add()
    source = blender_scenes.taken(box, hidden, bpy.context.object)
    assert source.skipped == ["Hidden (hidden)", "Camera (a camera has no faces)"]


def test_nothing_with_faces_is_an_error_that_says_why():
    empty = bpy.data.objects.new("Void", bpy.data.meshes.new("Void"))
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(GeometryError, match="Void"):
        take([empty], bpy.context.evaluated_depsgraph_get())


def test_multi_user_data_is_read_once_for_both():
    first = blender_scenes.box("First")
    second = bpy.data.objects.new("Second", first.data)
    second.location = (5.0, 0.0, 0.0)
    bpy.context.scene.collection.objects.link(second)
    source = blender_scenes.taken(first, second)
    assert source.mesh.corners[12:].mean(axis=(0, 1)) == pytest.approx([5.0, 0.0, 0.0])


def test_points_become_discs_that_face_outwards():
    points = np.random.default_rng(0).normal(size=(600, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(points.tolist(), [], [])
    cloud_object = bpy.data.objects.new("Points", mesh)
    cloud_object.location = (2.0, 0.0, 0.0)
    bpy.context.scene.collection.objects.link(cloud_object)
    bpy.context.view_layer.update()
    source = take_points(cloud_object)
    assert source.geometry is source.points
    assert np.einsum("ij,ij->i", source.points.normals, points).min() > 0.5
    surface = source.parts[0].surface
    areas, normals = face_areas_and_normals(surface.vertices[surface.triangles].astype(float))
    per_point = areas.reshape(600, source.triangles_per_primitive).sum(axis=1)
    assert per_point == pytest.approx(np.pi * source.points.radii**2, rel=1e-3)
    assert np.einsum("ij,ij->i", normals[:: source.triangles_per_primitive], source.points.normals).min() > 0.99


def test_a_mesh_with_faces_is_no_point_cloud():
    with pytest.raises(GeometryError, match="has faces"):
        take_points(blender_scenes.box())
