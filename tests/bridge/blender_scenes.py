"""Small Blender scenes with known answers, for the tests of the bridge."""

import bpy
import numpy as np

from farfield.addon.bridge.meshes import Source, take

LEVEL_SETS = ("cameras", "images", "materials", "meshes", "node_groups", "objects", "scenes")


def fresh() -> bpy.types.Scene:
    """An empty scene in factory settings."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def material(name: str, color: tuple[float, float, float] = (0.8, 0.8, 0.8), roughness: float = 0.5) -> bpy.types.Material:
    """A Principled material; its shader node is called Principled BSDF."""
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return made


def shader_of(made: bpy.types.Material) -> bpy.types.Node:
    """The Principled node of a material."""
    return made.node_tree.nodes["Principled BSDF"]


def link(made: bpy.types.Material, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket) -> None:
    """Link two sockets of a material."""
    made.node_tree.links.new(source, target)


def box(name: str = "Box", made: bpy.types.Material | None = None) -> bpy.types.Object:
    """A cube from -1 to 1."""
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    return _named(name, made)


def ball(name: str = "Ball", made: bpy.types.Material | None = None) -> bpy.types.Object:
    """A smooth sphere of radius 1."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24)
    bpy.context.object.data.shade_smooth()
    return _named(name, made)


def card(name: str = "Card", made: bpy.types.Material | None = None) -> bpy.types.Object:
    """A square from -1 to 1 in the XY plane."""
    bpy.ops.mesh.primitive_plane_add(size=2.0)
    return _named(name, made)


def taken(*objects: bpy.types.Object) -> Source:
    """The source of `objects`."""
    return take(list(objects), bpy.context.evaluated_depsgraph_get())


def counts() -> dict[str, int]:
    """How many data blocks of each kind there are, Blender's own render result not counted."""
    return {kind: sum(item.name != "Render Result" for item in getattr(bpy.data, kind)) for kind in LEVEL_SETS}


def disc_image(name: str = "Disc", size: int = 64) -> bpy.types.Image:
    """A packed image whose alpha is 1 within a disc of 0.8 of the half side, and 0 beyond."""
    image = bpy.data.images.new(name, size, size, alpha=True)
    rows, columns = np.mgrid[:size, :size]
    pixels = np.full((size, size, 4), 0.5, np.float32)
    pixels[..., 3] = np.hypot(rows - 0.5 * size + 0.5, columns - 0.5 * size + 0.5) < 0.4 * size
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def _named(name: str, made: bpy.types.Material | None) -> bpy.types.Object:
    new = bpy.context.object
    new.name = name
    if made is not None:
        new.data.materials.append(made)
    return new
