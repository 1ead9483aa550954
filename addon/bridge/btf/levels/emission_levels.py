"""Cloud levels with relightable materials, and the Sun lights linked to them."""

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ....core.billboards.texels import Texels
from ....core.btf.compression import CompressedTextures
from ....core.btf.factorization.factors import Factors
from ....core.btf.factorization.lpca import LocalFactors
from ....core.btf.reflectance.lobes import SCHLICK, Lobes, TexelSurface
from ....core.btf.reflectance.parallax import ParallaxMap, parallax_axes
from ....core.btf.reflectance.shadows import Shadows
from ....core.btf.settings import BtfSettings
from ....core.btf.tables import LookupTables, build_tables
from ....core.imaging.images import decode_normals, dilate, nearest_known
from ...billboards.cloud_materials import FRONT_COLOR, FRONT_NORMAL, FRONT_ROUGHNESS_METALLIC_DEPTH
from ...billboards.level_objects import PBR_MATERIAL, pbr_image
from ...imaging.images import read_pixels
from ...lod_crossfade import apply_to_materials
from ...objects import add_object_driver
from ...rendering.render_properties import ensure_transparent_bounces
from ..materials.emission_material import (
    AMBIENT,
    SUNS,
    BtfImages,
    build_relightable_material,
    sun_color_property,
    sun_direction_property,
    sun_node_labels,
)
from ..materials.nodes.parallax_nodes import write_texel_axes
from ..materials.texture_images import DILATION_TEXELS, create_color_image, create_half_float_image, create_weight_images
from .level_checks import PBR_LABELS

OTHER_TRANSPARENT_SURFACES = 8  # Allowance for the rest of a scene.


def read_texel_surface(level_object: bpy.types.Object, texels: Texels) -> TexelSurface | None:
    """Return normals, roughness and parallax of texels from the PBR maps of a level; None if one of its maps is missing."""
    images = [pbr_image(level_object, label) for label in PBR_LABELS]
    if None in images:
        return None
    normal_map, roughness_metallic_depth_map = map(read_pixels, images[1:])
    normals, roughness_metallic_depth = (
        pixels[texels.pixels[:, 1], texels.pixels[:, 0]] for pixels in (normal_map, roughness_metallic_depth_map)
    )
    parallax = build_parallax_map(level_object, texels, normal_map, roughness_metallic_depth[:, 2])
    return TexelSurface(decode_normals(normals), roughness_metallic_depth[:, 0], parallax)


def build_parallax_map(level_object: bpy.types.Object, texels: Texels, normals: np.ndarray, depths: np.ndarray) -> ParallaxMap:
    """Return the parallax map of the texels of a level, from the pixels (H, W, 4) of its normal map and encoded `depths` (N,) in 0..1."""
    axes = parallax_axes(texels, float(level_object["farfield_error"]))
    unit_normals = decode_normals(normals.reshape(-1, normals.shape[2])).reshape(*normals.shape[:2], 3)
    return ParallaxMap(texels.pixels, texels.quad_indices, axes, 2.0 * depths - 1.0, unit_normals)


def assign_relightable_material(
    level_object: bpy.types.Object, texels: Texels, textures: CompressedTextures, settings: BtfSettings
) -> None:
    """Give a level object a relightable material that decodes the `textures` of its `texels`. Its PBR material stays in the file.

    The alpha of `textures` is added to that of the PBR maps. The normals of their lobes must be those of the PBR maps.
    """
    shadows = None if textures.lobes is None else textures.lobes.shadows
    tables = build_tables(textures.color, textures.alpha, settings.view_grid, settings.light_grid, shadows)
    name = f"{level_object.name} BTF"
    images = _create_images(level_object, name, texels, textures, tables)
    if images.depth is not None:
        write_texel_axes(level_object.data, textures.lobes.surface.parallax.axes)
    material = build_relightable_material(name, images, tables, settings.blend_texels)
    replace_pbr_material(level_object, material)
    for index in range(SUNS):
        level_object[sun_direction_property(index)] = [0.0, 0.0, 1.0]
        level_object[sun_color_property(index)] = [0.0, 0.0, 0.0]
    level_object[AMBIENT] = [0.0, 0.0, 0.0]
    apply_to_materials(level_object)


