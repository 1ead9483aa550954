"""Relightable textures read back out of the images of a material that decodes them."""

from dataclasses import replace

import bpy
import numpy as np

from ..core.btf.decoding import BakedAtlas
from ..core.btf.factors import Factors
from ..core.btf.lobes import SCHLICK, Grazing, Lobes, Surface, normals_of
from ..core.btf.lpca import LocalFactors
from ..core.btf.relief import Relief
from ..core.btf.shadows import Shadows
from ..core.btf.tables import colour_basis, one_column_basis, weights_in
from ..core.direction_grids import DirectionGrid
from ..core.errors import GeometryError
from .btf_clouds import relief_of, texels_of_level
from .btf_materials import (
    ALPHA_BASIS,
    ALPHA_WEIGHTS,
    BASIS,
    CLUSTERS,
    DIFFUSE,
    DOME,
    GRAZING,
    LAYOUT,
    LAYOUT_NUMBERS,
    NORMALS,
    PLAIN,
    SPECULAR,
    TINTS,
    VERSION,
    WEIGHTS,
)
from .images import pixels_of
from .node_groups import nodes_in
from .relief_nodes import RELIEF
from .shadow_nodes import SHADOW_BASIS, SHADOW_WEIGHTS


def baked_atlas(level_object: bpy.types.Object) -> BakedAtlas:
    """What the relightable textures of a level object hold, at all pixels of its texture.

    Raises:
        GeometryError: when the level wears none, or not all of them, or those of another version of Farfield.
    """
    numbers = _layout(level_object)
    views = DirectionGrid(numbers["views"], bool(numbers["views_upper"]))
    lights = DirectionGrid(numbers["lights"], bool(numbers["lights_upper"]))
    components = numbers["components"]
    images = _images_by_label(level_object.data.materials[0].node_tree)

    def pixels(label: str) -> np.ndarray:
        image = images.get(label)
        if image is None or (not image.has_data and not image.packed_files):
            raise GeometryError(f'"{level_object.name}" has lost the image "{label}" of its relightable textures; bake them again.')
        return pixels_of(image)

    tints, openness = np.split(pixels(TINTS), [3], axis=2)

    def weights(label: str, count: int) -> np.ndarray:
        held: dict[str, str] = {}  # of every image, the first node that has it
        for number in range(-(-count // 4)):
            node = f"{label} {number}"
            held.setdefault(images[node].name if node in images else node, node)
        return weights_in([pixels(node) for node in held.values()], tints.shape[0], count)

    known = np.ones(tints.shape[0] * tints.shape[1], bool)
    basis = colour_basis(pixels(BASIS), pixels(DOME), views, lights, numbers["clusters"], components)
    colour = Factors(weights(WEIGHTS, components).reshape(-1, components), basis, known)
    if CLUSTERS in images:
        labels = np.rint(pixels(CLUSTERS)[..., 0]).astype(np.int32).ravel()
        colour = LocalFactors(colour.weights, colour.basis, known, labels)

    def one_column(weight_label: str, basis_label: str, grid: DirectionGrid, count: int) -> Factors:
        return Factors(weights(weight_label, count).reshape(-1, count), one_column_basis(pixels(basis_label), grid, count), known)

    lobes = None
    if DIFFUSE in images:
        lobes = _lobes(*(pixels(label).reshape(-1, 4) for label in (NORMALS, DIFFUSE, SPECULAR)), openness.ravel())
        if RELIEF in images:
            relief = _relief(level_object, pixels(NORMALS), pixels(RELIEF))
            lobes = replace(lobes, surface=replace(lobes.surface, relief=relief))
        lobes = replace(lobes, grazing=Grazing(*level_object.data.materials[0].get(GRAZING, (SCHLICK.strength, SCHLICK.power))))
        if numbers["shadows"]:
            grid = DirectionGrid(numbers["shadows"], bool(numbers["shadows_upper"]))
            lobes = replace(lobes, shadows=Shadows(grid, one_column(SHADOW_WEIGHTS, SHADOW_BASIS, grid, numbers["shadow_components"])))
    plain = pixels(PLAIN)[..., 3] if PLAIN in images else np.zeros(tints.shape[:2], np.float32)
    return BakedAtlas(
        size=(tints.shape[1], tints.shape[0]),
        tints=tints.reshape(-1, 3),
        colour=colour,
        alpha=one_column(ALPHA_WEIGHTS, ALPHA_BASIS, views, numbers["alpha_components"]),
        plain=plain.ravel(),
        views=views,
        lights=lights,
        lobes=lobes,
    )


def is_upper(level_object: bpy.types.Object) -> bool:
    """Whether a level was baked from above the horizon alone; raises like `baked_atlas`."""
    return bool(_layout(level_object)["views_upper"])


def _layout(level_object: bpy.types.Object) -> dict[str, int]:
    """The numbers that tell what the images of a level hold."""
    material = level_object.data.materials[0] if level_object.data.materials else None
    numbers = dict(material.get(LAYOUT, {})) if material is not None else {}
    if not numbers:
        raise GeometryError(f'"{level_object.name}" has no relightable textures; bake them first.')
    if numbers.get("version") != VERSION or not set(LAYOUT_NUMBERS) <= set(numbers):
        raise GeometryError(f'The relightable textures of "{level_object.name}" are of another version of Farfield; bake them again.')
    return numbers


def _lobes(normals: np.ndarray, diffuse: np.ndarray, specular: np.ndarray, openness: np.ndarray) -> Lobes:
    """Lobes out of the pixels (P, 4) of their maps, and of their openness (P,)."""
    return Lobes(Surface(normals_of(normals), diffuse[:, 3]), diffuse[:, :3], specular[:, :3], specular[:, 3], openness=openness)


def _relief(level_object: bpy.types.Object, normals: np.ndarray, depths: np.ndarray) -> Relief:
    """The relief of all pixels of a level, out of the pixels (H, W, 4) of its maps; none where no texel is."""
    texels = texels_of_level(level_object)
    made = relief_of(level_object, texels, normals, depths[texels.pixels[:, 1], texels.pixels[:, 0], 2])
    numbers = texels.numbers.ravel()
    row, column = np.divmod(np.arange(len(numbers)), texels.size[0])
    flat = np.where(numbers >= 0, made.depths[numbers], 0.0)
    return replace(made, pixels=np.column_stack([column, row]), quads=texels.quads[numbers], depths=flat)


def _images_by_label(tree: bpy.types.NodeTree) -> dict[str, bpy.types.Image]:
    """The images of a tree and of the groups in it, by the labels of the nodes that hold them."""
    return {node.label: node.image for node in nodes_in(tree) if node.type == "TEX_IMAGE"}
