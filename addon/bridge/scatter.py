"""Plants and rocks on the ground of terrains, by geometry nodes that need no extension.

Places are the cells of a grid that is fixed to the terrain, each with random numbers of its own: nothing moves when the camera or the
terrain's meshes change. A ray from above finds the ground of each place. Its steepness, its height and noise decide whether anything
stands there.
"""

from collections.abc import Collection
from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import read_node_input, set_node_input
from ..core import plants
from ..core.errors import GeometryError
from ..core.plants import Model
from ..core.scatter import ScatterSettings
from .geometry.mesh_arrays import write_attribute, write_triangles
from .scatter_nodes import MAX_SIDE, NAME, ensure_group
from .shading.ground import GROUP_NAME
from .shading.ground_noise import ramp
from .shading.node_builder import NodeBuilder, create_node_material, nodes_in
from .shading.solid_view import show_color
from .sky import copy_haze
from .terrain_roots import TerrainRoot, link_collection

SCATTER_KEY = "farfield_scatter"  # Custom property of the objects: what they scatter.
VARIANTS = len(plants.BUSH_FORMS)  # Of plants; rocks have more.
SHADE = "shade"  # Attribute of vertices: factor of the color.
NO_LIMIT, SNOW_COLOR = 1e6, 0.6  # Heights; and how bright the layer of snow is where it is snow.
ABOVE_WATER = 0.02  # Meters from water, below which rays have hit its surface.
SOFT_HEIGHT = 1.5  # By which plants keep away from water, and fade out below the snow.


@dataclass(frozen=True)
class Layer:
    """One kind of what is scattered. Lengths are meters.

    Attributes:
        near, far: names of assets, see `_create_assets`; far ones are shown from `far_from` on.
        far_from: distance to the camera.
        spacing: between places.
        distance: to the camera, up to which there are any.
        density: part of the places that have one.
        flattest, steepest: z of the normals of the ground between which there are any.
        clump_size: of noise that leaves gaps.
        clumps: how much it does, from 0 to 1: with 1, two thirds are gaps.
        align: to the ground, from 0, upright, to 1.
        size: of the largest, relative to the asset.
        variation: the smallest are smaller than the largest by this fraction; most are small.
        is_plant: whether it keeps away from water and snow.
        clearance: to the camera, below which there is none.
        sway: angle by which it leans in gusts of a strong wind, radians.
        tilt: range of the angle by which it is tilted, radians.
        reach: distance within which the shape of the ground matters; 0 if it does not.
        debris: how much it keeps to the ground below cliffs and, less, to hillsides, from 0 to 1.
        hollows: how much it keeps to hollows, from 0 to 1.
    """

    near: str
    far: str
    far_from: float
    spacing: float
    distance: float
    density: float
    flattest: float = 1.0
    steepest: float = 0.0
    clump_size: float = 8.0
    clumps: float = 0.5
    align: float = 0.5
    size: float = 1.0
    variation: float = 0.3
    is_plant: bool = True
    clearance: float = 0.0
    sway: float = 0.0
    tilt: float = 0.0
    reach: float = 0.0
    debris: float = 0.0
    hollows: float = 0.0


