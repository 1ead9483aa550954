"""A level of a cloud that wears relightable textures, and the lamps that light it."""

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ..core.btf.compression import Compressed
from ..core.btf.factors import Factors
from ..core.btf.lobes import SCHLICK, Lobes, Surface, normals_of
from ..core.btf.lpca import LocalFactors
from ..core.btf.relief import Relief, axes_of
from ..core.btf.settings import BtfSettings
from ..core.btf.shadows import Shadows
from ..core.btf.tables import Tables, tables_of, weight_images
from ..core.btf.texels import Quads, Texels, texels_of
from ..core.images import dilate, nearest_known
from .btf_materials import AMBIENT, SUNS, BtfImages, btf_material, light_property, sun_labels, sun_property
from .cloud_materials import FRONT_COLOUR, FRONT_NORMAL, FRONT_SURFACE
from .clouds import allow_transparent_bounces
from .fades import wear_fade
from .images import data_image, pixels_of
from .relief_nodes import write_axes

PLAIN_MATERIAL = "farfield_plain_material"  # on the level object: name of the material with the plain maps
DILATED = 3  # texels around what is known
ROOM = 8  # transparent surfaces of the rest of a scene


def texels_of_level(level_object: bpy.types.Object) -> Texels:
    """The texels under the quads of a level object, in world space as the cloud was made (its object is only moved)."""
    return texels_of(quads_of_level(level_object), tuple(level_object["farfield_atlas"]))


def quads_of_level(level_object: bpy.types.Object) -> Quads:
    """The polygons of a level object, in world space as the cloud was made (its object is only moved)."""
    mesh = level_object.data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", positions)
    uvs = np.empty(2 * len(mesh.loops), np.float32)
    mesh.attributes["UVMap"].data.foreach_get("vector", uvs)
    world = positions.reshape(-1, 3).astype(np.float64) + np.array(level_object.matrix_world.translation, np.float64)
    size = np.array(level_object["farfield_atlas"], np.float64)
    corners, places = [], []
    for polygon in mesh.polygons:
        loops = slice(polygon.loop_start, polygon.loop_start + polygon.loop_total)
        corners.append(world[list(polygon.vertices)])
        places.append(uvs.reshape(-1, 2)[loops] * size)
    return Quads(corners, places)


def plain_alpha(level_object: bpy.types.Object, texels: Texels) -> np.ndarray:
    """The coverage (N,) float32 of texels in the plain maps of a level; 0 where it has none."""
    image = _plain_image(level_object, FRONT_COLOUR)
    if image is None:
        return np.zeros(len(texels), np.float32)
    return pixels_of(image)[texels.pixels[:, 1], texels.pixels[:, 0], 3]


def plain_surface(level_object: bpy.types.Object, texels: Texels) -> Surface | None:
    """Normals and roughness of texels in the plain maps of a level; None where it has none."""
    images = [_plain_image(level_object, label) for label in (FRONT_NORMAL, FRONT_SURFACE)]
    if None in images:
        return None
    normal_map, surface_map = map(pixels_of, images)
    normals, surface = (pixels[texels.pixels[:, 1], texels.pixels[:, 0]] for pixels in (normal_map, surface_map))
    return Surface(normals_of(normals), surface[:, 0], relief_of(level_object, texels, normal_map, surface[:, 2]))


def relief_of(level_object: bpy.types.Object, texels: Texels, normals: np.ndarray, depths: np.ndarray) -> Relief:
    """The relief of the texels of a level, out of the pixels (H, W, 4) of its normal map and its `depths` (N,) as their map holds them."""
    axes = axes_of(texels, float(level_object["farfield_error"]))
    unit = normals_of(normals.reshape(-1, normals.shape[2])).reshape(*normals.shape[:2], 3)
    return Relief(texels.pixels, texels.quads, axes, 2.0 * depths - 1.0, unit)


def plain_material(level_object: bpy.types.Object) -> bpy.types.Material | None:
    """The material with the plain maps of a level, whether it wears it or relightable textures."""
    return bpy.data.materials.get(level_object.get(PLAIN_MATERIAL, "")) or level_object.data.materials[0]


