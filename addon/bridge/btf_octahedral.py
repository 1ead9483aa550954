"""An octahedral impostor as ordinary objects: quads that are turned to the viewer, in a shell that rays of light meet.

All quads go through the middle of the original and show the same; of each pixel, that one is drawn whose own normal is nearest to the
normal in the frames, since a renderer stops light that comes from behind a geometric normal. One faces the viewer, the others lean to all
sides. Only the camera sees them. They cannot shade each other, which an impostor in a game does by writing depth and casting into a
shadow map. Here the shell does that in Cycles, for sun and sky alike; and it casts the shadow that the lamp's own view has. EEVEE draws
the same but for the shading of the impostor by itself, since its shadows start at the quads, and does not filter within frames.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bmesh
import bpy
import mathutils
import numpy as np

from ..core.btf.octahedral import Atlas
from .btf_octahedral_materials import FACING, LEANING, OWN_NORMAL, RIGHT, SHELL, FrameImages, look_groups, quad_material, shell_material
from .images import data_image

CORNERS = 32  # of a quad, which looks round to the viewer and so stays inside the shell
ROOM = 1.02  # radius of the quads, as the viewer sees them, in half sides of a frame
SHELL_SUBDIVISIONS = 3
BIAS = 1.0  # pixels of a frame: how far surfaces have to lie before a place to shade it
IMAGE_NAMES = {"colour": "Colour", "normal_height": "Normal and Height", "surface": "Surface"}
RAYS_OF_LIGHT = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter", "visible_shadow")


@dataclass(frozen=True)
class Impostor:
    """quads: the object that the camera sees. shell: its child that rays of light meet. half_side: of a frame, a length. images: packed."""

    quads: bpy.types.Object
    shell: bpy.types.Object
    half_side: float
    images: list[bpy.types.Image]

    @property
    def objects(self) -> list[bpy.types.Object]:
        """Both objects."""
        return [self.quads, self.shell]

    @property
    def bytes(self) -> int:
        """What the images take without compression."""
        return sum(4 * image.size[0] * image.size[1] for image in self.images)

    def face(self, direction: Sequence[float]) -> None:
        """Turn the quads towards `direction` (3,), world space, where the viewer is; the objects themselves do not turn."""
        facing = (self.quads.matrix_basis.to_3x3().inverted() @ mathutils.Vector(direction)).normalized()
        right, up = facing.to_track_quat("Z", "Y").to_matrix().to_3x3().col[:2]
        places = ROOM * self.half_side * _quads() @ np.array([right, up, facing])
        self.quads.data.vertices.foreach_set("co", places.astype(np.float32).ravel())
        for item, name, axis in ((self.quads, FACING, facing), (self.quads, RIGHT, right), (self.shell, FACING, facing)):
            item.data.attributes[name].data.foreach_set("vector", np.tile(np.float32(axis), len(item.data.vertices)))
        for item in self.objects:
            item.data.update()

    def remove(self) -> None:
        """Remove both objects with all that was made for them."""
        meshes = [item.data for item in self.objects]
        materials = [mesh.materials[0] for mesh in meshes]
        looks = _groups_in(material.node_tree for material in materials)
        bpy.data.batch_remove([*self.objects, *meshes, *materials, *looks, *_groups_in(looks), *self.images])


def impostor(name: str, atlas: Atlas, bias: float = BIAS) -> Impostor:
    """New objects, linked nowhere yet, that show `atlas` with packed images, in its place in the world.

    bias: in pixels of a frame, how far surfaces have to lie before a place to shade it.
    """
    images = atlas_images(name, atlas)
    looks = look_groups(name, FrameImages.of(atlas, images))
    quads = _object(name, quad_material(f"{name} Quads", looks, atlas.half_side), _fans(), (FACING, RIGHT, OWN_NORMAL))
    own_normals = np.repeat(LEANING, CORNERS + 1, axis=0)
    quads.data.attributes[OWN_NORMAL].data.foreach_set("vector", own_normals.astype(np.float32).ravel())
    for rays in RAYS_OF_LIGHT:
        setattr(quads, rays, False)
    shell_bias = 2.0 * bias / atlas.pixels
    shell_mesh = _ball(SHELL * atlas.half_side)
    shell = _object(f"{name} Shell", shell_material(f"{name} Shell", looks, atlas.half_side, shell_bias), shell_mesh, (FACING,))
    shell.visible_camera = False
    shell.parent = quads
    quads.location = atlas.center.tolist()
    made = Impostor(quads, shell, atlas.half_side, list(images.values()))
    made.face((0.0, -1.0, 0.0))
    return made


def atlas_images(name: str, atlas: Atlas) -> dict[str, bpy.types.Image]:
    """The maps of `atlas` as new packed images of 8 bits a channel, by their keys in `Atlas.encoded`."""
    return {key: data_image(f"{name} {IMAGE_NAMES[key]}", pixels, is_data=key != "colour") for key, pixels in atlas.encoded().items()}


def _groups_in(trees: Iterable[bpy.types.NodeTree]) -> set[bpy.types.NodeTree]:
    """The groups that the nodes of `trees` stand for."""
    return {node.node_tree for tree in trees for node in tree.nodes if node.type == "GROUP"}


def _object(name: str, material: bpy.types.Material, shape: bmesh.types.BMesh, attributes: Sequence[str]) -> bpy.types.Object:
    """An object of `shape`, which is freed, with vector `attributes` still to be set."""
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.append(material)
    for attribute in attributes:
        mesh.attributes.new(attribute, "FLOAT_VECTOR", "POINT")
    return bpy.data.objects.new(name, mesh)


def _quads() -> np.ndarray:
    """The corners of all quads as seen from +Z, fans of radius 1 that lean: Q times the middle and CORNERS of the rim, (V, 3)."""
    turns = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    flat = np.concatenate([[[0.0, 0.0]], np.stack([np.cos(turns), np.sin(turns)], axis=1)])
    return np.concatenate([np.column_stack([flat, -flat @ normal[:2] / normal[2]]) for normal in LEANING])


def _fans() -> bmesh.types.BMesh:
    """The triangles between the corners of `_quads`."""
    shape = bmesh.new()
    for fan in np.split(_quads(), len(LEANING)):
        middle, *rim = (shape.verts.new(place) for place in fan)
        for first, second in zip(rim, rim[1:] + rim[:1], strict=True):
            shape.faces.new((middle, first, second))
    return shape


def _ball(radius: float) -> bmesh.types.BMesh:
    """A ball of triangles that face outwards."""
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=SHELL_SUBDIVISIONS, radius=radius)
    return shape