TUFTS = Layer(
    "Grass", "Grass", 1e6, 0.2, 40.0, 0.9,
    steepest=0.78, clump_size=3.0, clumps=0.35, align=0.7, size=1.25, variation=0.4, sway=0.35,
)  # fmt: skip
PATCHES = Layer(
    "Grass Patch", "Grass Patch", 1e6, 0.75, 150.0, 0.8,
    steepest=0.8, clump_size=9.0, clumps=0.4, align=0.8, size=1.15, variation=0.3, sway=0.3,
)  # fmt: skip
BUSHES = Layer(
    "Bush", "Far Bush", 60.0, 2.2, 400.0, 0.6,
    steepest=0.72, clump_size=26.0, clumps=0.93, align=0.2, size=2.0, variation=0.8, clearance=1.5, sway=0.07, tilt=0.4,
)  # fmt: skip
STONES = Layer(
    "Rock", "Far Rock", 40.0, 1.2, 200.0, 0.5, clump_size=13.0, clumps=0.95, size=1.1, variation=0.89, is_plant=False, tilt=0.6,
)  # fmt: skip
DEBRIS = Layer(
    "Rubble", "Far Rubble", 80.0, 1.9, 395.0, 1.0,
    steepest=0.68, clump_size=20.0, clumps=0.5, align=0.8, size=4.0, variation=0.9, is_plant=False, clearance=3.0, tilt=0.2,
    reach=14.0, debris=1.0,
)  # fmt: skip
CONIFERS = Layer(
    "Conifer", "Far Conifer", 70.0, 4.2, 850.0, 0.6,
    steepest=0.74, clump_size=90.0, clumps=0.75, align=0.0, size=1.25, variation=0.45, clearance=6.0, sway=0.025,
)  # fmt: skip
TREES = Layer(
    "Tree", "Far Tree", 60.0, 4.4, 800.0, 0.9,
    steepest=0.8, clump_size=80.0, clumps=1.0, align=0.0, size=1.9, variation=0.6, clearance=8.0, sway=0.03, reach=30.0, hollows=0.95,
)  # fmt: skip
DRY_TUFTS = Layer(
    "Grass Patch", "Grass Patch", 1e6, 1.6, 220.0, 0.3,
    steepest=0.8, clump_size=12.0, clumps=0.7, align=0.8, size=0.9, variation=0.55, sway=0.3,
)  # fmt: skip
KINDS = {
    "meadow": {"Grass": TUFTS, "Grass Patches": PATCHES, "Bushes": BUSHES, "Trees": TREES, "Stones": STONES, "Debris": DEBRIS},
    "forest": {
        "Conifers": CONIFERS, "Bushes": BUSHES, "Grass": TUFTS, "Grass Patches": PATCHES, "Stones": STONES, "Debris": DEBRIS,
    },
    "rocks": {"Stones": STONES, "Debris": DEBRIS},
    "steppe": {"Dry Tufts": DRY_TUFTS, "Bushes": BUSHES, "Stones": STONES, "Debris": DEBRIS},
}  # fmt: skip
STONE, GREEN, BARK = (0.2, 0.18, 0.16), (0.09, 0.12, 0.035), (0.07, 0.05, 0.035)  # Scene-linear.
# Noise in the color of stones: its wavelength in meters, octaves after the first and their gain; and how high it raises their surface.
STAIN_METERS, STAIN_OCTAVES, STAIN_GAIN, BUMP_METERS = 0.7, 9.0, 0.6, 0.5
GRASS_BRIGHTNESS, LEAF_BRIGHTNESS = 1.9, 2.8  # Of plants, relative to the ground that shows them from a distance.


@dataclass(frozen=True)
class Ground:
    """What the material of a terrain says about its ground, in the space of the root.

    Attributes:
        grass, leaves, rock, layers: scene-linear colors (3,); the last is that of the layers in rock.
        lowest, highest: heights between which plants grow.
    """

    grass: np.ndarray
    leaves: np.ndarray
    rock: np.ndarray
    layers: np.ndarray
    lowest: float
    highest: float

    @classmethod
    def of(cls, terrain: TerrainRoot) -> "Ground":
        """Return the ground of a terrain; with usual colors and without limits if its material is another one."""
        materials = {material for item in terrain.ground_objects() for material in item.data.materials if material is not None}
        for material in materials:
            for node in nodes_in(material.node_tree) if material.node_tree is not None else ():
                if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(GROUP_NAME):
                    values = {socket.name: socket.default_value for socket in node.inputs if not socket.is_linked}
                    usual = {"Grass": GREEN, "Undergrowth": GREEN, "Scree": STONE, "Strata": STONE}
                    colors = [np.array(values.get(layer, color)[:3]) for layer, color in usual.items()]
                    has_snow = max(values.get("Snow", (0.0,))[:3]) > SNOW_COLOR
                    snow = values.get("Snow Height", NO_LIMIT) if has_snow else NO_LIMIT
                    return cls(*colors, values.get("Water Height", -NO_LIMIT) + SOFT_HEIGHT, snow - SOFT_HEIGHT)
        return cls(*map(np.array, (GREEN, GREEN, STONE, STONE)), -NO_LIMIT, NO_LIMIT)