def _plain_image(level_object: bpy.types.Object, label: str) -> bpy.types.Image | None:
    """The image of the plain maps in the node called `label`."""
    plain = plain_material(level_object)
    nodes = plain.node_tree.nodes if plain is not None and plain.node_tree is not None else []
    return next((node.image for node in nodes if node.type == "TEX_IMAGE" and node.label == label), None)


def wear(level_object: bpy.types.Object, texels: Texels, textures: Compressed, settings: BtfSettings) -> None:
    """Give a level object the material that decodes `textures` of its `texels`; its plain material stays in the file.

    Their alpha is what the silhouette from a view has more than that of the plain maps; the normals of their lobes must be those of the
    plain maps.
    """
    colour, alpha, lobes = textures.colour, textures.alpha, textures.lobes
    shadows = None if lobes is None else lobes.shadows
    tables = tables_of(colour, alpha, settings.view_grid, settings.light_grid, shadows)
    name = f"{level_object.name} BTF"
    known = texels.image(colour.known[:, None].astype(np.float32))[..., 0]
    weights, clusters = _weights_of(colour, texels, known)
    images = BtfImages(
        weights=_weight_images(f"{name} Weights", weights),
        clusters=None if clusters is None else _half_image(f"{name} Clusters", np.repeat(clusters[..., None], 4, axis=2)),
        tints=_colour_image(f"{name} Tints", textures.hues, None if lobes is None else lobes.openness, texels, known),
        glow=None if textures.glow is None else _colour_image(f"{name} Glow", textures.glow, None, texels, known),
        basis=_half_image(f"{name} Basis", tables.basis),
        dome=_half_image(f"{name} Dome", tables.dome.image),
        alpha_weights=_weight_images(f"{name} Alpha Weights", texels.image(alpha.weights)),
        alpha_basis=_half_image(f"{name} Alpha", tables.alpha.image),
        plain=_plain_image(level_object, FRONT_COLOUR),
        **_lobe_images(level_object, name, texels, lobes, known),
        **_shadow_images(name, texels, shadows, tables, known),
    )
    if images.relief is not None:
        write_axes(level_object.data, lobes.surface.relief.axes)
    material = btf_material(name, images, tables, settings.blend_texels)
    plain = level_object.data.materials[0]
    if plain is not None and PLAIN_MATERIAL not in level_object:
        plain.use_fake_user = True
        level_object[PLAIN_MATERIAL] = plain.name
    level_object.data.materials[0] = material
    for number in range(SUNS):
        level_object[sun_property(number)] = [0.0, 0.0, 1.0]
        level_object[light_property(number)] = [0.0, 0.0, 0.0]
    level_object[AMBIENT] = [0.0, 0.0, 0.0]
    wear_fade(level_object)


def _colour_image(name: str, colours: np.ndarray, fourth: np.ndarray | None, texels: Texels, known: np.ndarray) -> bpy.types.Image:
    """The image of `colours` (N, 3) with a `fourth` number (N,), 1 where it is None, continued around what is `known` (H, W)."""
    fourth = np.ones(len(colours), np.float32) if fourth is None else fourth
    return _half_image(name, dilate(texels.image(np.column_stack([colours, fourth])), known, DILATED))


def _weight_images(name: str, weights: np.ndarray) -> list[bpy.types.Image]:
    """Images of `weights` (H, W, K), see `weight_images`."""
    return [_half_image(f"{name} {number}", image) for number, image in enumerate(weight_images(weights))]


def _lobe_images(level_object: bpy.types.Object, name: str, texels: Texels, lobes: Lobes | None, known: np.ndarray) -> dict[str, Any]:
    if lobes is None:
        return {**dict.fromkeys(("diffuse", "specular", "normals", "relief")), "grazing": SCHLICK}
    diffuse, specular = (
        dilate(texels.image(np.column_stack(parts)), known, DILATED)
        for parts in ((lobes.diffuse, lobes.surface.roughness), (lobes.specular, lobes.rim))
    )
    return {
        "diffuse": _half_image(f"{name} Diffuse", diffuse),
        "specular": _half_image(f"{name} Specular", specular),
        "normals": _plain_image(level_object, FRONT_NORMAL),
        "relief": None if lobes.surface.relief is None else _plain_image(level_object, FRONT_SURFACE),
        "grazing": lobes.grazing,
    }


