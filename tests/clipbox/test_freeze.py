"""Frozen terrain: watertight, plain, where the terrain stood."""

import bpy
import numpy as np
import pytest

from closed import open_edges, uses_of_directed_edges
from farfield.addon.bridge import terrain_objects
from standing_terrain import camera_at, create

KINDS = ({}, {"terrain": "spheres"}, {"surface": "blocky"}, {"subdivided": 1}, {"surface": "blocky", "smoothing": 2})
pytestmark = pytest.mark.usefixtures("empty_scene")


def freeze(standing, **given):
    bpy.context.view_layer.objects.active = standing.root
    assert bpy.ops.farfield.clipbox_freeze(**given) == {"FINISHED"}
    bpy.context.view_layer.update()
    return {item.name.split(".")[0]: item for item in bpy.data.collections["Frozen Terrain"].objects}


def shape_of(item):
    vertices, corners = np.empty(3 * len(item.data.vertices), np.float32), np.empty(len(item.data.loops), np.int32)
    item.data.vertices.foreach_get("co", vertices)
    item.data.loops.foreach_get("vertex_index", corners)
    return vertices.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3)


def volume_of(vertices, triangles):
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0


@pytest.mark.parametrize(
    "kind", [{}, {"terrain": "spheres"}, {"surface": "blocky"}, {"subdivided": 1}, {"surface": "blocky", "smoothing": 2}], ids=str
)
def test_the_ground_is_watertight_and_solid(kind):
    camera_at(0.0, 0.0, 12.0)
    ground = freeze(create(**kind))["Ground"]
    vertices, triangles = shape_of(ground)
    assert len(open_edges(triangles)) == 0 and (uses_of_directed_edges(triangles) == 1).all()
    assert volume_of(vertices, triangles) > 1e4 and np.abs(vertices).max() <= 64.0 + 12.0
    assert not ground.data.validate() and ground.modifiers.keys() == [] and not terrain_objects.standing_terrains(bpy.context.scene)


def test_a_plain_has_the_volume_of_the_ground_below_it():
    camera_at(0.0, 0.0, 0.0)
    vertices, triangles = shape_of(freeze(create(terrain="formula", formula="5.5 - z"))["Ground"])
    assert volume_of(vertices, triangles) == pytest.approx(128.0 * 128.0 * (64.0 + 5.5), rel=0.01)


def test_uvs_show_textures_of_one_size_everywhere():
    camera_at(0.0, 0.0, 12.0)
    ground = freeze(create())["Ground"]
    vertices, triangles = shape_of(ground)
    uvs = np.empty(2 * triangles.size, np.float32)
    ground.data.uv_layers["UVMap"].uv.foreach_get("vector", uvs)
    uvs = uvs.reshape(-1, 3, 2)
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    flat = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * 16.0**2
    corners = vertices[triangles]
    true = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    sizable = true > 0.01
    assert (flat[sizable] <= 1.001 * true[sizable]).all() and (flat[sizable] >= 0.57 * true[sizable]).all()


def test_each_box_may_have_a_mesh_of_its_own():
    camera_at(0.0, 0.0, 12.0)
    standing = create()
    made = freeze(standing, per_box=True, collider=False, closed=False, keep_terrain=True)
    assert sorted(made) == ["Box 1", "Box 2", "Box 3"] and standing.root is not None
    whole = sum(len(block.data.polygons) for block in standing.blocks().values())
    assert sum(len(item.data.polygons) for item in made.values()) == whole


def test_the_collider_has_few_triangles_near_the_ground():
    camera_at(0.0, 0.0, 12.0)
    made = freeze(create(), collider_share=10.0)
    (ground, triangles), (collider, few) = shape_of(made["Ground"]), shape_of(made["Collider"])
    assert 0.05 < len(few) / len(triangles) < 0.15 and made["Collider"].hide_render
    assert volume_of(collider, few) == pytest.approx(volume_of(ground, triangles), rel=0.02)


def test_it_stands_where_the_terrain_stood_and_needs_no_root():
    camera_at(0.0, 0.0, 12.0)
    standing = create()
    standing.root.location = (5.0, 6.0, 7.0)
    bpy.context.view_layer.update()
    ground = freeze(standing)["Ground"]
    assert tuple(ground.matrix_world.translation) == (5.0, 6.0, 7.0) and ground.parent is None
    nodes = ground.data.materials[0].node_tree.nodes
    assert all(node.object is None for node in nodes if node.type == "TEX_COORD")
    assert not any(key.startswith("farfield") for key in set(ground.keys()))


def test_without_a_terrain_the_button_is_grey():
    assert not bpy.ops.farfield.clipbox_freeze.poll()