def add_scatter(scene: bpy.types.Scene, terrain: TerrainRoot, settings: ScatterSettings, scale: float) -> list[bpy.types.Object]:
    """Scatter what the settings name on a terrain, in place of the same kinds that were there. Returns the objects.

    scale: scene units of a meter.

    Raises:
        GeometryError: nothing but plants would be left of their ground, since its objects are in no collection of their own.
    """
    surface = _find_ground_collection(scene, terrain)
    layers, ground = KINDS[settings.kind], Ground.of(terrain)
    collection = _find_collection(terrain) or link_collection(scene, f"{terrain.name} Scatter")
    remove_scatter(terrain, layers)
    assets: dict[str, bpy.types.Collection] = {}
    created = []
    for name, layer in layers.items():
        for asset in (layer.near, layer.far):
            if asset not in assets:
                assets[asset] = _create_assets(asset, settings.seed, ground, scale)
        item = bpy.data.objects.new(f"{terrain.name} {name}", bpy.data.meshes.new(name))
        item.parent, item[SCATTER_KEY] = terrain.root, name
        item.hide_select = True
        collection.objects.link(item)
        modifier = item.modifiers.new(NAME, "NODES")
        modifier.node_group = ensure_group(bool(settings.wind and layer.sway))
        distance, wanted = layer.distance * settings.distance, layer.density * settings.density
        spacing = max(layer.spacing / max(wanted, 1.0) ** 0.5, 2.0 * distance / MAX_SIDE)
        low, high = (ground.lowest, ground.highest) if layer.is_plant else (ground.lowest - SOFT_HEIGHT + ABOVE_WATER * scale, NO_LIMIT)
        values = {
            "Ground": surface, "Near": assets[layer.near], "Far": assets[layer.far],
            "Far From": layer.far_from * settings.distance * scale, "Spacing": spacing * scale, "Distance": distance * scale,
            "Density": min(wanted, 1.0), "Lowest": low, "Highest": high, "Flattest": layer.flattest, "Steepest": layer.steepest,
            "Clump Size": layer.clump_size * scale, "Clumps": layer.clumps, "Align to Ground": layer.align, "Size": layer.size * scale,
            "Size Variation": layer.variation, "Seed": settings.seed + 17 * len(created),
            "Clearance": layer.clearance * scale, "Sway": layer.sway * settings.wind, "Meter": scale,
            "Tilt": layer.tilt, "Reach": layer.reach * scale, "Debris": layer.debris, "Hollows": layer.hollows,
        }  # fmt: skip
        for socket, value in values.items():
            set_node_input(modifier, socket, value)
        created.append(item)
    copy_haze((material for item in terrain.ground_objects() for material in item.data.materials), find_materials(terrain))
    return created


def _find_ground_collection(scene: bpy.types.Scene, terrain: TerrainRoot) -> bpy.types.Collection:
    """Return the collection with the ground of a terrain. Raises GeometryError if it is that of the scene, which also holds the plants."""
    for collection in terrain.ground_objects()[0].users_collection:
        if collection != scene.collection and not any(SCATTER_KEY in item for item in collection.all_objects):
            return collection
    raise GeometryError(
        f'Move "{terrain.name}" with its children into a collection of its own: plants and rocks look for their ground there.'
    )


def move_scatter(terrain: TerrainRoot, ground: bpy.types.Collection) -> None:
    """Let what is scattered on a terrain stand on a copy of its ground, without the terrain."""
    for item in find_scatter(terrain):
        item.parent, item.matrix_world = None, terrain.root.matrix_world
        for modifier in item.modifiers:
            if modifier.type == "NODES":
                set_node_input(modifier, "Ground", ground)


def find_scatter(terrain: TerrainRoot) -> list[bpy.types.Object]:
    """Return the objects that scatter on a terrain."""
    return [child for child in terrain.root.children if SCATTER_KEY in child]


