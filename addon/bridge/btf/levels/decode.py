"""Relightable textures read back from the images of a relightable material."""

from dataclasses import replace
from typing import Any

import bpy
import idprop
import numpy as np

from ....core.btf.decoding import RelightableTexture
from ....core.btf.factorization.factors import Factors
from ....core.btf.factorization.lpca import LocalFactors
from ....core.btf.reflectance.lobes import SCHLICK, GrazingFresnel, Lobes, TexelSurface
from ....core.btf.reflectance.parallax import ParallaxMap
from ....core.btf.reflectance.shadows import Shadows
from ....core.btf.settings import EMISSION as EMISSION_MODEL
from ....core.btf.tables import unpack_color_basis, unpack_scalar_basis, unpack_weights
from ....core.errors import GeometryError
from ....core.geometry.directions import DirectionGrid
from ....core.imaging.images import decode_normals
from ...billboards.level_objects import read_atlas_size, read_level_texels
from ...imaging.images import read_pixels
from ...shading.node_builder import nodes_in
from ..materials.emission_material import (
    ALPHA_BASIS,
    ALPHA_WEIGHTS,
    CHROMATICITY,
    CLUSTERS,
    DIFFUSE,
    DOME,
    DOME_FRESNEL,
    LAYOUT,
    LAYOUT_KEYS,
    NORMALS,
    PBR_COLOR,
    SPECULAR,
    VERSION,
    WEIGHTS,
)
from ..materials.nodes.parallax_nodes import DEPTH
from ..materials.nodes.radiance_nodes import BASIS
from ..materials.nodes.shadow_nodes import SHADOW_BASIS, SHADOW_WEIGHTS
from .emission_levels import build_parallax_map
from .level_checks import check_quads


def read_relightable_texture(level_object: bpy.types.Object) -> RelightableTexture:
    """Read the relightable textures of a level object, at all pixels of its texture.

    Raises:
        GeometryError: if the level has no relightable material, an image is missing, another version of Farfield baked it, or its quads
            cannot be read.
    """
    layout = _read_layout(level_object)
    check_quads(level_object)
    views = DirectionGrid(layout["views_per_side"], bool(layout["views_upper"]))
    lights = DirectionGrid(layout["lights_per_side"], bool(layout["lights_upper"]))
    images = _LevelImages(level_object)
    chromaticity, sky_visibility = np.split(images.pixels(CHROMATICITY), [3], axis=2)
    height, width = chromaticity.shape[:2]
    if (width, height) != read_atlas_size(level_object):
        raise GeometryError(f'The images of "{level_object.name}" have another size than its atlas; bake them again.')
    color = _decode_color(images, layout, height, views, lights, np.ones(height * width, bool))
    lobes = _decode_lobes(level_object, images, layout, height, sky_visibility.ravel(), color.known) if DIFFUSE in images else None
    pbr_alpha = images.pixels(PBR_COLOR)[..., 3] if PBR_COLOR in images else np.zeros((height, width), np.float32)
    return RelightableTexture(
        size=(width, height),
        chromaticity=chromaticity.reshape(-1, 3),
        color=color,
        alpha=images.scalar_factors(ALPHA_WEIGHTS, ALPHA_BASIS, views, layout["alpha_components"], height, color.known),
        pbr_alpha=pbr_alpha.ravel(),
        views=views,
        lights=lights,
        lobes=lobes,
    )


def is_upper_hemisphere(level_object: bpy.types.Object) -> bool:
    """Whether a level was baked for directions above the horizon only, with any model.

    Raises:
        GeometryError: if the level has no relightable material.
    """
    return bool(_stored_layout(level_object).get("views_upper", False))


