"""A valley as an artist would build it from heavy assets: a wood of four species, rocks, houses and props, and a flight through it.

Trees have the geometry of every leaf, houses that of every roof tile, and rocks are like scans. All are generated from a seed, except for
one species and the props, which are files of others. Lengths are meters.
"""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from distance_plants import Model, broadleaf_tree, spruce
from distance_solids import house, rock

from farfield.addon.bridge.geometry.mesh_arrays import read_positions, write_attribute, write_triangles, write_uvs
from farfield.addon.compat import enable_nodes
from lib import environment, scene_files

DATA = environment.ROOT.parent / "shared" / "data"
LENGTH, HALF_WIDTH = 1100.0, 260.0  # Of the part with trees.
CLEARING = 7.0  # Distance of trees from the path.
SPECIES = (0.34, 0.22, 0.34, 0.10)  # Fractions of the trees: two broadleaf trees, a spruce, and the tree with alpha-mapped cards.
ROCKS, ROCK_MESHES, HOUSES, COPIES = 200, 20, 12, 6
PROPS = (  # Files with the height that they get.
    ("ordinary/castle/castle.gltf", 16.0),
    ("ordinary/chopper/chopper.gltf", 3.0),
    ("ordinary/two_cylinder_engine.glb", 1.5),
    ("ordinary/sheen_chair/MixedLightingExample.gltf", 0.9),
    ("hard_surface/CesiumMilkTruck.glb", 2.4),
    ("meshes/stanford_bunny.obj", 2.0),
    ("meshes/max_planck.obj", 2.0),
)
GROUND_CELLS = 320  # Along the length of the ground.
FRAMES, STEP, HEIGHT = 10, 5.0, 6.0  # Of the flight: frames, distance per frame, height above the ground.


@dataclass(frozen=True)
class ValleyOptions:
    """What the valley has. seed: of everything random. trees, rocks, houses, props: numbers of places, of props the number of files."""

    seed: int
    trees: int
    rocks: int
    houses: int
    props: int
    width: int
    samples: int


def build_valley(options: ValleyOptions) -> list[bpy.types.Object]:
    """Build the valley in an empty scene. Returns the objects that are made ready: all but the ground."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    props = [_import_model(DATA / name, height) for name, height in PROPS[: options.props]]
    given_tree = _import_model(DATA / "trees" / "leafy_tree.glb", 7.0)
    scene = bpy.context.scene
    random = np.random.default_rng(options.seed)
    materials = _create_materials()
    bark, leaf, needle, stone, wall, wood, tile, glass = materials
    species = [
        _create_object("Broadleaf", broadleaf_tree(options.seed, 36_000, (1.4, 1.4, 1.4)), [bark, leaf]),
        _create_object("Slender", broadleaf_tree(options.seed + 1, 24_000, (0.9, 0.9, 1.9)), [bark, leaf]),
        _create_object("Spruce", spruce(options.seed), [bark, needle]),
        given_tree,
    ]
    _add_ground(scene)
    ready = _add_trees(scene, species, options.trees, random)
    rocks = [_create_object(f"Rock {index}", rock(options.seed + index), [stone]) for index in range(min(ROCK_MESHES, options.rocks))]
    for index in range(options.rocks):
        position = _on_ground(_off_path(random, 2.5, 0.8 * LENGTH))
        size = float(np.exp(random.uniform(np.log(0.3), np.log(2.5))))
        ready.append(_place(scene, rocks[index % len(rocks)], position - [0.0, 0.0, 0.4 * size], random.uniform(0.0, 6.3), size))
    walls = [wall, wood, tile, glass]
    for index in range(options.houses):
        x = (-1.0) ** index * random.uniform(16.0, 40.0)
        y = 45.0 + 55.0 * index + random.uniform(-10.0, 10.0)
        position = _on_ground(np.array([x + path(y), y])) - [0.0, 0.0, 0.5]
        ready.append(_place(scene, _create_object(f"House {index}", house(options.seed + index), walls), position, random.normal(0.0, 0.4)))
    for prop in props:
        for _ in range(COPIES):
            ready.append(_place(scene, prop, _on_ground(_off_path(random, 4.0, 0.5 * LENGTH, 30.0)), random.uniform(0.0, 6.3)))
    _add_light_and_camera(scene, options)
    return ready


def path(y: np.ndarray | float) -> np.ndarray | float:
    """Return the x coordinate of the path along the valley."""
    return 10.0 * np.sin(y / 90.0)


def height_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of the ground: two slopes with hills."""
    base = 95.0 * np.minimum(np.abs(x - path(y)) / 260.0, 2.0) ** 1.8
    hills = sum(
        size * np.sin(x * np.cos(angle) / length + y * np.sin(angle) / length + angle)
        for size, length, angle in ((2.5, 31.0, 0.4), (1.6, 17.0, 2.0), (0.9, 9.0, 4.4), (0.35, 4.0, 1.1))
    )
    return base + hills * (0.3 + np.minimum(np.abs(x - path(y)) / 40.0, 2.0))