def _shadow_images(name: str, texels: Texels, shadows: Shadows | None, tables: Tables, known: np.ndarray) -> dict[str, Any]:
    if shadows is None:
        return {"shadow_weights": [], "shadow_basis": None}
    weights = dilate(texels.image(shadows.angles.weights), known, DILATED)
    return {
        "shadow_weights": _weight_images(f"{name} Shadow Weights", weights),
        "shadow_basis": _half_image(f"{name} Shadow", tables.shadow.image),
    }


def _weights_of(colour: Factors, texels: Texels, known: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Images of the weights (H, W, K) and of cluster numbers (H, W), in all pixels; None where there is one set of components for all.

    Weights of different clusters do not mix: what is not `known` (H, W) takes both from the nearest texel that is.
    """
    weights = texels.image(colour.weights)
    if not isinstance(colour, LocalFactors):
        return dilate(weights, known, DILATED), None
    nearest = nearest_known(known > 0.0)
    return weights[nearest], texels.image(colour.labels[:, None].astype(np.float32))[..., 0][nearest]


def let_through(collection: bpy.types.Collection, stacked: int) -> None:
    """Let rays pass so many quads behind each other, in all scenes that show `collection`: Cycles turns black what they cannot pass.

    A scene that allows more keeps what it has.
    """
    for scene in bpy.data.scenes:
        if collection in scene.collection.children_recursive:
            allow_transparent_bounces(scene, stacked + ROOM)


def take_off(level_object: bpy.types.Object) -> None:
    """Give a level its plain material back; the relightable one goes, with its drivers."""
    light_with(level_object, (), (0.0, 0.0, 0.0))
    baked = level_object.data.materials[0]
    plain = bpy.data.materials.get(level_object[PLAIN_MATERIAL])
    level_object.data.materials[0] = plain
    for name in (AMBIENT, PLAIN_MATERIAL, *(name(number) for number in range(SUNS) for name in (sun_property, light_property))):
        del level_object[name]
    if plain is not None:
        plain.use_fake_user = False
    wear_fade(level_object)
    if baked is not None and baked.users == 0:
        bpy.data.materials.remove(baked)


def light_with(level_object: bpy.types.Object, suns: Sequence[bpy.types.Object], ambient: Sequence[float]) -> None:
    """Let up to four sun lamps light a level, by drivers, and a dome of the colour `ambient` (three numbers, radiance)."""
    for number in range(SUNS):
        for name in (sun_property(number), light_property(number)):
            level_object.driver_remove(f'["{name}"]')
        if number >= len(suns):
            level_object[light_property(number)] = [0.0, 0.0, 0.0]
            continue
        for axis in range(3):
            _drive(level_object, sun_property(number), axis, suns[number], {"value": f"matrix_world[2][{axis}]"}, "value")
            _drive(
                level_object,
                light_property(number),
                axis,
                suns[number],
                {"colour": f"data.color[{axis}]", "strength": "data.energy"},
                "colour * strength",
            )
    level_object[AMBIENT] = [float(value) for value in ambient]
    _decode_only(level_object.data.materials[0], len(suns))


def _decode_only(material: bpy.types.Material, suns: int) -> None:
    """Mute what decodes the suns from number `suns` on: renderers would work out what is then multiplied by no light."""
    idle = {label for number in range(suns, SUNS) for label in sun_labels(number)}
    for node in material.node_tree.nodes:
        if node.type == "GROUP" and node.label:
            node.mute = node.label in idle


def _drive(level_object: bpy.types.Object, name: str, axis: int, sun: bpy.types.Object, paths: dict[str, str], expression: str) -> None:
    """One number of a custom property as a formula of what `paths` of the sun say."""
    driver = level_object.driver_add(f'["{name}"]', axis).driver
    driver.type = "SCRIPTED"
    for key, path in paths.items():
        variable = driver.variables.new()
        variable.name = key
        variable.targets[0].id = sun
        variable.targets[0].data_path = path
    driver.expression = expression


def _half_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    return data_image(name, pixels, is_data=True, half_floats=True)