def find_materials(terrain: TerrainRoot) -> list[bpy.types.Material]:
    """Return the materials of what is scattered on a terrain."""
    modifiers = [modifier for item in find_scatter(terrain) for modifier in item.modifiers if modifier.type == "NODES"]
    collections = {read_node_input(modifier, name) for modifier in modifiers for name in ("Near", "Far")} - {None}
    meshes = {item.data for collection in collections for item in collection.all_objects if item.type == "MESH"}
    return [material for material in {slot for mesh in meshes for slot in mesh.materials} if material is not None]


def _find_collection(terrain: TerrainRoot) -> bpy.types.Collection | None:
    """Return the collection of what is scattered on a terrain, None if there is none."""
    return next((item.users_collection[0] for item in find_scatter(terrain) if item.users_collection), None)


def remove_scatter(terrain: TerrainRoot, names: Collection[str] | None = None) -> None:
    """Remove what is scattered on a terrain, or only what has one of the `names`, with assets that nothing else uses."""
    found = [item for item in find_scatter(terrain) if names is None or item[SCATTER_KEY] in names]
    meshes = [item.data for item in found]
    collections = {collection for item in found for collection in item.users_collection}
    bpy.data.batch_remove([*found, *meshes])
    unused = [item for item in bpy.data.collections if SCATTER_KEY in item and not item.users and item.library is None]
    assets = [
        item for collection in unused for item in collection.objects if SCATTER_KEY in item and set(item.users_collection) <= set(unused)
    ]
    data = {item.data for item in assets}
    materials = {material for mesh in data for material in mesh.materials if material is not None}
    bpy.data.batch_remove([*unused, *assets])
    bpy.data.batch_remove([mesh for mesh in data if not mesh.users])
    bpy.data.batch_remove([material for material in materials if not material.users])
    if names is None:
        bpy.data.batch_remove([item for item in collections if not item.all_objects and not item.children])


def _create_assets(name: str, seed: int, ground: Ground, scale: float) -> bpy.types.Collection:
    """Return a new collection of variants of an asset. It is in no scene, so that only its instances are seen.

    scale: scene units of a meter.
    """
    collection = bpy.data.collections.new(name)
    collection[SCATTER_KEY] = name
    grass, leaves = ground.grass * GRASS_BRIGHTNESS, ground.leaves * LEAF_BRIGHTNESS
    leaves = grass if "Grass" in name else 0.5 * (grass + leaves) if "Tree" in name else leaves
    if "Rock" in name or "Rubble" in name:
        materials = [_create_rock_material(name, ground, scale)]
    else:
        materials = [_create_material(f"{name} Wood", np.array(BARK)), _create_material(name, leaves, is_leaf=True)]
    for variant, model in enumerate(_create_models(name, seed)):
        mesh = bpy.data.meshes.new(f"{name} {variant + 1}")
        write_triangles(mesh, model.vertices, model.triangles)
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", model.materials.astype(np.int32))
        write_attribute(mesh, SHADE, "POINT", model.shades.astype(np.float32))
        asset = bpy.data.objects.new(mesh.name, mesh)
        asset[SCATTER_KEY] = name
        collection.objects.link(asset)
    return collection


def _create_models(name: str, seed: int) -> list[Model]:
    """Return the variants of an asset, whose places have each of them equally often."""
    is_far, seeds = name.startswith("Far "), range(VARIANTS * seed, VARIANTS * (seed + 1))
    match name.removeprefix("Far "):
        case "Grass":
            return [plants.grass(each, 34, 0.13, 0.24) for each in seeds]
        case "Grass Patch":
            return [plants.grass(each, 260, 0.68, 0.28, 0.6) for each in seeds]
        case "Bush":
            return [plants.bush(each, 260 if is_far else 2000, 1.0, form) for form, each in enumerate(seeds)]
        case "Conifer":
            return [plants.conifer(each, 0.2 if is_far else 0.5) for each in seeds]
        case "Tree":
            return [plants.broadleaf(each, 900 if is_far else 7000) for each in seeds]
        case "Rubble":
            return [plants.rubble(each, 2 if is_far else 4) for each in seeds]
    return [plants.rock(seeds[0], 2 if is_far else 4, form) for form in plants.ROCK_FORMS]


