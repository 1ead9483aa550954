"""Textured objects in a scene."""

import bpy
import numpy as np

from farfield.addon.compat import enable_nodes


def textured_ball(segments: int = 32) -> bpy.types.Object:
    """Create a smooth sphere "Ball" with a UV map and a checkered image. It is selected and active."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2)
    item = bpy.context.object
    item.name = "Ball"
    item.data.shade_smooth()
    material = bpy.data.materials.new("Checker")
    image = bpy.data.images.new("Checker", 64, 64)
    rows, columns = np.mgrid[0:64, 0:64]
    colors = np.ones((64, 64, 4), np.float32)
    colors[..., :3] = (((rows // 8 + columns // 8) % 2) * 0.6 + 0.2)[..., None]
    image.pixels.foreach_set(colors.ravel())
    enable_nodes(material)
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    item.data.materials.append(material)
    return item
