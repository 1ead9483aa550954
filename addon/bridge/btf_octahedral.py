"""An octahedral impostor as an ordinary object: a round quad that is turned to the viewer, in a shell that light rays meet.

The quad stands in the middle of the object, so that the geometric normal points to the viewer, which suits the normals in the frames
best; on a box or a ball shading would change where its faces do. A quad cannot shade itself, though, which an impostor in a game does
by writing depth and casting into a shadow map. Here the shell does that in Cycles, for sun and sky alike, and it casts the shadow that
the lamp's own view has. EEVEE draws the same but for the shading of the impostor by itself: its shadows start at the quad.
"""

from collections.abc import Sequence

import bmesh
import bpy
import mathutils
import numpy as np

from ..core.btf.octahedral import Atlas
from .btf_octahedral_materials import FACING, SHELL, FrameImages, look_group, quad_material, shell_material
from .images import data_image

CORNERS = 32  # of the quad, which is round so that it stays inside the shell
ROOM = 1.02  # radius of the quad in half sides of a frame
SHELL_SUBDIVISIONS = 3
BIAS = 1.0  # pixels of a frame: how far surfaces have to lie before a place to shade it
IMAGE_NAMES = {"colour": "Colour", "normal_height": "Normal and Height", "surface": "Surface"}


def impostor(name: str, atlas: Atlas, bias: float = BIAS) -> bpy.types.Object:
    """A new object, linked nowhere yet, that shows `atlas` with packed images, in its place in the world; `face` turns its quad.

    bias: in pixels of a frame, how far surfaces have to lie before a place to shade it.
    """
    images = atlas_images(name, atlas)
    frames = FrameImages.of(atlas, images)
    look = look_group(name, frames)
    mesh = bpy.data.meshes.new(name)
    _fill(mesh, atlas.half_side)
    mesh.materials.append(quad_material(f"{name} Quad", look, atlas.half_side))
    mesh.materials.append(shell_material(f"{name} Shell", look, atlas.half_side, 2.0 * bias / atlas.pixels))
    made = bpy.data.objects.new(name, mesh)
    made.location = atlas.center.tolist()
    made["farfield_octahedral_half_side"] = atlas.half_side
    made["farfield_octahedral_bytes"] = sum(4 * image.size[0] * image.size[1] for image in images.values())
    face(made, (0.0, -1.0, 0.0))
    return made


def atlas_images(name: str, atlas: Atlas) -> dict[str, bpy.types.Image]:
    """The maps of `atlas` as new packed images of 8 bits a channel, by their keys in `Atlas.encoded`."""
    return {key: data_image(f"{name} {IMAGE_NAMES[key]}", pixels, is_data=key != "colour") for key, pixels in atlas.encoded().items()}


def face(impostor_object: bpy.types.Object, direction: Sequence[float]) -> None:
    """Turn the quad of an impostor towards `direction` (3,), world space, where the viewer is; the object itself does not turn."""
    mesh = impostor_object.data
    facing = (impostor_object.matrix_basis.to_3x3().inverted() @ mathutils.Vector(direction)).normalized()
    right, up = facing.to_track_quat("Z", "Y").to_matrix().to_3x3().col[:2]
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    positions = positions.reshape(-1, 3)
    rim = ROOM * impostor_object["farfield_octahedral_half_side"]
    turns = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    positions[:CORNERS] = rim * (np.cos(turns)[:, None] * np.array(right) + np.sin(turns)[:, None] * np.array(up))
    mesh.vertices.foreach_set("co", positions.ravel())
    mesh.attributes[FACING].data.foreach_set("vector", np.tile(np.float32(facing), len(mesh.vertices)))
    mesh.update()


def remove(impostor_object: bpy.types.Object) -> None:
    """Remove an impostor with all that was made for it."""
    mesh = impostor_object.data
    materials = list(mesh.materials)
    look = next(node.node_tree for node in materials[0].node_tree.nodes if node.type == "GROUP")
    frame = next(node.node_tree for node in look.nodes if node.type == "GROUP")
    images = {node.image for node in frame.nodes if node.type == "TEX_IMAGE"}
    bpy.data.batch_remove([impostor_object, mesh, *materials, look, frame, *images])


def _fill(mesh: bpy.types.Mesh, half_side: float) -> None:
    """The quad, a fan whose rim is the first CORNERS vertices, to be turned, and the shell, whose triangles face outwards."""
    shapes = bmesh.new()
    rim = [shapes.verts.new((half_side, 0.0, 0.0)) for _ in range(CORNERS)]
    middle = shapes.verts.new((0.0, 0.0, 0.0))
    for first, second in zip(rim, rim[1:] + rim[:1], strict=True):
        shapes.faces.new((middle, first, second))
    shell = bmesh.ops.create_icosphere(shapes, subdivisions=SHELL_SUBDIVISIONS, radius=SHELL * half_side)
    for polygon in {polygon for vertex in shell["verts"] for polygon in vertex.link_faces}:
        polygon.material_index = 1
    shapes.to_mesh(mesh)
    shapes.free()
    mesh.attributes.new(FACING, "FLOAT_VECTOR", "POINT")