def _on_ground(points: np.ndarray) -> np.ndarray:
    """Return positions (..., 3) on the ground below points (..., 2)."""
    return np.concatenate([points, height_at(points[..., 0], points[..., 1])[..., None]], axis=-1)


def _off_path(random: np.random.Generator, distance: float, length: float, half_width: float = HALF_WIDTH) -> np.ndarray:
    """Return a point (2,) that is farther than `distance` from the path."""
    while True:
        point = np.array([random.uniform(-half_width, half_width), random.uniform(0.0, length)])
        if abs(point[0] - path(point[1])) > distance:
            return point


def _add_ground(scene: bpy.types.Scene) -> None:
    columns = np.linspace(-2.2 * HALF_WIDTH, 2.2 * HALF_WIDTH, GROUND_CELLS + 1)
    x, y = np.meshgrid(columns, np.linspace(-60.0, 1.6 * LENGTH, GROUND_CELLS + 1))
    points = _on_ground(np.stack([x, y], axis=-1)).reshape(-1, 3)
    corner = (np.arange(GROUND_CELLS)[:, None] * (GROUND_CELLS + 1) + np.arange(GROUND_CELLS)).ravel()[:, None]
    across = GROUND_CELLS + 1
    triangles = (corner + [[0, 1, across + 1]], corner + [[0, across + 1, across]])
    mesh = bpy.data.meshes.new("Ground")
    write_triangles(mesh, points, np.concatenate(triangles))
    mesh.shade_smooth()
    mesh.materials.append(_create_material("Ground", (0.09, 0.11, 0.035), 0.9, noise=2.0))
    scene.collection.objects.link(bpy.data.objects.new("Ground", mesh))


def _add_trees(scene: bpy.types.Scene, species: list[bpy.types.Object], count: int, random: np.random.Generator) -> list[bpy.types.Object]:
    """Add a scatter per species."""
    points = np.array([_off_path(random, CLEARING, LENGTH) for _ in range(count)])
    kinds = random.choice(len(species), count, p=SPECIES)
    scatters = []
    for number, kind in enumerate(species):
        scatters.append(add_scatter(kind, _on_ground(points[kinds == number]), (0.7, 1.3)))
        scatters[-1].name = f"{kind.name} Scatter"
        scene.collection.objects.link(scatters[-1])
        for collection in kind.users_collection:
            collection.objects.unlink(kind)
    return scatters


