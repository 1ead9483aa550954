"""Textured objects in a scene, for tests of the script and of what is read."""

import bmesh
import bpy
import numpy as np

from farfield.addon.compat import enable_nodes


def checker_image(name: str = "Checker", size: int = 32, **properties) -> bpy.types.Image:
    """A packed image of gray and orange squares."""
    image = bpy.data.images.new(name, size, size, **properties)
    rows, columns = np.mgrid[:size, :size]
    is_dark = ((rows // 4 + columns // 4) % 2).astype(bool)
    colors = np.ones((size, size, 4), np.float32)
    colors[..., :3] = np.where(is_dark[..., None], [0.2, 0.2, 0.2], [0.8, 0.5, 0.2])
    image.pixels.foreach_set(colors.ravel())
    image.pack()
    return image


def textured_material(image: bpy.types.Image | None, name: str = "Paint") -> bpy.types.Material:
    """A material whose base color is an image."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    if image is not None:
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    return material


def textured_ball(rings: int = 12, name: str = "Bällchen") -> bpy.types.Object:
    """A smooth sphere with UVs and an image; the active object."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=2 * rings, ring_count=rings)
    item = bpy.context.object
    item.name = name
    sort_faces(item.data)
    item.data.shade_smooth()
    item.data.materials.append(textured_material(checker_image()))
    return item


def count_triangles(mesh: bpy.types.Mesh) -> int:
    """The triangles of a mesh."""
    mesh.calc_loop_triangles()
    return len(mesh.loop_triangles)


def sort_faces(mesh: bpy.types.Mesh) -> None:
    """Sort the faces of `mesh` by vertices: Blender adds the same sphere with another order of faces each time."""
    work = bmesh.new()
    work.from_mesh(mesh)
    work.faces.sort(key=lambda face: face.verts[0].index * len(work.verts) + face.verts[1].index)
    work.to_mesh(mesh)
    work.free()
