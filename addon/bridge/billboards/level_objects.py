"""Level objects of a cloud: their quads, texels and the material with their PBR maps."""

import bpy
import mathutils
import numpy as np

from ...core.billboards.texels import QuadPolygons, Texels, texels_under_quads
from ..images import read_pixels
from ..mesh_arrays import read_attribute, read_positions
from .cloud_materials import FRONT_COLOR

PBR_MATERIAL = "farfield_pbr_material"  # custom property of a level object: the name of the material with the PBR maps


def read_level_texels(level_object: bpy.types.Object) -> Texels:
    """Return the texels on the quads of a level object, in world space."""
    return texels_under_quads(read_level_quads(level_object), tuple(level_object["farfield_atlas"]))


def read_level_quads(level_object: bpy.types.Object) -> QuadPolygons:
    """Return the polygons of a level object, in world space. Its object is expected to have a location only, no rotation and no scale."""
    mesh = level_object.data
    uvs = read_attribute(mesh.attributes["UVMap"])
    world = read_positions(mesh).astype(np.float64) + np.array(level_world_matrix(level_object).translation, np.float64)
    size = np.array(level_object["farfield_atlas"], np.float64)
    corners, coordinates = [], []
    for polygon in mesh.polygons:
        loops = slice(polygon.loop_start, polygon.loop_start + polygon.loop_total)
        corners.append(world[list(polygon.vertices)])
        coordinates.append(uvs[loops] * size)
    return QuadPolygons(corners, coordinates)


def level_world_matrix(level_object: bpy.types.Object) -> mathutils.Matrix:
    """Return the world matrix of a level object. Blender does not compute `matrix_world` of objects that are hidden in an opened file."""
    return level_object.matrix_basis if level_object.parent is None and not level_object.constraints else level_object.matrix_world


def read_pbr_alpha(level_object: bpy.types.Object, texels: Texels) -> np.ndarray:
    """Return the coverage (N,) float32 of `texels` in the PBR maps of a level; 0 if it has no maps."""
    image = pbr_image(level_object, FRONT_COLOR)
    if image is None:
        return np.zeros(len(texels), np.float32)
    return read_pixels(image)[texels.pixels[:, 1], texels.pixels[:, 0], 3]


def pbr_material(level_object: bpy.types.Object) -> bpy.types.Material | None:
    """The material with the PBR maps of a level, also while the level has its relightable material."""
    return bpy.data.materials.get(level_object.get(PBR_MATERIAL, "")) or level_object.data.materials[0]


def pbr_image(level_object: bpy.types.Object, label: str) -> bpy.types.Image | None:
    """The image of the PBR maps in the node labeled `label`."""
    return labeled_image(pbr_material(level_object), label)


def labeled_image(material: bpy.types.Material | None, label: str) -> bpy.types.Image | None:
    """The image of the first image texture node of `material` labeled `label`."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else []
    return next((node.image for node in nodes if node.type == "TEX_IMAGE" and node.label == label), None)