def add_scatter(kind: bpy.types.Object, points: np.ndarray, scales: tuple[float, float] = (1.0, 1.0)) -> bpy.types.Object:
    """Return a new object whose geometry nodes instance `kind` at `points` (N, 3), turned and scaled at random."""
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(points, [], [])
    item = bpy.data.objects.new("Scatter", mesh)
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeInstanceOnPoints", "GeometryNodeObjectInfo")
    given, result, on_points, source = (tree.nodes.new(name) for name in names)
    source.inputs["Object"].default_value, source.inputs["As Instance"].default_value = kind, True
    for seed, (low, high) in enumerate((((0.0, 0.0, 0.0), (0.0, 0.0, 2.0 * np.pi)), ((scales[0],) * 3, (scales[1],) * 3))):
        value = tree.nodes.new("FunctionNodeRandomValue")
        value.data_type = "FLOAT_VECTOR"
        value.inputs["Min"].default_value, value.inputs["Max"].default_value, value.inputs["Seed"].default_value = low, high, seed
        if seed:  # All axes have the same scale.
            length = tree.nodes.new("ShaderNodeSeparateXYZ")
            tree.links.new(value.outputs[0], length.inputs[0])
            tree.links.new(length.outputs[0], on_points.inputs["Scale"])
        else:
            tree.links.new(value.outputs[0], on_points.inputs["Rotation"])
    tree.links.new(given.outputs[0], on_points.inputs["Points"])
    tree.links.new(source.outputs["Geometry"], on_points.inputs["Instance"])
    tree.links.new(on_points.outputs[0], result.inputs[0])
    item.modifiers.new("Scatter", "NODES").node_group = tree
    return item


def _place(scene: bpy.types.Scene, kind: bpy.types.Object, position: np.ndarray, turn: float, scale: float = 1.0) -> bpy.types.Object:
    """Return a new linked duplicate of `kind`."""
    item = kind.copy()
    item.location, item.rotation_euler, item.scale = position.tolist(), (0.0, 0.0, float(turn)), (scale,) * 3
    scene.collection.objects.link(item)
    for collection in list(kind.users_collection):
        collection.objects.unlink(kind)
    return item


def _create_object(name: str, model: Model, materials: list[bpy.types.Material]) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    write_triangles(mesh, model.vertices, model.triangles)
    write_uvs(mesh.uv_layers.new(name="UVMap"), model.uvs)
    write_attribute(mesh, "Tint", "POINT", np.column_stack([model.colors, np.ones(len(model.colors))]))
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", model.materials)
    if len(materials) <= 2:  # Houses have flat faces.
        mesh.shade_smooth()
    return bpy.data.objects.new(name, mesh)


def import_model(path: Path, height: float) -> bpy.types.Object:
    """Replace the scene by a file, and return its meshes as one object of this height, which stands on the origin."""
    scene_files.open_scene(path)
    return _join_imported(bpy.context.scene.objects[:], height)


def _import_model(path: Path, height: float) -> bpy.types.Object:
    """Add the meshes of a file to the data as one object of this height, which stands on the origin."""
    before = set(bpy.data.objects)
    importer = bpy.ops.wm.obj_import if path.suffix == ".obj" else bpy.ops.import_scene.gltf
    importer(filepath=str(path))
    joined = _join_imported([item for item in bpy.data.objects if item not in before], height)
    joined.name = path.stem
    return joined


def _join_imported(imported: list[bpy.types.Object], height: float) -> bpy.types.Object:
    """Join imported meshes to one object of a given height, and remove what else was imported."""
    parts = [item for item in imported if item.type == "MESH" and not item.hide_render]
    for item in bpy.context.scene.objects:
        item.select_set(item in parts)
    bpy.context.view_layer.objects.active = parts[0]
    bpy.ops.object.parent_clear(type="CLEAR_KEEP_TRANSFORM")
    bpy.ops.object.make_single_user(object=True, obdata=True)
    bpy.ops.object.transform_apply()
    if len(parts) > 1:
        bpy.ops.object.join()
    joined = bpy.context.view_layer.objects.active
    positions = read_positions(joined.data)
    low, high = positions.min(axis=0), positions.max(axis=0)
    scale = height / (high[2] - low[2])
    placed = (positions - [*(0.5 * (low + high))[:2], low[2]]) * scale
    joined.data.vertices.foreach_set("co", placed.astype(np.float32).ravel())
    left = [item for item in imported if item not in parts]
    bpy.data.batch_remove(left)
    return joined


