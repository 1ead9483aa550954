"""Small terrains in a Blender scene, created with the operators."""

import bpy
import numpy as np

from farfield.addon.bridge.clipbox import objects as terrain_objects

SMALL = {"boxes": 3, "resolution": 32, "terrain": "cascades", "threshold": 1}


def camera_at(*position):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.collection.objects.link(camera)
    camera.location = position
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    return camera


def create(**settings):
    before = {terrain.name for terrain in terrain_objects.SceneTerrain.in_scene(bpy.context.scene)}
    assert bpy.ops.farfield.clipbox_create(**(SMALL | settings)) == {"FINISHED"}
    bpy.context.view_layer.update()
    [created] = [terrain for terrain in terrain_objects.SceneTerrain.in_scene(bpy.context.scene) if terrain.name not in before]
    return created


def geometry_bytes(terrain):
    """Return the bytes of the visible geometry of a terrain, by block."""
    by_block = {}
    for name, block in terrain.blocks().items():
        mesh = block.data
        vertices, corners = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.loops), np.int32)
        mesh.vertices.foreach_get("co", vertices)
        mesh.loops.foreach_get("vertex_index", corners)
        normals = np.empty(3 * len(mesh.loops), np.float32)
        mesh.corner_normals.foreach_get("vector", normals)
        by_block[name] = (vertices.tobytes(), corners.tobytes(), normals.tobytes())
    return by_block
