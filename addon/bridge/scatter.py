"""Plants and rocks on the ground of terrains, by geometry nodes that need no extension.

Places are the cells of a grid that is fixed to the terrain, each with random numbers of its own: nothing moves when the camera or the
terrain's meshes change. A ray from above finds the ground of each place. Its steepness, its height and noise decide whether anything
stands there.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import read_node_input, set_node_input
from ..core import plants
from ..core.plants import Model
from ..core.scatter import ScatterSettings
from .active_camera import add_view
from .geometry.geometry_nodes import TREE, GeometryBuilder
from .geometry.mesh_arrays import write_attribute, write_triangles
from .shading.ground import GROUP_NAME
from .shading.node_builder import NodeBuilder, create_node_material, ensure_shared_group, nodes_in
from .shading.solid_view import show_color
from .sky import copy_haze
from .terrain_roots import TerrainRoot, link_collection

NAME, VERSION = "Farfield Scatter", 1
SCATTER_KEY = "farfield_scatter"  # Custom property of the objects: what they scatter.
SHADE = "shade"  # Attribute of vertices: factor of the color.
MAX_SIDE = 420  # Places along a side of the grid around the camera.
FADE_START = 0.6  # Fraction of the distance from which on there is less.
VARIANTS = 4
STEEPNESS_NOISE, FLAT_MARGIN = 0.12, 0.1  # How far noise moves z of normals, and what is added to its upper limit for it.
NO_LIMIT, SNOW_COLOR = 1e6, 0.6  # Heights; and how bright the layer of snow is where it is snow.
SOFT_HEIGHT = 1.5  # By which plants keep away from water, and fade out below the snow.
SOCKETS = (
    ("Geometry", "Geometry"), ("Ground", "Collection"), ("Near", "Collection"), ("Far", "Collection"), ("Far From", "Float"),
    ("Spacing", "Float"), ("Distance", "Float"), ("Density", "Float"), ("Lowest", "Float"), ("Highest", "Float"), ("Flattest", "Float"),
    ("Steepest", "Float"), ("Clump Size", "Float"), ("Clumps", "Float"), ("Align to Ground", "Float"), ("Size", "Float"),
    ("Size Variation", "Float"), ("Seed", "Int"),
)  # fmt: skip


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
        clumps: how much it does, from 0 to 1.
        align: to the ground, from 0, upright, to 1.
        size: factor of the asset's size.
        variation: of sizes, from 0, equal ones, to 1, mostly small ones.
        is_plant: whether it keeps away from water and snow.
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


TUFTS = Layer("Grass", "Grass", 1e6, 0.2, 40.0, 0.9, steepest=0.78, clump_size=3.0, clumps=0.35, align=0.7, variation=0.4)
PATCHES = Layer("Grass Patch", "Grass Patch", 1e6, 0.75, 150.0, 0.8, steepest=0.8, clump_size=9.0, clumps=0.4, align=0.8, variation=0.3)
BUSHES = Layer("Bush", "Far Bush", 60.0, 3.0, 400.0, 0.16, steepest=0.72, clump_size=30.0, clumps=0.9, align=0.2, variation=0.6)
STONES = Layer("Rock", "Far Rock", 40.0, 1.6, 200.0, 0.1, clump_size=14.0, clumps=0.85, size=0.3, variation=0.85, is_plant=False)
DEBRIS = Layer(
    "Rock",
    "Far Rock",
    80.0,
    2.4,
    480.0,
    0.5,
    flattest=0.9,
    steepest=0.6,
    clump_size=25.0,
    clumps=0.6,
    size=1.1,
    variation=0.95,
    is_plant=False,
)
CONIFERS = Layer("Conifer", "Far Conifer", 70.0, 4.2, 850.0, 0.6, steepest=0.74, clump_size=90.0, clumps=0.75, align=0.0, variation=0.45)
DRY_TUFTS = Layer("Grass Patch", "Grass Patch", 1e6, 1.6, 220.0, 0.22, steepest=0.8, clump_size=12.0, clumps=0.7, align=0.8, size=0.6)
KINDS = {
    "meadow": {"Grass": TUFTS, "Grass Patches": PATCHES, "Bushes": BUSHES, "Stones": STONES},
    "forest": {"Conifers": CONIFERS, "Bushes": BUSHES, "Grass": TUFTS, "Grass Patches": PATCHES, "Stones": STONES},
    "rocks": {"Stones": STONES, "Debris": DEBRIS},
    "steppe": {"Dry Tufts": DRY_TUFTS, "Bushes": BUSHES, "Stones": STONES},
}
STONE, GREEN, BARK = (0.2, 0.18, 0.16), (0.09, 0.12, 0.035), (0.07, 0.05, 0.035)  # Scene-linear.
GRASS_BRIGHTNESS, LEAF_BRIGHTNESS = 1.9, 1.7  # Of plants, relative to the ground that shows them from a distance.


@dataclass(frozen=True)
class Ground:
    """What the material of a terrain says about its ground, in the space of the root.

    Attributes:
        grass, leaves, rock: scene-linear colors (3,).
        lowest, highest: heights between which plants grow.
    """

    grass: np.ndarray
    leaves: np.ndarray
    rock: np.ndarray
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
                    usual = {"Grass": GREEN, "Undergrowth": GREEN, "Scree": STONE}
                    colors = [np.array(values.get(layer, color)[:3]) for layer, color in usual.items()]
                    has_snow = max(values.get("Snow", (0.0,))[:3]) > SNOW_COLOR
                    snow = values.get("Snow Height", NO_LIMIT) if has_snow else NO_LIMIT
                    return cls(*colors, values.get("Water Height", -NO_LIMIT) + SOFT_HEIGHT, snow - SOFT_HEIGHT)
        return cls(np.array(GREEN), np.array(GREEN), np.array(STONE), -NO_LIMIT, NO_LIMIT)


def add_scatter(scene: bpy.types.Scene, terrain: TerrainRoot, settings: ScatterSettings, scale: float) -> list[bpy.types.Object]:
    """Scatter what the settings name on a terrain, in place of the same kinds that were there. Returns the objects.

    scale: scene units of a meter.
    """
    layers, ground = KINDS[settings.kind], Ground.of(terrain)
    collection = _find_collection(terrain) or link_collection(scene, f"{terrain.name} Scatter")
    remove_scatter(terrain, layers)
    assets: dict[str, bpy.types.Collection] = {}
    created = []
    for name, layer in layers.items():
        for asset in (layer.near, layer.far):
            if asset not in assets:
                assets[asset] = _create_assets(asset, settings.seed, ground)
        item = bpy.data.objects.new(f"{terrain.name} {name}", bpy.data.meshes.new(name))
        item.parent, item[SCATTER_KEY] = terrain.root, name
        item.hide_select = True
        collection.objects.link(item)
        modifier = item.modifiers.new(NAME, "NODES")
        modifier.node_group = ensure_shared_group(NAME, VERSION, SOCKETS, (("Geometry", "Geometry"),), _fill, tree_type=TREE)
        distance, wanted = layer.distance * settings.distance, layer.density * settings.density
        spacing = max(layer.spacing / max(wanted, 1.0) ** 0.5, 2.0 * distance / MAX_SIDE)
        low, high = (ground.lowest, ground.highest) if layer.is_plant else (ground.lowest - SOFT_HEIGHT, NO_LIMIT)
        values = {
            "Ground": terrain.root.users_collection[0], "Near": assets[layer.near], "Far": assets[layer.far],
            "Far From": layer.far_from * settings.distance * scale, "Spacing": spacing * scale, "Distance": distance * scale,
            "Density": min(wanted, 1.0), "Lowest": low, "Highest": high, "Flattest": layer.flattest, "Steepest": layer.steepest,
            "Clump Size": layer.clump_size * scale, "Clumps": layer.clumps, "Align to Ground": layer.align, "Size": layer.size * scale,
            "Size Variation": layer.variation, "Seed": settings.seed + 17 * len(created),
        }  # fmt: skip
        for socket, value in values.items():
            set_node_input(modifier, socket, value)
        created.append(item)
    copy_haze((material for item in terrain.ground_objects() for material in item.data.materials), find_materials(terrain))
    return created


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


def _create_assets(name: str, seed: int, ground: Ground) -> bpy.types.Collection:
    """Return a new collection of variants of an asset. It is in no scene, so that only its instances are seen."""
    collection = bpy.data.collections.new(name)
    collection[SCATTER_KEY] = name
    leaves = ground.grass * GRASS_BRIGHTNESS if "Grass" in name else ground.leaves * LEAF_BRIGHTNESS
    if "Rock" in name:
        materials = [_create_material(name, ground.rock)]
    else:
        materials = [_create_material(f"{name} Wood", np.array(BARK)), _create_material(name, leaves, is_leaf=True)]
    for variant in range(VARIANTS):
        model = _create_model(name, seed * VARIANTS + variant)
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


def _create_model(name: str, seed: int) -> Model:
    if name == "Grass":
        return plants.grass(seed, 34, 0.13, 0.24)
    if name == "Grass Patch":
        return plants.grass(seed, 260, 0.62, 0.26)
    if name in ("Bush", "Far Bush"):
        return plants.bush(seed, 2000 if name == "Bush" else 260, 1.0)
    if name in ("Conifer", "Far Conifer"):
        return plants.conifer(seed, 0.5 if name == "Conifer" else 0.2)
    return plants.rock(seed, 4 if name == "Rock" else 2)


def _create_material(name: str, color: np.ndarray, is_leaf: bool = False) -> bpy.types.Material:
    """Create a material whose color varies from instance to instance, and by the attribute `SHADE`."""
    material, builder = create_node_material(name)
    random = builder.node("ShaderNodeObjectInfo").outputs["Random"]
    variation = builder.math("ADD", builder.math("MULTIPLY", random, 0.5), 0.75)
    brightness = builder.math("MULTIPLY", builder.attribute(SHADE, is_scalar=True), variation)
    scaled = builder.vector("SCALE", tuple(color.tolist()), brightness)
    if is_leaf:
        dry = builder.vector("MULTIPLY", scaled, (1.35, 1.05, 0.8))
        scaled = builder.mix(builder.math("MULTIPLY", random, 0.5), scaled, dry)
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(scaled, principled.inputs["Base Color"])
    principled.inputs["Roughness"].default_value = 0.6 if is_leaf else 0.9
    principled.inputs["Specular IOR Level"].default_value = 0.25
    if not is_leaf:
        noise, bump = builder.node("ShaderNodeTexNoise"), builder.node("ShaderNodeBump")
        builder.connect(builder.node("ShaderNodeTexCoord").outputs["Object"], noise.inputs["Vector"])
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 7.0, 8.0
        builder.connect(noise.outputs[0], bump.inputs["Height"])
        bump.inputs["Distance"].default_value = 0.12
        builder.connect(bump.outputs[0], principled.inputs["Normal"])
    shader = principled.outputs[0]
    if is_leaf:
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


def _fill(builder: NodeBuilder) -> None:
    builder = GeometryBuilder(builder.tree)
    given = builder.node("NodeGroupInput").outputs
    own = builder.call("GeometryNodeObjectInfo", {"Object": builder.node("GeometryNodeSelfObject").outputs[0]}).outputs["Transform"]
    to_local = builder.call("FunctionNodeInvertMatrix", {0: own}).outputs[0]
    camera = builder.transform_point(add_view(builder).position, to_local)
    ground = builder.call("GeometryNodeCollectionInfo", {0: given["Ground"]}, {"transform_space": "RELATIVE"}).outputs[0]
    ground = builder.call("GeometryNodeRealizeInstances", {0: ground}).outputs[0]
    side = builder.math("DIVIDE", builder.math("MULTIPLY", given["Distance"], 2.0), given["Spacing"])
    side = builder.math("MINIMUM", builder.math("CEIL", side, 0.0), float(MAX_SIDE))
    index = builder.node("GeometryNodeInputIndex").outputs[0]
    row = builder.math("FLOOR", builder.math("DIVIDE", builder.math("ADD", index, 0.5), side), 0.0)
    column = builder.math("SUBTRACT", index, builder.math("MULTIPLY", row, side))
    half = builder.math("FLOOR", builder.math("MULTIPLY", side, 0.5), 0.0)
    cells = []
    for place, axis in zip((column, row), builder.separate(camera)[:2], strict=True):
        center = builder.math("FLOOR", builder.math("DIVIDE", axis, given["Spacing"]), 0.0)
        cells.append(builder.math("ADD", builder.math("SUBTRACT", place, half), center))
    first, second = (_random(builder, cells, builder.math("ADD", given["Seed"], shift)) for shift in (0.25, 0.75))
    x, y = (
        builder.math("MULTIPLY", builder.math("ADD", cell, value), given["Spacing"])
        for cell, value in zip(cells, builder.separate(first)[:2], strict=True)
    )
    bounds = builder.call("GeometryNodeBoundBox", {0: ground}).outputs
    top, bottom = (builder.separate(bounds[name])[2] for name in ("Max", "Min"))
    start = builder.math("ADD", top, 1.0)
    count = builder.math("MULTIPLY", side, side)
    points = builder.call("GeometryNodePoints", {"Count": count, "Position": builder.combine(x, y, start), "Radius": 0.01}).outputs[0]
    length = builder.math("ADD", builder.math("SUBTRACT", start, bottom), 1.0)
    ray = builder.call(
        "GeometryNodeRaycast",
        {"Target Geometry": ground, "Source Position": builder.node("GeometryNodeInputPosition").outputs[0], "Ray Length": length},
    )
    ray.inputs["Ray Direction"].default_value = (0.0, 0.0, -1.0)
    # What is known of each place is stored before the points move to the ground, and some of them are left out.
    values = {"Is Hit": ray.outputs["Is Hit"], "Position": ray.outputs["Hit Position"], "Normal": ray.outputs["Hit Normal"]}
    hit = _capture(builder, points, values | {"First": first, "Second": second})
    first, second = (builder.separate(hit.outputs[name]) for name in ("First", "Second"))
    capture, position, normal = hit.outputs[0], hit.outputs["Position"], hit.outputs["Normal"]
    is_chosen = _choose(builder, given, hit, camera, second[0])
    moved = builder.call("GeometryNodeSetPosition", {"Geometry": capture, "Position": position}).outputs[0]
    kept = builder.call("GeometryNodeSeparateGeometry", {0: moved, 1: is_chosen}, {"domain": "POINT"}).outputs[0]
    up = builder.mix(given["Align to Ground"], (0.0, 0.0, 1.0), normal)
    turned = builder.call("FunctionNodeAlignRotationToVector", {"Vector": up}, {"axis": "Z"}).outputs[0]
    spin = builder.call("FunctionNodeAxisAngleToRotation", {"Angle": builder.math("MULTIPLY", second[1], math.tau)}).outputs[0]
    rotation = builder.call("FunctionNodeRotateRotation", {0: turned, 1: spin}, {"rotation_space": "LOCAL"}).outputs[0]
    smaller = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, builder.math("POWER", second[2], 1.7)), given["Size Variation"])
    size = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.15, smaller), given["Size"])
    distance = builder.vector("LENGTH", builder.vector("SUBTRACT", position, camera))
    is_near = builder.less(distance, given["Far From"])
    join = builder.node("GeometryNodeJoinGeometry")
    variant = builder.math("FLOOR", builder.math("MULTIPLY", first[2], 997.0), 0.0)
    for name, selection in (("Near", is_near), ("Far", builder.boolean("NOT", is_near))):
        assets = builder.call("GeometryNodeCollectionInfo", {0: given[name], 1: True, 2: True}).outputs[0]
        inputs = {"Points": kept, "Selection": selection, "Instance": assets, "Pick Instance": True, "Instance Index": variant}
        instances = builder.call("GeometryNodeInstanceOnPoints", {**inputs, "Rotation": rotation, "Scale": size}).outputs[0]
        builder.tree.links.new(instances, join.inputs[0])
    builder.tree.links.new(join.outputs[0], builder.node("NodeGroupOutput").inputs[0])


def _random(builder: GeometryBuilder, cells: list[bpy.types.NodeSocket], seed: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return a vector of three random numbers of each cell."""
    noise = builder.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "3D"})
    builder.tree.links.new(builder.combine(*cells, seed), noise.inputs["Vector"])
    return noise.outputs["Color"]