def _create_materials() -> list[bpy.types.Material]:
    """Return bark, leaf, needle, stone, wall, wood, tile and glass."""
    return [
        _create_material("Bark", (0.11, 0.07, 0.045), 0.9, noise=9.0),
        _create_material("Leaf", (0.10, 0.21, 0.035), 0.55, attribute_name="Tint", translucent=0.3),
        _create_material("Needle", (0.035, 0.085, 0.03), 0.6, attribute_name="Tint"),
        _create_material("Stone", (0.26, 0.24, 0.21), 0.85, noise=3.0),
        _create_material("Wall", (0.62, 0.54, 0.42), 0.9, attribute_name="Tint"),
        _create_material("Wood", (0.16, 0.09, 0.045), 0.6, attribute_name="Tint"),
        _create_material("Tile", (0.36, 0.11, 0.05), 0.7, attribute_name="Tint"),
        _create_material("Glass", (0.02, 0.025, 0.03), 0.05),
    ]


def _create_material(
    name: str, color: tuple[float, float, float], roughness: float, noise: float = 0.0, attribute_name: str = "", translucent: float = 0.0
) -> bpy.types.Material:
    """Create a material, varied by noise of a scale or by a color attribute, with a translucent part."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    tree = material.node_tree
    surface = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    surface.inputs["Base Color"].default_value, surface.inputs["Roughness"].default_value = (*color, 1.0), roughness
    product = tree.nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    product.inputs[0].default_value = color
    if noise:
        pattern = tree.nodes.new("ShaderNodeTexNoise")
        pattern.inputs["Scale"].default_value, pattern.inputs["Detail"].default_value = noise, 6.0
        ramp = tree.nodes.new("ShaderNodeMapRange")
        ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 0.4, 1.5
        tree.links.new(pattern.outputs[0], ramp.inputs["Value"])
        tree.links.new(ramp.outputs[0], product.inputs[1])
    elif attribute_name:
        attribute = tree.nodes.new("ShaderNodeVertexColor")
        attribute.layer_name = attribute_name
        tree.links.new(attribute.outputs["Color"], product.inputs[1])
    if noise or attribute_name:
        tree.links.new(product.outputs[0], surface.inputs["Base Color"])
    if translucent:
        output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
        translucency, mix = tree.nodes.new("ShaderNodeBsdfTranslucent"), tree.nodes.new("ShaderNodeMixShader")
        mix.inputs[0].default_value = translucent
        tree.links.new(product.outputs[0], translucency.inputs["Color"])
        tree.links.new(surface.outputs[0], mix.inputs[1])
        tree.links.new(translucency.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material


def _add_light_and_camera(scene: bpy.types.Scene, options: ValleyOptions) -> None:
    """Add Sun, sky and the camera of the flight, and set up renders."""
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 4.0, 0.01, (0.9, 0.0, 0.9)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.angle, camera.data.clip_end, camera.rotation_euler = np.radians(50.0), 5000.0, (0.485 * np.pi, 0.0, 0.0)
    for item in (sun, camera):
        scene.collection.objects.link(item)
    for frame in range(1, FRAMES + 1):
        y = 20.0 + STEP * (frame - 1)
        base = height_at(np.array(path(20.0)), np.array(20.0))
        camera.location = (float(path(y)), y, float(base) + HEIGHT)
        camera.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end, scene.camera = 1, FRAMES, camera
    scene.world = bpy.data.worlds.new("Sky")
    enable_nodes(scene.world)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.35, 0.5, 0.8, 1.0)
    scene.render.engine, scene.cycles.samples = "CYCLES", options.samples
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y = options.width, round(options.width * 9 / 16)
    scene.view_settings.view_transform = "Standard"
