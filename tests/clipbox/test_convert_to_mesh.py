"""Converted terrain: watertight regular meshes at the position of the terrain."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge import scatter
from farfield.addon.bridge.clipbox import objects as terrain_objects
from farfield.addon.core.scatter import ScatterSettings
from scene_terrain import camera_at, create
from watertight import directed_edge_counts, open_edges

VARIANTS = (
    {},
    {"subdivided_boxes": 1},
    {"surface": "blocky", "smoothing": 2},
    *(pytest.param(variant, marks=pytest.mark.exhaustive) for variant in ({"terrain": "spheres"}, {"surface": "blocky"})),
)
pytestmark = pytest.mark.usefixtures("empty_scene")


def convert(terrain, **settings):
    bpy.context.view_layer.objects.active = terrain.root
    assert bpy.ops.farfield.clipbox_convert_to_mesh(**settings) == {"FINISHED"}
    bpy.context.view_layer.update()
    found = [collection for collection in bpy.data.collections if collection.name.startswith("Terrain Mesh")]
    return {item.name.split(".")[0]: item for collection in found for item in collection.objects}


def read_geometry(item):
    vertices, corners = np.empty(3 * len(item.data.vertices), np.float32), np.empty(len(item.data.loops), np.int32)
    item.data.vertices.foreach_get("co", vertices)
    item.data.loops.foreach_get("vertex_index", corners)
    return vertices.reshape(-1, 3).astype(np.float64), corners.reshape(-1, 3)


def enclosed_volume(vertices, triangles):
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_the_ground_is_watertight_and_encloses_a_volume(variant):
    camera_at(0.0, 0.0, 12.0)
    ground = convert(create(**variant), collider=False)["Ground"]
    vertices, triangles = read_geometry(ground)
    assert len(open_edges(triangles)) == 0 and (directed_edge_counts(triangles) == 1).all()
    assert enclosed_volume(vertices, triangles) > 1e4 and np.abs(vertices).max() <= 64.0 + 12.0
    assert not ground.data.validate() and ground.modifiers.keys() == [] and not terrain_objects.SceneTerrain.in_scene(bpy.context.scene)


def test_a_plane_encloses_the_volume_below_it():
    camera_at(0.0, 0.0, 0.0)
    vertices, triangles = read_geometry(convert(create(terrain="formula", formula="5.5 - z"))["Ground"])
    assert enclosed_volume(vertices, triangles) == pytest.approx(128.0 * 128.0 * (64.0 + 5.5), rel=0.01)


def test_uvs_have_uniform_scale():
    camera_at(0.0, 0.0, 12.0)
    ground = convert(create())["Ground"]
    vertices, triangles = read_geometry(ground)
    uvs = np.empty(2 * triangles.size, np.float32)
    ground.data.uv_layers["UVMap"].uv.foreach_get("vector", uvs)
    uvs = uvs.reshape(-1, 3, 2)
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    uv_areas = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * 16.0**2
    corners = vertices[triangles]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    is_large = areas > 0.01
    assert (uv_areas[is_large] <= 1.001 * areas[is_large]).all() and (uv_areas[is_large] >= 0.57 * areas[is_large]).all()


def test_conversion_can_create_one_mesh_per_box():
    camera_at(0.0, 0.0, 12.0)
    terrain = create()
    objects = convert(terrain, per_box=True, collider=False, closed=False, keep_terrain=True)
    assert sorted(objects) == ["Box 1", "Box 2", "Box 3"] and terrain.root is not None
    total = sum(len(block.data.polygons) for block in terrain.blocks().values())
    assert sum(len(item.data.polygons) for item in objects.values()) == total


def test_the_collider_approximates_the_ground_with_few_triangles():
    camera_at(0.0, 0.0, 12.0)
    objects = convert(create(), collider_fraction=10.0)
    ground, triangles = read_geometry(objects["Ground"])
    collider, collider_triangles = read_geometry(objects["Collider"])
    assert 0.05 < len(collider_triangles) / len(triangles) < 0.15 and objects["Collider"].hide_render
    assert enclosed_volume(collider, collider_triangles) == pytest.approx(enclosed_volume(ground, triangles), rel=0.02)


def test_meshes_have_the_position_of_the_terrain_and_need_no_root():
    camera_at(0.0, 0.0, 12.0)
    terrain = create()
    terrain.root.location = (5.0, 6.0, 7.0)
    bpy.context.view_layer.update()
    ground = convert(terrain)["Ground"]
    assert tuple(ground.matrix_world.translation) == (5.0, 6.0, 7.0) and ground.parent is None
    nodes = ground.data.materials[0].node_tree.nodes
    assert all(node.object is None for node in nodes if node.type == "TEX_COORD")
    assert not any(key.startswith("farfield") for key in set(ground.keys()))


def test_the_operator_is_disabled_without_a_terrain():
    assert not bpy.ops.farfield.clipbox_convert_to_mesh.poll()


def test_water_and_plants_stay_where_they_are():
    def plants():
        bpy.context.view_layer.update()
        owners = [item for item in bpy.data.objects if scatter.SCATTER_KEY in item and item.users_scene]
        instances = bpy.context.evaluated_depsgraph_get().object_instances
        return np.array([np.array(item.matrix_world) for item in instances if item.is_instance and item.parent.original in owners])[
            :, :3, 3
        ]

    camera_at(0.0, 0.0, 12.0)
    terrain = create(terrain="formula", formula="0.1*x - z", water=True, water_level=1.0)
    scatter.add_scatter(bpy.context.scene, terrain, ScatterSettings(kind="rocks", distance=0.3), 1.0)
    before = plants()
    objects = convert(terrain)
    after, water = plants(), objects["Terrain Mesh Water"]
    assert len(before) > 20 and before[:, 2].min() > 1.01, "nothing lies on the water"
    inner = before[np.abs(before[:, :2]).max(axis=1) < 56.0]  # Closed ground differs next to its border.
    distances = np.linalg.norm(inner[:, None] - after[None], axis=2).min(axis=1)
    assert (distances < 0.01).mean() > 0.98, "rounding of heights decides about places at limits"
    assert {(water.matrix_world @ vertex.co).z for vertex in water.data.vertices} == {1.0} and water.data.materials[0]
