"""Scenes whose levels by distance are known, and what a viewport and a render show of them."""

from collections.abc import Iterator, Sequence

import bpy
import mathutils
import numpy as np

from farfield.addon.bridge.distance.assets import AssetSearch
from farfield.addon.bridge.distance.chains import Chain, NewLevel, create_chain
from farfield.addon.bridge.distance.placing import attach_chain
from farfield.addon.compat import enable_nodes

SIZES = [0.0, 0.02, 0.05]  # Of the pixels above which the levels show. With the camera of `add_camera`, 0.001 times the distance:
DISTANCES = [0.0, 20.0, 50.0]


def add_camera(y: float = 0.0) -> bpy.types.Object:
    """Add a camera at (0, y, 0) that looks along the Y axis, with 1,000 pixels of the size 1 at a distance of 1,000."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.angle = camera, 2.0 * float(np.arctan(0.5))
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 1000, 500, 100
    camera.location, camera.rotation_euler = (0.0, y, 0.0), (0.5 * np.pi, 0.0, 0.0)
    return camera


def add_box(name: str, location: Sequence[float] = (0.0, 0.0, 0.0), size: float = 0.5, linked: bool = True) -> bpy.types.Object:
    """Add a cube with a side of `size`, and a material, to the scene or to nothing."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh = bpy.data.meshes.new(name)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh.from_pydata(0.5 * size * np.array(corners), [], faces)
    mesh.materials.append(bpy.data.materials.new(name))
    enable_nodes(mesh.materials[0])
    item = bpy.data.objects.new(name, mesh)
    item.location = location
    if linked:
        bpy.context.scene.collection.objects.link(item)
    return item


