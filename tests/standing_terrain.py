"""Small terrains in Blender's scene, made as a user makes them."""

import bpy
import numpy as np

from farfield.addon.bridge import terrain_objects

SMALL = {"boxes": 3, "resolution": 32, "terrain": "cascades", "threshold": 1}


def camera_at(*place):
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.collection.objects.link(camera)
    camera.location = place
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    return camera


def create(**given):
    before = {standing.name for standing in terrain_objects.standing_terrains(bpy.context.scene)}
    assert bpy.ops.farfield.clipbox_create(**(SMALL | given)) == {"FINISHED"}
    bpy.context.view_layer.update()
    [made] = [standing for standing in terrain_objects.standing_terrains(bpy.context.scene) if standing.name not in before]
    return made


def shape_of(standing):
    """All that is shown of a terrain, by block."""
    found = {}
    for name, block in standing.blocks().items():
        mesh = block.data
        vertices, corners = np.empty(3 * len(mesh.vertices), np.float32), np.empty(len(mesh.loops), np.int32)
        mesh.vertices.foreach_get("co", vertices)
        mesh.loops.foreach_get("vertex_index", corners)
        normals = np.empty(3 * len(mesh.loops), np.float32)
        mesh.corner_normals.foreach_get("vector", normals)
        found[name] = (vertices.tobytes(), corners.tobytes(), normals.tobytes())
    return found