class _LevelImages:
    """The images of a level's relightable material by the labels of their nodes, those in groups included."""

    def __init__(self, level_object: bpy.types.Object) -> None:
        tree = level_object.data.materials[0].node_tree
        self._name = level_object.name
        self._images = {node.label: node.image for node in nodes_in(tree) if node.type == "TEX_IMAGE"}

    def __contains__(self, label: str) -> bool:
        return label in self._images

    def pixels(self, label: str) -> np.ndarray:
        """Return the pixels (H, W, 4) of an image; raises GeometryError if it is missing or damaged."""
        image = self._images.get(label)
        if image is None or not all(image.size):
            problem = "is damaged" if image is not None and image.packed_files else "is missing"
            raise GeometryError(f'The image "{label}" of the relightable textures of "{self._name}" {problem}; bake them again.')
        return read_pixels(image)

    def weights(self, label: str, count: int, height: int) -> np.ndarray:
        """Return the weights (H * W, count) of the blocks that nodes with this label show. height: of a block in pixels."""
        first_node_by_image: dict[str, str] = {}
        for index in range(-(-count // 4)):
            node_label = f"{label} {index}"
            image_name = self._images[node_label].name if node_label in self._images else node_label
            first_node_by_image.setdefault(image_name, node_label)
        return unpack_weights([self.pixels(node_label) for node_label in first_node_by_image.values()], height, count).reshape(-1, count)

    def scalar_factors(
        self, weight_label: str, basis_label: str, grid: DirectionGrid, count: int, height: int, known: np.ndarray
    ) -> Factors:
        """Return the factors of one scalar per texel and direction of `grid`, with `count` components."""
        weights = self.weights(weight_label, count, height)
        return Factors(weights, unpack_scalar_basis(self.pixels(basis_label), grid, count), known)


def _read_layout(level_object: bpy.types.Object) -> dict[str, int]:
    """Return the layout of the images of a level, see `LAYOUT_KEYS`."""
    layout = _stored_layout(level_object)
    if layout.get("model", EMISSION_MODEL) != EMISSION_MODEL:
        raise GeometryError(
            f'"{level_object.name}" is lit by the scene, so it has no radiance to export; bake it with the model Emission first.'
        )
    if layout.get("version") != VERSION or not set(LAYOUT_KEYS) <= set(layout):
        raise GeometryError(f'The relightable textures of "{level_object.name}" are of another version of Farfield; bake them again.')
    return layout


def _stored_layout(level_object: bpy.types.Object) -> dict[str, Any]:
    material = level_object.data.materials[0] if level_object.data.materials else None
    stored = material.get(LAYOUT) if material is not None else None
    layout = dict(stored) if isinstance(stored, idprop.types.IDPropertyGroup) else {}
    if not layout:
        raise GeometryError(f'"{level_object.name}" has no relightable textures; bake them first.')
    return layout


def _decode_color(
    images: _LevelImages, layout: dict[str, int], height: int, views: DirectionGrid, lights: DirectionGrid, known: np.ndarray
) -> Factors:
    """Return the factors of the radiance: columns are lights, the dome last, times channels."""
    components = layout["components"]
    basis = unpack_color_basis(images.pixels(BASIS), images.pixels(DOME), views, lights, layout["clusters"], components)
    weights = images.weights(WEIGHTS, components, height)
    if CLUSTERS not in images:
        return Factors(weights, basis, known)
    labels = np.rint(images.pixels(CLUSTERS)[..., 0]).astype(np.int32).ravel()
    return LocalFactors(weights, basis, known, labels)


def _decode_lobes(
    level_object: bpy.types.Object,
    images: _LevelImages,
    layout: dict[str, int],
    height: int,
    sky_visibility: np.ndarray,
    known: np.ndarray,
) -> Lobes:
    """Return the lobes of all P pixels. sky_visibility (P,); known (P,): see `Factors`."""
    normals, diffuse, specular = (images.pixels(label).reshape(-1, 4) for label in (NORMALS, DIFFUSE, SPECULAR))
    surface = TexelSurface(decode_normals(normals), diffuse[:, 3])
    if DEPTH in images:
        surface = replace(surface, parallax=_decode_parallax_map(level_object, images.pixels(NORMALS), images.pixels(DEPTH)))
    stored = level_object.data.materials[0].get(DOME_FRESNEL)
    dome_fresnel = GrazingFresnel(*stored) if isinstance(stored, idprop.types.IDPropertyArray) and len(stored) == 2 else SCHLICK
    shadows = None
    if layout["shadows_per_side"]:
        grid = DirectionGrid(layout["shadows_per_side"], bool(layout["shadows_upper"]))
        count = layout["shadow_components"]
        shadows = Shadows(grid, images.scalar_factors(SHADOW_WEIGHTS, SHADOW_BASIS, grid, count, height, known))
    return Lobes(
        surface,
        diffuse=diffuse[:, :3],
        f0=specular[:, :3],
        f90_minus_f0=specular[:, 3],
        shadows=shadows,
        sky_visibility=sky_visibility,
        dome_fresnel=dome_fresnel,
    )


def _decode_parallax_map(level_object: bpy.types.Object, normals: np.ndarray, depths: np.ndarray) -> ParallaxMap:
    """Return the parallax map of all pixels of a level from the pixels (H, W, 4) of its maps; depth 0 where there is no texel."""
    texels = read_level_texels(level_object)
    parallax = build_parallax_map(level_object, texels, normals, depths[texels.pixels[:, 1], texels.pixels[:, 0], 2])
    texel_indices = texels.index_map.ravel()
    row, column = np.divmod(np.arange(len(texel_indices)), texels.texture_size[0])
    pixel_depths = np.where(texel_indices >= 0, parallax.depths[texel_indices], 0.0)
    return replace(parallax, pixels=np.column_stack([column, row]), quad_indices=texels.quad_indices[texel_indices], depths=pixel_depths)