def _create_rock_material(name: str, ground: Ground, scale: float) -> bpy.types.Material:
    """Create the material of stones, whose color and bumps are noise in the scene, so that large stones have as fine details as small ones.

    scale: scene units of a meter.
    """
    material, builder = create_node_material(name)
    random = builder.node("ShaderNodeObjectInfo").outputs["Random"]
    noise = builder.node("ShaderNodeTexNoise")
    builder.connect(builder.node("ShaderNodeNewGeometry").outputs["Position"], noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0 / (STAIN_METERS * scale), STAIN_OCTAVES
    noise.inputs["Roughness"].default_value = STAIN_GAIN
    stains = ramp(builder, builder.math("ADD", noise.outputs[0], builder.multiply_add(random, 0.3, -0.15)), 0.5, 0.12)
    color = builder.mix(stains, tuple(ground.rock.tolist()), tuple(ground.layers.tolist()))
    brightness = builder.math("MULTIPLY", builder.attribute(SHADE, is_scalar=True), builder.multiply_add(random, 0.4, 0.7))
    principled = _add_principled(builder, builder.vector("SCALE", color, brightness), 0.9)
    _add_bumps(builder, principled, noise, BUMP_METERS * scale)
    builder.connect(principled.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()
    show_color(material, (*ground.rock.tolist(), 1.0))
    return material


def _add_principled(builder: NodeBuilder, color: bpy.types.NodeSocket, roughness: float) -> bpy.types.Node:
    """Return a Principled BSDF with dull highlights."""
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(color, principled.inputs["Base Color"])
    principled.inputs["Roughness"].default_value, principled.inputs["Specular IOR Level"].default_value = roughness, 0.25
    return principled


def _add_bumps(builder: NodeBuilder, principled: bpy.types.Node, noise: bpy.types.Node, distance: float) -> None:
    """Let noise raise the surface by up to `distance`, scene units."""
    bump = builder.node("ShaderNodeBump")
    builder.connect(noise.outputs[0], bump.inputs["Height"])
    bump.inputs["Distance"].default_value = distance
    builder.connect(bump.outputs[0], principled.inputs["Normal"])


def _create_material(name: str, color: np.ndarray, is_leaf: bool = False) -> bpy.types.Material:
    """Create a material of wood or leaves whose color varies from instance to instance, and by the attribute `SHADE`."""
    material, builder = create_node_material(name)
    random = builder.node("ShaderNodeObjectInfo").outputs["Random"]
    variation = builder.math("ADD", builder.math("MULTIPLY", random, 0.5), 0.75)
    brightness = builder.math("MULTIPLY", builder.attribute(SHADE, is_scalar=True), variation)
    scaled = builder.vector("SCALE", tuple(color.tolist()), brightness)
    if is_leaf:
        dry = builder.vector("MULTIPLY", scaled, (1.35, 1.05, 0.8))
        scaled = builder.mix(builder.math("MULTIPLY", random, 0.5), scaled, dry)
    principled = _add_principled(builder, scaled, 0.6 if is_leaf else 0.9)
    shader = principled.outputs[0]
    if not is_leaf:
        noise = builder.node("ShaderNodeTexNoise")
        builder.connect(builder.node("ShaderNodeTexCoord").outputs["Object"], noise.inputs["Vector"])
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 7.0, 8.0
        _add_bumps(builder, principled, noise, 0.12)
    else:
        translucent, mix = builder.node("ShaderNodeBsdfTranslucent"), builder.node("ShaderNodeMixShader")
        builder.connect(scaled, translucent.inputs["Color"])
        mix.inputs[0].default_value = 0.35
        builder.connect(shader, mix.inputs[1])
        builder.connect(translucent.outputs[0], mix.inputs[2])
        shader = mix.outputs[0]
    builder.connect(shader, builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()
    show_color(material, (*color.tolist(), 1.0))
    return material
