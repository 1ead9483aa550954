"""Cloud levels with the material of the model *surface*."""

import itertools

import bpy
import numpy as np

from ....core.billboards.texels import Texels
from ....core.btf.reflectance.parallax import parallax_axes
from ....core.btf.settings import BtfSettings
from ....core.btf.surface_compression import SurfaceTextures, TwoSidedTexels
from ....core.btf.tables import build_alpha_table
from ....core.errors import GeometryError
from ....core.imaging.metrics import decode_srgb
from ...billboards.cloud_materials import (
    COLOR,
    MAPS,
    NORMAL,
    ROUGHNESS_METALLIC_DEPTH,
    SHADOWLESS_DISTANCE,
    SIDES,
    SOLID_ATTRIBUTE,
    map_label,
)
from ...billboards.level_maps import SHADOWLESS_ERRORS
from ...billboards.level_objects import pbr_image, pbr_material, read_layer_pixels, read_layers, read_pbr_alpha, read_quad_flags
from ...imaging.images import check_pixels, read_pixels
from ...lod_crossfade import apply_to_materials
from ...shading.shared_parameters import Value
from ...shading.surface_layers import TRANSLUCENCY, TRANSMISSION
from ..materials.emission_material import LAYOUT, VERSION
from ..materials.nodes.parallax_nodes import write_texel_axes
from ..materials.surface_material import SurfaceImages, build_surface_material
from ..materials.texture_images import create_half_float_image, create_weight_images
from .emission_levels import remove_suns, replace_pbr_material

MIN_NEAR_VISIBILITY = 0.02  # Darker colors are not divided by it: 8 bits hold nothing of them.


def check_maps(level_object: bpy.types.Object) -> None:
    """Raise GeometryError if a level has no PBR maps, FileError if one has no pixels."""
    images = _pbr_images(level_object).values()
    if None in images:
        raise GeometryError(
            f'The level "{level_object.name}" has no textures, which the model Surface needs; build the cloud with textures, '
            "or choose the model Emission."
        )
    for image in images:
        check_pixels(image)


def read_two_sided_texels(level_object: bpy.types.Object, texels: Texels) -> TwoSidedTexels:
    """Read the PBR maps of a level at its `texels`. They must exist, see `check_maps`."""
    images = _pbr_images(level_object)
    columns, rows = texels.pixels.T

    layers = [layer for name, layer in read_layers(level_object).items() if name in (TRANSLUCENCY, TRANSMISSION)]

    def read_side(side: str) -> np.ndarray:
        color, normal = (read_pixels(images[side, name])[rows, columns, :3] for name in (COLOR, NORMAL))
        near_visibility = np.maximum(read_pixels(images[side, ROUGHNESS_METALLIC_DEPTH])[rows, columns, 3], MIN_NEAR_VISIBILITY)
        # The views of the source show the color itself, and also that of the light which leaves and glass let through.
        color_sum = decode_srgb(color) / near_visibility[:, None] + sum(
            read_layer_pixels(layer, side)[rows, columns] for layer in layers if layer.images
        )
        color_sum += sum(read_layer_pixels(layer, side)[0, 0] for layer in layers if not layer.images)
        return np.column_stack([color_sum, normal]).astype(np.float32)

    return TwoSidedTexels(
        texels,
        *map(read_side, SIDES),
        read_pbr_alpha(level_object, texels),
        read_quad_flags(level_object, SOLID_ATTRIBUTE),
    )


def assign_surface_material(
    level_object: bpy.types.Object, texels: Texels, textures: SurfaceTextures, settings: BtfSettings, parameters: dict[str, Value]
) -> None:
    """Give a level object the surface material of its PBR maps and the `textures` of its `texels`. Its PBR material stays in the file.

    parameters: of the source, see `read_shared_parameters`.
    """
    remove_suns(level_object)
    name, views = f"{level_object.name} BTF", settings.view_grid
    error = float(level_object["farfield_error"])
    write_texel_axes(level_object.data, parallax_axes(texels, error))
    table = build_alpha_table(textures.alpha, views)
    shown_sides = SIDES[:1] if read_quad_flags(level_object, SOLID_ATTRIBUTE).all() else SIDES
    images = SurfaceImages(
        maps={key: image for key, image in _pbr_images(level_object).items() if key[0] in shown_sides},
        alpha_weights=create_weight_images(f"{name} Alpha Weights", texels.to_image(textures.alpha.weights)),
        alpha_basis=create_half_float_image(f"{name} Alpha", table.image),
        alpha=table,
        upper=views.upper,
        layers=read_layers(level_object),
    )
    material = build_surface_material(name, images, _shadowless_distance(level_object, error), parameters)
    material[LAYOUT] = {"version": VERSION, "model": settings.model, "views_per_side": views.size, "views_upper": int(views.upper)}
    replace_pbr_material(level_object, material)
    apply_to_materials(level_object)


def _pbr_images(level_object: bpy.types.Object) -> dict[tuple[str, str], bpy.types.Image | None]:
    return {(side, name): pbr_image(level_object, map_label(side, name)) for side, name in itertools.product(SIDES, MAPS)}


def _shadowless_distance(level_object: bpy.types.Object, error: float) -> float:
    """Return the distance within which the PBR material blocks no light, which the user may have changed."""
    tree = pbr_material(level_object).node_tree
    values = [node.inputs[SHADOWLESS_DISTANCE].default_value for node in tree.nodes if SHADOWLESS_DISTANCE in node.inputs]
    return values[0] if values else SHADOWLESS_ERRORS * error
