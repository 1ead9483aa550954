"""Sources read from Blender equal the visible surfaces, in world space."""

import warnings

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from bridge.instance_scenes import scatter
from farfield.addon.bridge.geometry.joined_meshes import read_joined_mesh
from farfield.addon.bridge.geometry.meshes import concatenate_in_world_space, read_instances, read_point_cloud, read_source
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import face_areas_and_normals, fingerprint
from lib.studio import open_studio


@pytest.fixture(autouse=True)
def empty_scene_for_each_test():
    blender_scenes.reset_scene()


def signed_volume(mesh) -> float:
    """Volume of a closed mesh, positive when it is wound outwards."""
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (2, -3, 0.5), (-1, -2, -1), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6)])
def test_scaled_and_mirrored_objects_keep_their_orientation(scale):
    box = blender_scenes.box()
    box.scale, box.location, box.rotation_euler = scale, (3.0, -1.0, 2.0), (0.3, 0.4, 0.5)
    box.location = [value * abs(scale[0]) for value in box.location]
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(box)
    assert signed_volume(source.mesh) == pytest.approx(8.0 * abs(np.prod(scale)), rel=1e-3)
    assert source.origin == pytest.approx(np.array(box.location), rel=1e-6)


@pytest.mark.parametrize("coordinate", [3e38, np.inf, np.nan])
def test_coordinates_that_no_tool_can_use_are_read_without_warnings(coordinate):
    box = blender_scenes.box()
    box.data.use_auto_texspace = False
    box.data.texspace_location = (-3e38,) * 3
    box.data.vertices[0].co.x = coordinate
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (instance,) = read_instances([box], bpy.context.evaluated_depsgraph_get())
        assert fingerprint(instance.mesh.vertices, instance.mesh.triangles)
    assert len(instance.mesh.vertices) == 8


def test_instances_have_consecutive_triangles():
    first, second = blender_scenes.box("First"), blender_scenes.ball("Second")
    source = blender_scenes.read_objects(first, second)
    assert [instance.name for instance in source.instances] == ["First", "Second"]
    assert [instance.first_primitive for instance in source.instances] == [0, 12]
    assert len(source.mesh.triangles) == 12 + len(source.instances[1].mesh.triangles)
    assert source.name == "First"


def test_modifiers_are_applied():
    box = blender_scenes.box()
    box.modifiers.new("More", "SUBSURF").levels = 2
    assert len(blender_scenes.read_objects(box).mesh.triangles) == 6 * 4**2 * 2


def test_unsaved_edit_mode_changes_are_read():
    box = blender_scenes.box()
    box.data.uv_layers.active.name = "Flat"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(5.0, 0.0, 0.0))
    source = blender_scenes.read_objects(box)
    assert box.mode == "EDIT"
    assert source.mesh.vertices.mean(axis=0) == pytest.approx([5.0, 0.0, 0.0], abs=1e-5)
    assert source.instances[0].mesh.attributes["Flat"].values.shape == (24, 2)


def test_instances_belong_to_the_object_that_makes_them():
    leaf = blender_scenes.card("Leaf")
    collection = bpy.data.collections.new("Leaves")
    collection.objects.link(leaf)
    bpy.context.scene.collection.objects.unlink(leaf)
    tree = bpy.data.objects.new("Tree", None)
    tree.instance_type, tree.instance_collection, tree.location = "COLLECTION", collection, (0.0, 0.0, 4.0)
    bpy.context.scene.collection.objects.link(tree)
    source = blender_scenes.read_objects(tree)
    assert [instance.name for instance in source.instances] == ["Tree"]
    assert source.mesh.vertices[:, 2] == pytest.approx([4.0] * 4)


