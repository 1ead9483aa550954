"""Small Blender scenes with known answers, for the tests of the bridge."""

import bpy
import numpy as np

from farfield.addon.bridge.geometry.meshes import Source, read_source
from farfield.addon.compat import enable_nodes
from textured_scenes import sort_faces

DATA_COLLECTIONS = ("cameras", "images", "materials", "meshes", "node_groups", "objects", "scenes")


def reset_scene() -> bpy.types.Scene:
    """Return an empty scene in factory settings."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


def create_material(name: str, color: tuple[float, float, float] = (0.8, 0.8, 0.8), roughness: float = 0.5) -> bpy.types.Material:
    """Return a Principled material; its shader node is called Principled BSDF."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return material


def shader_of(material: bpy.types.Material) -> bpy.types.Node:
    """Return the Principled node of a material."""
    return material.node_tree.nodes["Principled BSDF"]


def link(material: bpy.types.Material, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket) -> None:
    """Link two sockets of a material."""
    material.node_tree.links.new(source, target)


def box(name: str = "Box", material: bpy.types.Material | None = None) -> bpy.types.Object:
    """Add a cube from -1 to 1."""
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    return _finish(name, material)


def ball(name: str = "Ball", material: bpy.types.Material | None = None, segments: int = 24) -> bpy.types.Object:
    """Add a smooth sphere of radius 1."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2)
    sort_faces(bpy.context.object.data)
    bpy.context.object.data.shade_smooth()
    return _finish(name, material)


def damage_packed_image(image: bpy.types.Image) -> None:
    """Replace the packed file of an image by bytes that are no image."""
    image.pack(data=b"no image", data_len=8)
    image.reload()


def card(name: str = "Card", material: bpy.types.Material | None = None) -> bpy.types.Object:
    """Add a square from -1 to 1 in the XY plane."""
    bpy.ops.mesh.primitive_plane_add(size=2.0)
    return _finish(name, material)


def collect(*objects: bpy.types.Object, name: str = "Collection") -> bpy.types.Collection:
    """Move `objects` to a new collection, which is not part of the scene."""
    collection = bpy.data.collections.new(name)
    for item in objects:
        for other in item.users_collection:
            other.objects.unlink(item)
        collection.objects.link(item)
    return collection


def read_objects(*objects: bpy.types.Object) -> Source:
    """Return the source of `objects`."""
    return read_source(list(objects), bpy.context.evaluated_depsgraph_get())


def count_data() -> dict[str, int]:
    """Return the number of data-blocks per type, without Blender's own render result."""
    return {kind: sum(item.name != "Render Result" for item in getattr(bpy.data, kind)) for kind in DATA_COLLECTIONS}


def disc_image(name: str = "Disc", size: int = 64) -> bpy.types.Image:
    """Return a packed image with alpha 1 inside a disc of 0.8 times the half side, and 0 outside."""
    image = bpy.data.images.new(name, size, size, alpha=True)
    rows, columns = np.mgrid[:size, :size]
    pixels = np.full((size, size, 4), 0.5, np.float32)
    pixels[..., 3] = np.hypot(rows - 0.5 * size + 0.5, columns - 0.5 * size + 0.5) < 0.4 * size
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def _finish(name: str, material: bpy.types.Material | None) -> bpy.types.Object:
    new = bpy.context.object
    new.name = name
    if material is not None:
        new.data.materials.append(material)
    return new
