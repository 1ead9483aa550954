"""Level objects of a cloud: their quads, texels and the material with their PBR maps."""

import bpy
import idprop
import numpy as np

from ...core.billboards.atlas import MAX_SIDE
from ...core.billboards.texels import QuadPolygons, Texels, texels_under_quads
from ...core.errors import GeometryError
from ...core.imaging.metrics import decode_srgb
from ..geometry.mesh_arrays import read_attribute, read_positions
from ..imaging.images import check_pixels, read_pixels
from ..objects import world_matrix
from ..shading.surface_layers import LAYERS
from .cloud_materials import FRONT_COLOR, SIDES, ShownLayer, map_label, strength_name

CENTER = "farfield_center"  # Custom property of a level object: the mean of its vertices in world space when the cloud was built.
QUAD_ATTRIBUTE = "farfield_quad"  # Per face: its quad, in levels where a quad may have several faces; otherwise each face is a quad.
PBR_MATERIAL = "farfield_pbr_material"  # Custom property of a level object: the name of the material with the PBR maps.


def read_atlas_size(level_object: bpy.types.Object) -> tuple[int, int]:
    """Return the width and height of the images of a level object, in texels.

    Raises:
        GeometryError: the custom property that holds them was changed to something else.
    """
    size = find_atlas_size(level_object)
    if size is None:
        raise GeometryError(f'The size of the atlas of "{level_object.name}" is not two numbers up to {MAX_SIDE}; build the cloud again.')
    return size


def find_atlas_size(level_object: bpy.types.Object) -> tuple[int, int] | None:
    """Return the same as `read_atlas_size`, None where that raises an error."""
    atlas = level_object.get("farfield_atlas")
    sides = list(atlas) if hasattr(atlas, "__len__") and not isinstance(atlas, str) else []
    return (sides[0], sides[1]) if len(sides) == 2 and all(isinstance(side, int) and 1 <= side <= MAX_SIDE for side in sides) else None


def read_level_texels(level_object: bpy.types.Object, center: np.ndarray | None = None) -> Texels:
    """Return the texels on the quads of a level object, in world space. center: see `read_level_quads`."""
    return texels_under_quads(read_level_quads(level_object, center), read_atlas_size(level_object))


def read_level_quads(level_object: bpy.types.Object, center: np.ndarray | None = None) -> QuadPolygons:
    """Return the polygons of a level object, in world space, without the rotation and scale of the object.

    center (3,): move the mean of the vertices to this position, instead of the object's origin to its location.
    """
    mesh = level_object.data
    uvs = read_attribute(mesh.attributes["UVMap"])
    local = read_positions(mesh).astype(np.float64)
    offset = np.array(world_matrix(level_object).translation, np.float64) if center is None else center - local.mean(axis=0)
    world = local + offset
    size = np.array(read_atlas_size(level_object), np.float64)
    corners, coordinates = [], []
    for polygon in mesh.polygons:
        loops = slice(polygon.loop_start, polygon.loop_start + polygon.loop_total)
        corners.append(world[list(polygon.vertices)])
        coordinates.append(uvs[loops] * size)
    return QuadPolygons(corners, coordinates, read_face_quads(mesh))


def read_face_quads(mesh: bpy.types.Mesh) -> np.ndarray | None:
    """Return the quad (F,) int32 of each face of a level's mesh, ascending without gaps; None if each face is a quad of its own."""
    attribute = mesh.attributes.get(QUAD_ATTRIBUTE)
    if attribute is None or attribute.domain != "FACE" or attribute.data_type != "INT":
        return None
    quads = read_attribute(attribute)
    is_valid = len(quads) and quads[0] == 0 and np.isin(np.diff(quads), (0, 1)).all()
    return quads if is_valid else None


def first_faces(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the index (Q,) of the first face of each quad."""
    quads = read_face_quads(mesh)
    return np.arange(len(mesh.polygons)) if quads is None else np.flatnonzero(np.diff(quads, prepend=-1))


def built_center(level_object: bpy.types.Object, source_origin: np.ndarray) -> np.ndarray:
    """Return the mean (3,) of the vertices of a level in world space when the cloud was built, wherever the level is now.

    source_origin (3,): that of the source, at which levels are created; older files do not store the center.
    """
    stored = level_object.get(CENTER)
    if isinstance(stored, idprop.types.IDPropertyArray) and len(stored) == 3 and stored.typecode in "fdi":
        return np.array(stored, np.float64)
    return read_positions(level_object.data).astype(np.float64).mean(axis=0) + source_origin


def read_quad_flags(level_object: bpy.types.Object, name: str) -> np.ndarray:
    """Return the face attribute `name` as (Q,) bool, such as SOLID_ATTRIBUTE; False where the user has removed or changed it."""
    attribute = level_object.data.attributes.get(name)
    is_known = attribute is not None and attribute.domain == "FACE" and attribute.data_type == "FLOAT"
    first = first_faces(level_object.data)
    return read_attribute(attribute)[first].astype(bool) if is_known else np.zeros(len(first), bool)


def read_pbr_alpha(level_object: bpy.types.Object, texels: Texels) -> np.ndarray:
    """Return the coverage (N,) float32 of `texels` in the PBR maps of a level; 0 if it has no maps."""
    image = pbr_image(level_object, FRONT_COLOR)
    if image is None:
        return np.zeros(len(texels), np.float32)
    return read_pixels(image)[texels.pixels[:, 1], texels.pixels[:, 0], 3]


def pbr_material(level_object: bpy.types.Object) -> bpy.types.Material | None:
    """The material with the PBR maps of a level, also while the level has its relightable material; None if its slot was removed."""
    return bpy.data.materials.get(str(level_object.get(PBR_MATERIAL, ""))) or next(iter(level_object.data.materials), None)


def pbr_image(level_object: bpy.types.Object, label: str) -> bpy.types.Image | None:
    """The image of the PBR maps in the node labeled `label`."""
    return labeled_image(pbr_material(level_object), label)


def read_layers(level_object: bpy.types.Object) -> dict[str, ShownLayer]:
    """Return the layers of the PBR maps of a level by name, see `surface_layers`; none where the user has removed them."""
    material = pbr_material(level_object)
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else []
    layers = {}
    for layer in LAYERS:
        group = next((node for node in nodes if node.type == "GROUP" and f"{SIDES[0]} {layer.title()}" in node.inputs), None)
        if group is not None:
            strength = group.inputs.get(strength_name(layer))
            found = {side: labeled_image(material, map_label(side, layer)) for side in SIDES}
            images = {side: image for side, image in found.items() if image is not None}
            constant = None if SIDES[0] in images else tuple(group.inputs[f"{SIDES[0]} {layer.title()}"].default_value)[:3]
            layers[layer] = ShownLayer(1.0 if strength is None else strength.default_value, images if constant is None else {}, constant)
    return layers


def read_layer_pixels(layer: ShownLayer, side: str) -> np.ndarray:
    """Return the scene-linear colors (H, W, 3) or (1, 1, 3) of a layer of a side (SIDES), with its scale.

    Raises:
        FileError: its image has no pixels.
    """
    if layer.constant is not None:
        return layer.scale * np.float32(layer.constant).reshape(1, 1, 3)
    image = layer.images.get(side, layer.images[SIDES[0]])
    check_pixels(image)
    return layer.scale * decode_srgb(read_pixels(image)[..., :3])


def labeled_image(material: bpy.types.Material | None, label: str) -> bpy.types.Image | None:
    """The image of the first image texture node of `material` labeled `label`."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else []
    return next((node.image for node in nodes if node.type == "TEX_IMAGE" and node.label == label), None)