@pytest.mark.parametrize("kind", ["text", "curve", "metaball"])
def test_converted_surfaces_are_read_once(kind):
    """Blender shows them as an instance of a mesh, in addition to the object; also within an instance of a collection, and in Edit Mode."""
    if kind == "text":
        bpy.ops.object.text_add()
    elif kind == "curve":
        bpy.ops.curve.primitive_bezier_circle_add()
        bpy.context.object.data.dimensions, bpy.context.object.data.fill_mode = "2D", "BOTH"
    else:
        bpy.ops.object.metaball_add()
    item = bpy.context.object
    item.location, item.scale = (1.0, 2.0, 3.0), (2.0, 1.0, 0.5)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = item.evaluated_get(depsgraph).to_mesh()
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    item.evaluated_get(depsgraph).to_mesh_clear()
    (instance,) = blender_scenes.read_objects(item).instances
    assert (instance.name, instance.part, len(instance.mesh.triangles)) == (item.name, "", count)
    assert read_joined_mesh(item, depsgraph)[0].vertices == pytest.approx(instance.mesh.vertices)
    bpy.ops.object.mode_set(mode="EDIT")
    assert len(blender_scenes.read_objects(item).mesh.triangles) == count
    bpy.ops.object.mode_set(mode="OBJECT")
    if kind == "metaball":  # Blender melts metaballs of a collection together with those outside.
        return
    collection = bpy.data.collections.new("Collection")
    collection.objects.link(item)
    owner = bpy.data.objects.new("Owner", None)
    owner.instance_type, owner.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(owner)
    bpy.context.view_layer.update()
    assert [(part.name, part.part) for part in blender_scenes.read_objects(owner).instances] == [("Owner", item.name)]


def test_object_materials_of_a_text_are_read():
    bpy.ops.object.text_add()
    text = bpy.context.object
    text.data.materials.append(blender_scenes.create_material("Of Data"))
    text.material_slots[0].link = "OBJECT"
    text.material_slots[0].material = blender_scenes.create_material("Of Object")
    (instance,) = blender_scenes.read_objects(text).instances
    assert instance.mesh.materials == (("Of Object", None),)


def test_random_numbers_are_those_that_cycles_shows():
    material = blender_scenes.create_material("Random")
    nodes = material.node_tree.nodes
    info, emission = nodes.new("ShaderNodeObjectInfo"), nodes.new("ShaderNodeEmission")
    blender_scenes.link(material, info.outputs["Random"], emission.inputs["Color"])
    blender_scenes.link(material, emission.outputs[0], nodes["Material Output"].inputs["Surface"])
    cards = [blender_scenes.card(name, material) for name in ("Card", "Card.001", "Häuser 家")]
    for index, card in enumerate(cards):
        card.location.x = 4.0 * index
    row = scatter("Row", cards[0])
    row.location.y = 4.0
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(*cards, row)
    assert len(source.instances) == 7 and all(0.0 <= item.random <= 1.0 for item in source.instances)
    with open_studio([*cards, row], 1) as studio:
        for item in source.instances:
            image = studio.render([*cards, row], np.array([0.0, 0.0, 1.0]) + [0.0, -1e-4, 0.0], item.matrix[:3, 3], 0.1, 9)
            assert image[4, 4, 0] == pytest.approx(item.random, abs=1e-4)


def test_objects_without_faces_are_skipped_with_the_reason():
    box = blender_scenes.box()
    hidden = blender_scenes.box("Hidden")
    hidden.hide_set(True)
    bpy.ops.object.camera_add()
    source = blender_scenes.read_objects(box, hidden, bpy.context.object)
    assert source.skipped == ["Hidden (hidden)", "Camera (a camera has no faces)"]


def test_no_faces_at_all_is_an_error_with_the_reason():
    empty = bpy.data.objects.new("Void", bpy.data.meshes.new("Void"))
    bpy.context.scene.collection.objects.link(empty)
    with pytest.raises(GeometryError, match="Void"):
        read_source([empty], bpy.context.evaluated_depsgraph_get())


def test_multi_user_data_is_read_once_for_both():
    first = blender_scenes.box("First")
    second = bpy.data.objects.new("Second", first.data)
    second.location = (5.0, 0.0, 0.0)
    bpy.context.scene.collection.objects.link(second)
    source = blender_scenes.read_objects(first, second)
    assert source.mesh.corners[12:].mean(axis=(0, 1)) == pytest.approx([5.0, 0.0, 0.0])