def replace_pbr_material(level_object: bpy.types.Object, material: bpy.types.Material) -> None:
    """Give a level a relightable `material`. Its PBR material stays in the file.

    Linked duplicates of the level get it too, since the mesh holds the material. They also remember the PBR material.
    """
    shown_material, users = level_object.data.materials[0], _mesh_users(level_object.data)
    names = [item[PBR_MATERIAL] for item in (level_object, *users) if PBR_MATERIAL in item]
    if not names and shown_material is not None:
        shown_material.use_fake_user = True
        names = [shown_material.name]
    for item in users if names else ():
        item[PBR_MATERIAL] = item.get(PBR_MATERIAL, names[0])
    level_object.data.materials[0] = material


def _create_images(
    level_object: bpy.types.Object, name: str, texels: Texels, textures: CompressedTextures, tables: LookupTables
) -> BtfImages:
    """Create all images of a relightable material."""
    color, alpha, lobes = textures.color, textures.alpha, textures.lobes
    known = texels.to_image(color.known[:, None].astype(np.float32))[..., 0]
    weights, clusters = _build_weight_maps(color, texels, known)
    sky_visibility = None if lobes is None else lobes.sky_visibility
    return BtfImages(
        weights=create_weight_images(f"{name} Weights", weights),
        clusters=None if clusters is None else create_half_float_image(f"{name} Clusters", np.repeat(clusters[..., None], 4, axis=2)),
        chromaticity=create_color_image(f"{name} Chromaticity", textures.chromaticity, sky_visibility, texels, known),
        emission=None if textures.emission is None else create_color_image(f"{name} Emission", textures.emission, None, texels, known),
        basis=create_half_float_image(f"{name} Basis", tables.basis),
        dome=create_half_float_image(f"{name} Dome", tables.dome.image),
        alpha_weights=create_weight_images(f"{name} Alpha Weights", texels.to_image(alpha.weights)),
        alpha_basis=create_half_float_image(f"{name} Alpha", tables.alpha.image),
        pbr_color=pbr_image(level_object, FRONT_COLOR),
        **_lobe_images(level_object, name, texels, lobes, known),
        **_shadow_images(name, texels, None if lobes is None else lobes.shadows, tables, known),
    )


def _lobe_images(level_object: bpy.types.Object, name: str, texels: Texels, lobes: Lobes | None, known: np.ndarray) -> dict[str, Any]:
    if lobes is None:
        return {**dict.fromkeys(("diffuse", "specular", "normals", "depth")), "dome_fresnel": SCHLICK}
    diffuse, specular = (
        dilate(texels.to_image(np.column_stack(columns)), known, DILATION_TEXELS)
        for columns in ((lobes.diffuse, lobes.surface.roughness), (lobes.f0, lobes.f90_minus_f0))
    )
    return {
        "diffuse": create_half_float_image(f"{name} Diffuse", diffuse),
        "specular": create_half_float_image(f"{name} Specular", specular),
        "normals": pbr_image(level_object, FRONT_NORMAL),
        "depth": None if lobes.surface.parallax is None else pbr_image(level_object, FRONT_ROUGHNESS_METALLIC_DEPTH),
        "dome_fresnel": lobes.dome_fresnel,
    }


def _shadow_images(name: str, texels: Texels, shadows: Shadows | None, tables: LookupTables, known: np.ndarray) -> dict[str, Any]:
    if shadows is None:
        return {"shadow_weights": [], "shadow_basis": None}
    weights = dilate(texels.to_image(shadows.angles.weights), known, DILATION_TEXELS)
    return {
        "shadow_weights": create_weight_images(f"{name} Shadow Weights", weights),
        "shadow_basis": create_half_float_image(f"{name} Shadow", tables.shadow.image),
    }


