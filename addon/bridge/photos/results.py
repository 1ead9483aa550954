"""Textures from photographs as images and materials."""

from collections.abc import Iterable

import bpy
import numpy as np

from ...compat import enable_nodes
from ..imaging.images import create_image

IMAGE_NODE_OFFSET = (-330, 0)  # from the shader
OVERLAY_PROPERTY = "farfield_photo_overlay"  # custom property of images that `create_overlay_image` made
TEXTURE_PROPERTY = "farfield_photo_texture"  # custom property of materials that `assign_texture` made


def create_texture_image(name: str, colors: np.ndarray, transparent: np.ndarray | None = None) -> bpy.types.Image:
    """Create an 8-bit image of sRGB-encoded `colors` (H, W, 3).

    transparent: (H, W) bool, texels with zero alpha.
    """
    return create_image(name, texture_pixels(colors, transparent), is_data=False)


def texture_pixels(colors: np.ndarray, transparent: np.ndarray | None = None) -> np.ndarray:
    """Return pixels (H, W, 4) float32 of `colors` (H, W, 3) with zero alpha where they are `transparent` (H, W) bool."""
    pixels = np.ones((*colors.shape[:2], 4), np.float32)
    pixels[..., :3] = colors
    if transparent is not None:
        pixels[transparent, 3] = 0.0
    return pixels


def map_pixels(values: np.ndarray) -> np.ndarray:
    """Return opaque gray pixels (H, W, 4) float32 of `values` (H, W)."""
    pixels = np.ones((*values.shape, 4), np.float32)
    pixels[..., :3] = values[..., None]
    return pixels


def create_overlay_image(name: str, colors: np.ndarray) -> bpy.types.Image:
    """Create an 8-bit image of sRGB-encoded `colors` (H, W, 3) that files keep, in place of an earlier overlay with this name."""
    former = bpy.data.images.get(name)
    image = create_texture_image(name, colors)
    image[OVERLAY_PROPERTY] = True
    if former is not None and OVERLAY_PROPERTY in former and former.library is None:
        former.user_remap(image)
        bpy.data.images.remove(former)
        image.name = name
    image.use_fake_user = True
    return image


def assign_texture(objects: list[bpy.types.Object], image: bpy.types.Image, name: str, *, has_alpha: bool = False) -> bpy.types.Material:
    """Give `objects` one new material that shows `image`, in place of all their materials.

    Replaced materials that nothing else uses get a fake user, so that files keep them; those that this function made do not.
    """
    material = create_material(name, image, has_alpha)
    replaced = dict.fromkeys(slot.material for item in objects for slot in item.material_slots if slot.material is not None)
    for slot in [slot for item in objects for slot in item.material_slots if slot.link == "OBJECT"]:
        slot.material = None  # or the material would count this object as a user for ever
    for mesh in dict.fromkeys(item.data for item in objects):
        mesh.materials.clear()
        mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", np.zeros(len(mesh.polygons), np.int32))
    for item in objects:
        for slot in item.material_slots:
            slot.link = "DATA"
    keep_unused(replaced)
    return material


def keep_unused(materials: Iterable[bpy.types.Material]) -> None:
    """Give those of `materials` that nothing uses a fake user, so that files keep them, unless this tool made them."""
    for old in materials:
        if old.users == 0 and old.is_editable and TEXTURE_PROPERTY not in old:
            old.use_fake_user = True


def create_material(name: str, image: bpy.types.Image, has_alpha: bool) -> bpy.types.Material:
    """Create a matte material that shows `image`, with its transparency if it `has_alpha`."""
    material = bpy.data.materials.new(name)
    material[TEXTURE_PROPERTY] = True
    enable_nodes(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    texture.location = [origin + offset for origin, offset in zip(shader.location, IMAGE_NODE_OFFSET, strict=True)]
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    if has_alpha:
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    return material