def test_points_become_discs_facing_outwards():
    points = np.random.default_rng(0).normal(size=(600, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(points.tolist(), [], [])
    cloud_object = bpy.data.objects.new("Points", mesh)
    cloud_object.location = (2.0, 0.0, 0.0)
    bpy.context.scene.collection.objects.link(cloud_object)
    bpy.context.view_layer.update()
    source = read_point_cloud(cloud_object)
    assert source.geometry is source.points
    assert np.einsum("ij,ij->i", source.points.normals, points).min() > 0.5
    disc_mesh = source.instances[0].mesh
    areas, normals = face_areas_and_normals(disc_mesh.vertices[disc_mesh.triangles].astype(float))
    per_point = areas.reshape(600, source.triangles_per_primitive).sum(axis=1)
    assert per_point == pytest.approx(np.pi * source.points.radii**2, rel=1e-3)
    assert np.einsum("ij,ij->i", normals[:: source.triangles_per_primitive], source.points.normals).min() > 0.99


def test_a_mesh_with_faces_is_not_a_point_cloud():
    with pytest.raises(GeometryError, match="has faces"):
        read_point_cloud(blender_scenes.box())


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("factor", "radius", "expected"), [(3e38, 0.1, "coordinates above"), (1.0, 3e38, "4 points with a radius above")])
def test_points_that_single_precision_cannot_hold_are_an_error(factor, radius, expected):
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata([(factor * x, factor * y, 0.0) for x in (0.0, 1.0) for y in (0.0, 1.0)], [], [])
    mesh.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", [radius] * 4)
    item = bpy.data.objects.new("Points", mesh)
    bpy.context.scene.collection.objects.link(item)
    with pytest.raises(GeometryError, match=f'"Points" has .*{expected}'):
        read_point_cloud(item)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_attributes_of_points_that_mean_something_else_are_ignored():
    """Files come from anyone: a radius per corner, a default color that is a vector or missing, and radii that are infinite."""
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata([(x, y, x * y) for x in range(4) for y in range(4)], [], [])
    mesh.attributes.new("radius", "FLOAT", "CORNER")
    item = bpy.data.objects.new("Points", mesh)
    bpy.context.scene.collection.objects.link(item)
    for name in ("vector", "missing"):
        mesh.attributes.new("vector", "FLOAT_VECTOR", "POINT")
        mesh.attributes.default_color_name = name
        cloud = read_point_cloud(item).points
        assert cloud.colors is None and (cloud.radii > 0.0).all()
    mesh.attributes.remove(mesh.attributes["radius"])
    mesh.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", [np.inf] + [0.1] * 15)
    assert np.isinf(read_point_cloud(item).points.radii[0])


@pytest.mark.parametrize("scale", [(1.0, 1.0, 0.0), (0.0, 1.0, 1.0), (1.0, 0.0, 0.0)])
def test_normals_and_radii_of_flattened_points_are_estimated(scale):
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata([(x, y, x * y) for x in range(8) for y in range(8)], [], [])
    mesh.attributes.new("normal", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", [0.0, 0.0, 1.0] * 64)
    mesh.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", [0.1] * 64)
    item = bpy.data.objects.new("Points", mesh)
    item.scale = scale
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    cloud = read_point_cloud(item).points
    assert np.linalg.norm(cloud.normals, axis=1) == pytest.approx(np.ones(64)) and (cloud.radii > 0.0).all()


def test_objects_in_excluded_collections_are_skipped_with_the_reason():
    box, absent = blender_scenes.box("Box"), blender_scenes.box("Absent")
    collection = bpy.data.collections.new("Off")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(absent)
    bpy.context.collection.objects.unlink(absent)
    bpy.context.view_layer.layer_collection.children["Off"].exclude = True
    assert blender_scenes.read_objects(box, absent).skipped == ["Absent (not in the view layer)"]


def test_a_material_that_was_renamed_is_an_error():
    source = blender_scenes.read_objects(blender_scenes.box("Box", blender_scenes.create_material("Clay")))
    assert [material.name for material in source.materials] == ["Clay"]
    source.materials[0].name = "Loam"
    with pytest.raises(GeometryError, match='"Clay" was renamed or removed'):
        _ = source.materials


def test_nothing_is_no_surface():
    with pytest.raises(GeometryError, match="No object with faces can be seen"):
        concatenate_in_world_space([])
