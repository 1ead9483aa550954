"""An octahedral impostor as ordinary objects: quads that face the viewer, inside a shell that only light rays hit.

All quads intersect at the center of the source and show the same image. At each pixel, the quad whose own normal is nearest to the normal
in the frames is visible, because a renderer rejects light from behind a geometric normal. One quad faces the viewer, the others are tilted
in all directions. Only camera rays hit them. The quads cannot shade each other; in a game, an impostor does that by writing depth and
rendering into a shadow map. Here the shell does it in Cycles, for Suns and the sky. It also casts the shadow with the silhouette seen from
the light. EEVEE renders the same image without self-shadowing, since its shadows start at the quads, and it does not filter within frames.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import bmesh
import bpy
import mathutils
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.btf.export.octahedral_files import create_atlas_images
from farfield.addon.bridge.geometry.mesh_arrays import write_positions
from farfield.addon.core.btf.octahedral import OctahedralAtlas
from lib.impostor_materials import FACING, QUAD_NORMAL, QUAD_NORMALS, RIGHT, SHELL_RADIUS, quad_material, shell_material
from lib.impostor_rays import FrameImages, build_ray_groups

BOUNDARY_VERTICES = 32  # A quad with so many appears round to the viewer and therefore fits into the shell.
QUAD_RADIUS = 1.02  # as seen by the viewer, in half sides of a frame
SHELL_SUBDIVISIONS = 3
DEFAULT_BIAS = 1.0  # pixels of a frame: a surface that is closer in front of a point does not shade it
LIGHT_RAY_VISIBILITY = ("visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter", "visible_shadow")


@dataclass(frozen=True)
class Impostor:
    """quads: object for camera rays. shell: its child, for light rays. half_side: of a frame, a length. images: packed."""

    quads: bpy.types.Object
    shell: bpy.types.Object
    half_side: float
    images: list[bpy.types.Image]

    @property
    def objects(self) -> list[bpy.types.Object]:
        """The quads and the shell."""
        return [self.quads, self.shell]

    @property
    def nbytes(self) -> int:
        """Uncompressed size of the images in bytes."""
        return sum(4 * image.size[0] * image.size[1] for image in self.images)

    def face_viewer(self, direction: Sequence[float]) -> None:
        """Rotate the quads towards the viewer in the world-space `direction` (3,). The object transforms do not change."""
        facing = (self.quads.matrix_basis.to_3x3().inverted() @ mathutils.Vector(direction)).normalized()
        right, up = facing.to_track_quat("Z", "Y").to_matrix().to_3x3().col[:2]
        positions = QUAD_RADIUS * self.half_side * _quad_vertices() @ np.array([right, up, facing])
        write_positions(self.quads.data, positions)
        for item, name, axis in ((self.quads, FACING, facing), (self.quads, RIGHT, right), (self.shell, FACING, facing)):
            item.data.attributes[name].data.foreach_set("vector", np.tile(np.float32(axis), len(item.data.vertices)))
        for item in self.objects:
            item.data.update()

    def remove(self) -> None:
        """Remove both objects and all data created for them."""
        meshes = [item.data for item in self.objects]
        materials = [mesh.materials[0] for mesh in meshes]
        ray_groups = _node_groups_in(material.node_tree for material in materials)
        bpy.data.batch_remove([*self.objects, *meshes, *materials, *ray_groups, *_node_groups_in(ray_groups), *self.images])


def build_impostor(name: str, atlas: OctahedralAtlas, bias: float = DEFAULT_BIAS) -> Impostor:
    """Create objects that show `atlas` with packed images at its world-space position. They are not linked to a collection.

    bias: see `DEFAULT_BIAS`.
    """
    images = create_atlas_images(name, atlas)
    ray_groups = build_ray_groups(name, FrameImages.from_atlas(atlas, images))
    quads = _new_object(name, quad_material(f"{name} Quads", ray_groups, atlas.half_side), _quad_fans(), (FACING, RIGHT, QUAD_NORMAL))
    quad_normals = np.repeat(QUAD_NORMALS, BOUNDARY_VERTICES + 1, axis=0)
    quads.data.attributes[QUAD_NORMAL].data.foreach_set("vector", quad_normals.astype(np.float32).ravel())
    for flag in LIGHT_RAY_VISIBILITY:
        setattr(quads, flag, False)
    shell_bias = 2.0 * bias / atlas.frame_resolution
    shell_mesh = _new_icosphere(SHELL_RADIUS * atlas.half_side)
    shell = _new_object(f"{name} Shell", shell_material(f"{name} Shell", ray_groups, atlas.half_side, shell_bias), shell_mesh, (FACING,))
    shell.visible_camera = False
    shell.parent = quads
    quads.location = atlas.center.tolist()
    impostor = Impostor(quads, shell, atlas.half_side, list(images.values()))
    impostor.face_viewer((0.0, -1.0, 0.0))
    return impostor


def _node_groups_in(trees: Iterable[bpy.types.NodeTree]) -> set[bpy.types.NodeTree]:
    """Return the node groups used by the nodes of `trees`."""
    return {node.node_tree for tree in trees for node in tree.nodes if node.type == "GROUP"}


def _new_object(name: str, material: bpy.types.Material, shape: bmesh.types.BMesh, attributes: Sequence[str]) -> bpy.types.Object:
    """Create an object of `shape`, which is freed, with uninitialized vector `attributes`."""
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    mesh.materials.append(material)
    for attribute in attributes:
        mesh.attributes.new(attribute, "FLOAT_VECTOR", "POINT")
    return bpy.data.objects.new(name, mesh)


def _quad_vertices() -> np.ndarray:
    """Return the vertices (V, 3) of all quads as seen from +Z: tilted triangle fans of radius 1, each a center and its boundary."""
    angles = 2.0 * np.pi * np.arange(BOUNDARY_VERTICES) / BOUNDARY_VERTICES
    flat = np.concatenate([[[0.0, 0.0]], np.stack([np.cos(angles), np.sin(angles)], axis=1)])
    return np.concatenate([np.column_stack([flat, -flat @ normal[:2] / normal[2]]) for normal in QUAD_NORMALS])


def _quad_fans() -> bmesh.types.BMesh:
    """Return the triangle fans of `_quad_vertices`."""
    shape = bmesh.new()
    for fan in np.split(_quad_vertices(), len(QUAD_NORMALS)):
        center, *boundary = (shape.verts.new(position) for position in fan)
        for first, second in zip(boundary, boundary[1:] + boundary[:1], strict=True):
            shape.faces.new((center, first, second))
    return shape


def _new_icosphere(radius: float) -> bmesh.types.BMesh:
    """Return a sphere of triangles that face outwards."""
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=SHELL_SUBDIVISIONS, radius=radius)
    return shape
