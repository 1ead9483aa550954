"""Textures from photographs as images and materials."""

import bpy
import numpy as np

from ...compat import enable_nodes
from ..images import create_image

IMAGE_NODE_POSITION = (-320, 300)


def create_texture_image(name: str, colors: np.ndarray) -> bpy.types.Image:
    """Create an 8-bit image of sRGB-encoded `colors` (H, W, 3)."""
    pixels = np.ones((*colors.shape[:2], 4), np.float32)
    pixels[..., :3] = colors
    return create_image(name, pixels, is_data=False)


def assign_texture(objects: list[bpy.types.Object], image: bpy.types.Image, name: str) -> bpy.types.Material:
    """Give `objects` one new material that shows `image`, in place of all their materials."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.location = image, IMAGE_NODE_POSITION
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    for item in objects:
        item.data.materials.clear()
        item.data.materials.append(material)
    return material