def _build_weight_maps(color: Factors, texels: Texels, known: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Return maps of the weights (H, W, K) and of cluster indices (H, W), filled in all pixels; None if there are no clusters.

    Weights of different clusters cannot be mixed: a texel that is not in `known` (H, W) takes both from the nearest known texel.
    """
    weights = texels.to_image(color.weights)
    if not isinstance(color, LocalFactors):
        return dilate(weights, known, DILATION_TEXELS), None
    nearest = nearest_known(known > 0.0)
    return weights[nearest], texels.to_image(color.labels[:, None].astype(np.float32))[..., 0][nearest]


def raise_transparent_bounces(collection: bpy.types.Collection, stacked_quads: int) -> None:
    """Let rays pass through `stacked_quads` quads in all scenes that contain `collection`; Cycles renders deeper ones black.

    Higher limits stay.
    """
    for scene in bpy.data.scenes:
        if collection in scene.collection.children_recursive:
            ensure_transparent_bounces(scene, stacked_quads + OTHER_TRANSPARENT_SURFACES)


def restore_pbr_material(level_object: bpy.types.Object) -> None:
    """Give a level its PBR material back, also if its material slot was removed. Remove the relightable material and its drivers.

    This includes the linked duplicates of the level; one that was restored in this way is not changed again.
    """
    if PBR_MATERIAL not in level_object:
        return
    users = _mesh_users(level_object.data)
    for item in users:
        remove_suns(item)
    relightable_material = next(iter(level_object.data.materials), None)
    pbr_material = bpy.data.materials.get(str(level_object[PBR_MATERIAL]))
    if len(level_object.data.materials):
        level_object.data.materials[0] = pbr_material
    else:
        level_object.data.materials.append(pbr_material)
    for item in users:
        item.pop(PBR_MATERIAL, None)
    if pbr_material is not None:
        pbr_material.use_fake_user = False
    apply_to_materials(level_object)
    if relightable_material is not None and relightable_material.users == 0:
        bpy.data.materials.remove(relightable_material)


def _mesh_users(mesh: bpy.types.Mesh) -> list[bpy.types.Object]:
    """Return all objects that show `mesh` and can be changed: a level and its linked duplicates."""
    return [item for item in bpy.data.objects if item.data == mesh and item.is_editable]


def remove_suns(level_object: bpy.types.Object) -> None:
    """Remove all links to Sun lights, and the custom properties that they drive."""
    link_suns(level_object, (), (0.0, 0.0, 0.0))
    for name in (AMBIENT, *(name(index) for index in range(SUNS) for name in (sun_direction_property, sun_color_property))):
        level_object.pop(name, None)


def link_suns(level_object: bpy.types.Object, suns: Sequence[bpy.types.Object], ambient: Sequence[float]) -> None:
    """Light a level with up to four Sun lights, linked by drivers, and with uniform World lighting of the radiance `ambient` (3,).

    Does nothing for models other than *emission*: they are lit by all lights.
    """
    if not needs_linked_suns(level_object):
        return
    for index in range(SUNS):
        for name in (sun_direction_property(index), sun_color_property(index)):
            level_object.driver_remove(f'["{name}"]')
            level_object[name] = [0.0, 0.0, 0.0]
        if index >= len(suns):
            continue
        for axis in range(3):
            direction = {"value": f"matrix_world[2][{axis}]"}
            add_object_driver(level_object, sun_direction_property(index), axis, "value", suns[index], direction)
            color = {"color": f"data.color[{axis}]", "strength": "data.energy"}
            add_object_driver(level_object, sun_color_property(index), axis, "color * strength", suns[index], color)
    level_object[AMBIENT] = [float(value) for value in ambient]
    _mute_unused_suns(next(iter(level_object.data.materials), None), len(suns))


def needs_linked_suns(level_object: bpy.types.Object) -> bool:
    """Whether a level was baked with the model *emission*, which only shows linked Sun lights."""
    return AMBIENT in level_object


def _mute_unused_suns(material: bpy.types.Material | None, used_count: int) -> None:
    """Mute the nodes that decode Suns from index `used_count` on: renderers would evaluate them although their light is black."""
    if material is None or material.node_tree is None:
        return
    unused = {label for index in range(used_count, SUNS) for label in sun_node_labels(index)}
    for node in material.node_tree.nodes:
        if node.type == "GROUP" and node.label:
            node.mute = node.label in unused
