"""The mesh of an object joined with its instances is the surface that the object shows."""

import math

import bpy
import mathutils
import numpy as np
import pytest

from bridge import blender_scenes
from farfield.addon.bridge.geometry.joined_meshes import find_frame, read_joined_mesh
from farfield.addon.bridge.geometry.meshes import concatenate_in_world_space, read_instances
from farfield.addon.bridge.texmesh.sources import read_textured_source
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import face_areas_and_normals
from farfield.addon.core.geometry.transforms import transform_points

pytestmark = pytest.mark.usefixtures("empty_scene")


def scatter(item: bpy.types.Object, leaf: bpy.types.Object, keeps_own: bool) -> None:
    """Let geometry nodes show `leaf` at each vertex of `item`, together with its own surface or instead of it."""
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for name, direction in (("Mesh", "INPUT"), ("Geometry", "OUTPUT")):
        tree.interface.new_socket(name, in_out=direction, socket_type="NodeSocketGeometry")
    start, info, instances, join, end = (
        tree.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "GeometryNodeObjectInfo",
            "GeometryNodeInstanceOnPoints",
            "GeometryNodeJoinGeometry",
            "NodeGroupOutput",
        )
    )
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = leaf, True
    instances.inputs["Scale"].default_value = (0.5, -0.25, 0.5)
    tree.links.new(start.outputs[0], instances.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], instances.inputs["Instance"])
    tree.links.new(instances.outputs[0], join.inputs[0])
    if keeps_own:
        tree.links.new(start.outputs[0], join.inputs[0])
    tree.links.new(join.outputs[0], end.inputs[0])
    item.modifiers.new("Scatter", "NODES").node_group = tree


def place(item: bpy.types.Object) -> bpy.types.Depsgraph:
    """Put an object somewhere, mirrored, and return the evaluated scene."""
    item.location, item.rotation_euler, item.scale = (3.0, -1.0, 2.0), (0.3, 0.4, 0.5), (2.0, -1.5, 1.0)
    bpy.context.view_layer.update()
    return bpy.context.evaluated_depsgraph_get()


def check_joined(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph, count: int) -> None:
    """Check that the joined mesh has the triangles that the object shows, with normals outside, and that levels start with all of them."""
    joined, found = read_joined_mesh(item, depsgraph)
    shown = concatenate_in_world_space(read_instances([item], depsgraph))
    world = transform_points(np.array(item.matrix_world), joined.vertices)
    is_mirrored = np.linalg.det(np.array(item.matrix_world)[:3, :3]) < 0.0
    corners = world[joined.triangles[:, ::-1] if is_mirrored else joined.triangles]
    assert found == count
    assert len(corners) == len(shown.triangles)
    areas, directions = face_areas_and_normals(corners)
    shown_areas, shown_directions = face_areas_and_normals(shown.corners)
    assert np.allclose(corners.mean(axis=1), shown.corners.mean(axis=1), atol=1e-5)
    assert np.allclose(areas, shown_areas, atol=1e-5)
    assert np.allclose(directions, shown_directions, atol=1e-3)
    _, own_directions = face_areas_and_normals(joined.vertices[joined.triangles].astype(np.float64))
    assert (np.einsum("tci,ti->tc", joined.normals[joined.loops], own_directions) > 0.9).all()
    assert len(read_textured_source(item, depsgraph).mesh.triangles) == len(shown.triangles)


@pytest.mark.parametrize("keeps_own", [False, True])
def test_instances_of_geometry_nodes(keeps_own):
    trunk = blender_scenes.box("Trunk", blender_scenes.create_material("Bark"))
    leaf = blender_scenes.box("Leaf", blender_scenes.create_material("Leaf"))
    leaf.data.uv_layers[0].name, leaf.hide_render = "Other UV map", True
    scatter(trunk, leaf, keeps_own)
    depsgraph = place(trunk)
    check_joined(trunk, depsgraph, 8 + keeps_own)
    joined, _ = read_joined_mesh(trunk, depsgraph)
    own = 12 * keeps_own
    names = [joined.materials[index][0] for index in joined.material_indices]
    assert names == ["Bark"] * own + ["Leaf"] * 96
    uvs = joined.at_corners(joined.uv_map, np.arange(len(joined.triangles)))
    layer = np.empty(2 * len(leaf.data.loops), np.float32)
    leaf.data.uv_layers[0].uv.foreach_get("vector", layer)
    assert np.allclose(
        np.sort(uvs[own : own + 12].reshape(-1, 2), axis=0)[[0, -1]], [layer.reshape(-1, 2).min(0), layer.reshape(-1, 2).max(0)]
    )


def test_instances_of_collections_within_collections():
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    inner.objects.link(blender_scenes.box("Box"))
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Box"])
    for number, collection in enumerate((inner, inner, outer)):
        item = bpy.data.objects.new(f"Instance {number}", None)
        item.instance_type, item.instance_collection, item.location = "COLLECTION", collection, (3.0 * number, 0.0, 0.0)
        (bpy.context.scene.collection if collection == outer else outer).objects.link(item)
    item.location.x = 0.0
    check_joined(item, place(item), 2)


def test_an_object_without_instances_is_read_as_it_is():
    box = blender_scenes.box()
    depsgraph = place(box)
    joined, count = read_joined_mesh(box, depsgraph)
    assert count == 1
    assert np.array_equal(joined.vertices, read_instances([box], depsgraph)[0].mesh.vertices)


def test_a_sheared_object_is_read_relative_to_its_position():
    box, parent = blender_scenes.box(), bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    box.parent, parent.scale, box.rotation_euler = parent, (3.0, 1.0, -1.0), (0.3, 0.8, 0.9)
    depsgraph = place(box)
    (shown,) = read_instances([box], depsgraph)
    joined, count = read_joined_mesh(box, depsgraph)
    assert count == 1
    assert np.allclose(joined.vertices, transform_points(shown.matrix, shown.mesh.vertices) - shown.matrix[:3, 3], atol=1e-5)
    assert np.array_equal(joined.triangles, shown.mesh.triangles[:, ::-1] if shown.is_mirrored else shown.mesh.triangles)
    assert np.allclose(find_frame(shown.matrix), np.array(mathutils.Matrix.Translation(box.matrix_world.translation)))


@pytest.mark.parametrize("scale", [0.0, math.inf, math.nan])
def test_a_scale_without_inverse_is_refused_by_name(scale):
    trunk = blender_scenes.box("Trunk")
    scatter(trunk, blender_scenes.box("Leaf"), True)
    trunk.scale = (scale, 1.0, 1.0)
    bpy.context.view_layer.update()
    with pytest.raises(GeometryError, match='"Trunk" has instances, and a scale of 0'):
        read_joined_mesh(trunk, bpy.context.evaluated_depsgraph_get())