def _capture(builder: GeometryBuilder, geometry: bpy.types.NodeSocket, values: dict[str, bpy.types.NodeSocket]) -> bpy.types.Node:
    """Return a node with the geometry and with values of its points that stay when it changes."""
    node = builder.node("GeometryNodeCaptureAttribute", {"domain": "POINT"})
    builder.tree.links.new(geometry, node.inputs[0])
    for name, value in values.items():
        node.capture_items.new("BOOLEAN" if value.type == "BOOLEAN" else "VECTOR", name)
        builder.tree.links.new(value, node.inputs[name])
    return node


def _choose(
    builder: GeometryBuilder,
    given: bpy.types.bpy_prop_collection,
    hit: bpy.types.Node,
    camera: bpy.types.NodeSocket,
    random: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return whether there is something at a place: by the ground there, noise, and the distance to the camera."""
    position = hit.outputs["Position"]
    height, steepness = builder.separate(position)[2], builder.separate(hit.outputs["Normal"])[2]
    is_chosen = hit.outputs["Is Hit"]
    noise = builder.node("ShaderNodeTexNoise")
    builder.tree.links.new(builder.vector("SCALE", position, builder.math("DIVIDE", 1.0, given["Clump Size"])), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, 3.0
    uneven = builder.math("SUBTRACT", noise.outputs[0], 0.5)
    steepness = builder.math("ADD", steepness, builder.math("MULTIPLY", uneven, STEEPNESS_NOISE))
    limits = ((given["Lowest"], height), (height, given["Highest"]), (given["Steepest"], steepness))
    for low, high in limits:
        is_chosen = builder.boolean("AND", is_chosen, builder.less(low, high))
    is_chosen = builder.boolean("AND", is_chosen, builder.less(steepness, builder.math("ADD", given["Flattest"], FLAT_MARGIN)))
    open_part = builder.math("MULTIPLY", builder.math("ADD", builder.math("MULTIPLY", uneven, 6.0), 0.5, True), given["Clumps"])
    weight = builder.math("ADD", builder.math("SUBTRACT", 1.0, given["Clumps"]), open_part)
    offset = builder.vector("MULTIPLY", builder.vector("SUBTRACT", position, camera), (1.0, 1.0, 0.0))
    reached = builder.math("DIVIDE", builder.vector("LENGTH", offset), given["Distance"])
    fade = builder.math("DIVIDE", builder.math("SUBTRACT", 1.0, reached), 1.0 - FADE_START, True)
    probability = builder.math("MULTIPLY", builder.math("MULTIPLY", weight, fade), given["Density"])
    return builder.boolean("AND", is_chosen, builder.less(random, probability))