def add_scatter(points: Sequence[Sequence[float]], kinds: Sequence[bpy.types.Object], way: str = "separate") -> bpy.types.Object:
    """Add an object whose geometry nodes instance `kinds` in turn at its vertices.

    way: "separate" for the children of a collection, "nested" for a collection with collections, "geometry" for that of one object.
    """
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(points, [], [])
    item = bpy.data.objects.new("Scatter", mesh)
    bpy.context.scene.collection.objects.link(item)
    tree = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    given, result, on_points = (tree.nodes.new(name) for name in ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeInstanceOnPoints"))
    if way == "geometry":
        source = tree.nodes.new("GeometryNodeObjectInfo")
        source.inputs["Object"].default_value = kinds[0]
    else:
        source, collection = tree.nodes.new("GeometryNodeCollectionInfo"), bpy.data.collections.new("Kinds")
        for kind in kinds:
            within = collection
            if way == "nested":
                within = bpy.data.collections.new(f"{kind.name} Parts")
                collection.children.link(within)
            within.objects.link(kind)
        source.inputs["Collection"].default_value = collection
        for name in ("Separate Children", "Reset Children") if way == "separate" else ():
            source.inputs[name].default_value = True
        on_points.inputs["Pick Instance"].default_value = way == "separate"
    tree.links.new(given.outputs[0], on_points.inputs["Points"])
    tree.links.new(source.outputs["Geometry" if way == "geometry" else 0], on_points.inputs["Instance"])
    tree.links.new(on_points.outputs[0], result.inputs[0])
    item.modifiers.new("Scatter", "NODES").node_group = tree
    return item


def attach_levels(
    objects: Sequence[bpy.types.Object], fade_range: float = 0.0, scales: Sequence[float] = (1.0, 1.0, 1.0), max_error: float = 1.0
) -> list[Chain]:
    """Attach chains of three boxes, "<name> 0" to "<name> 2", to the assets that `objects` show.

    scales: of the objects of the levels, whose meshes have the inverse scale.
    """
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    chains = []
    for asset in AssetSearch(scene, bpy.context.evaluated_depsgraph_get()).find(objects):
        levels = []
        for number, (size, scale) in enumerate(zip(SIZES, scales, strict=True)):
            box = add_box(f"{asset.name} {number}", size=0.5 / scale, linked=False)
            levels.append(NewLevel([(box, mathutils.Matrix.Scale(scale, 4))], size, 12))
        chains.append(create_chain(asset.name, "", levels, (asset.low, asset.high), fade_range))
        attach_chain(asset, chains[-1], scene, fade_range, max_error)
    bpy.context.view_layer.update()
    return chains


def list_instances(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield the name and the position, in whole units, of each instance of a mesh."""
    for instance in depsgraph.object_instances:
        if instance.is_instance and instance.object.type == "MESH":
            yield instance.object.name, tuple(round(value) for value in instance.matrix_world.translation)


def shown() -> list[tuple[str, tuple[int, ...]]]:
    """Return what the viewport shows, which never fades."""
    bpy.context.view_layer.update()
    return sorted(list_instances(bpy.context.evaluated_depsgraph_get()))


class RecordingEngine(bpy.types.RenderEngine):
    """A render engine that renders nothing but records what it would have to."""

    bl_idname = "FARFIELD_RECORDING"
    bl_label = "Recording"
    instances: list = []

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Record the instances of the scene as it is evaluated for the render."""
        type(self).instances = sorted(list_instances(depsgraph))


def rendered(named_fading: bool = False) -> list[tuple[str, tuple[int, ...]]]:
    """Return what a render of the current frame has to show. Objects with materials that fade have the names of those without, unless they
    are `named_fading`."""
    bpy.utils.register_class(RecordingEngine)
    try:
        bpy.context.scene.render.engine = RecordingEngine.bl_idname
        bpy.ops.render.render()
    finally:
        bpy.context.scene.render.engine = "CYCLES"
        bpy.utils.unregister_class(RecordingEngine)
    return [(name if named_fading else name.removesuffix(" Fading"), place) for name, place in RecordingEngine.instances]


def describe_file() -> dict[str, object]:
    """Return the names of all data-blocks, and everything about the objects that levels by distance may change."""
    found: dict[str, object] = {}
    for name in ("objects", "meshes", "materials", "images", "collections", "node_groups", "scenes"):
        blocks = (item for item in getattr(bpy.data, name) if getattr(item, "type", "") != "RENDER_RESULT")
        found[name] = sorted((item.name, item.use_fake_user) for item in blocks)
    for item in bpy.data.objects:
        modifiers = [(modifier.name, modifier.show_viewport, modifier.show_render) for modifier in item.modifiers]
        slots = [(slot.link, slot.material.name if slot.material else "") for slot in item.material_slots]
        keys = sorted(item.keys())
        flags = (item.instance_type, item.hide_viewport, item.hide_render)
        places = [collection.name for collection in item.users_collection]
        found[item.name] = (modifiers, slots, keys, flags, places, [tuple(row) for row in item.matrix_basis])
    scene = bpy.context.scene
    own = sorted(set(scene.keys()) - {"cycles", "farfield_distance", "farfield_results"})  # Settings, which Blender 4.5 keeps there.
    found["scene"] = (own, scene.cycles.transparent_max_bounces)
    for material in bpy.data.materials:
        found[f"material {material.name}"] = sorted(node.name for node in material.node_tree.nodes)
    return found


def scattered(part: np.ndarray, triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return copies of a part with vertices (K, 3), turned at random and distributed in a cube with a side of 10."""
    random = np.random.default_rng(0)
    rotations = np.linalg.qr(random.normal(size=(count, 3, 3)))[0]
    rotations *= np.sign(np.linalg.det(rotations))[:, None, None]
    vertices = part @ rotations + random.uniform(0.0, 10.0, (count, 1, 3))
    return vertices.reshape(-1, 3), (len(part) * np.arange(count)[:, None, None] + triangles).reshape(-1, 3)


def square(side: float) -> tuple[np.ndarray, np.ndarray]:
    return side * np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float), np.array([(0, 1, 2), (0, 2, 3)])
