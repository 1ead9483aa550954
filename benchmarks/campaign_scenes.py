# ruff: noqa: ARG001 - functions that are chosen at random have the same arguments
"""Random Blender scenes for campaigns: defects, odd names, hidden, excluded and linked objects, modifiers, parents, removed slots."""

import math
from contextlib import suppress
from pathlib import Path
from random import Random

import bpy

import random_inputs
from farfield.addon.compat import enable_nodes

MAX_COORDINATE = 3.0e38  # The largest number of single precision, rounded.
LENGTHS = (0.0, 0.0, 1.0, 5.0, -5.0, 1e4, 1e7, 1e15, 1e30, math.nan, math.inf)
SCALES = (1.0, 1.0, 1.0, 1.0, 2.0, -1.0, 0.0, 1e-6, 1e-30, 1e6, 1e20, math.nan)
MODIFIERS = ("SUBSURF", "MIRROR", "ARRAY", "DECIMATE", "SOLIDIFY", "WIREFRAME", "BOOLEAN", "ARMATURE", "NODES", "PARTICLE_SYSTEM", "BUILD")
OTHER_TYPES = ("CURVE", "FONT", "SURFACE", "META", "EMPTY", "LIGHT", "CAMERA", "LATTICE", "INSTANCE", "VOLUME")


def build_scene(random: Random, folder: Path) -> None:
    """Fill the empty scene that is open. Files of libraries are written to `folder`."""
    scene = bpy.context.scene
    collections = [scene.collection]
    for _ in range(random.choice((0, 0, 1, 2))):
        collection = bpy.data.collections.new(random_inputs.random_name(random))
        random.choice(collections).children.link(collection)
        collections.append(collection)
    objects = [_add_mesh_object(random, random.choice(collections)) for _ in range(random.choice((0, 1, 1, 1, 2, 3)))]
    objects += [_add_other_object(random, random.choice(collections)) for _ in range(random.choice((0, 0, 1, 2)))]
    if random.random() < 0.5:
        scene.camera = _add_camera(random, scene.collection)
    for item in objects:
        for change in random.sample(CHANGES, random.choice((0, 0, 1, 1, 2))):
            change(random, item, objects)
    if objects and random.random() < 0.1:
        _link_from_library(random, random.choice(objects), folder / "library.blend")
    for layer_collection in bpy.context.view_layer.layer_collection.children:
        layer_collection.exclude = random.random() < 0.15
        layer_collection.hide_viewport = random.random() < 0.1
    if random.random() < 0.3:
        scene.world = None
    select_some(random)


def select_some(random: Random) -> None:
    """Select random objects of the view layer, and make one of them active."""
    visible = list(bpy.context.view_layer.objects)
    for item in visible:
        with suppress(RuntimeError):  # hidden objects
            item.select_set(random.random() < 0.7)
    with suppress(RuntimeError):  # not yet, or no longer, in the view layer
        bpy.context.view_layer.objects.active = random.choice(visible) if visible and random.random() < 0.9 else None


def create_mesh(random: Random) -> bpy.types.Mesh:
    """Create a random mesh."""
    mesh, source = bpy.data.meshes.new(random_inputs.random_name(random)), random_inputs.random_mesh(random)
    mesh.from_pydata([[_clamp(number) for number in position] for position in source.vertices], [], source.faces)
    if random.random() < 0.5:
        mesh.validate()
    mesh.update()
    return mesh


def _add_mesh_object(random: Random, collection: bpy.types.Collection) -> bpy.types.Object:
    item = bpy.data.objects.new(random_inputs.random_name(random), create_mesh(random))
    collection.objects.link(item)
    return item


def _add_other_object(random: Random, collection: bpy.types.Collection) -> bpy.types.Object:
    kind, name = random.choice(OTHER_TYPES), random_inputs.random_name(random)
    if kind == "CAMERA":
        return _add_camera(random, collection)
    item = bpy.data.objects.new(name, _create_data(random, kind, name))
    if kind == "INSTANCE":
        item.instance_type, item.instance_collection = "COLLECTION", random.choice([*bpy.data.collections, None])
    try:
        collection.objects.link(item)
    except RuntimeError:  # Blender refuses an instance of the collection that the object would be in, at any depth
        item.instance_collection = None
        collection.objects.link(item)
    return item


def _create_data(random: Random, kind: str, name: str) -> bpy.types.ID | None:
    if kind in ("CURVE", "SURFACE", "FONT"):
        curve = bpy.data.curves.new(name, kind)
        if kind == "FONT":
            curve.body = random.choice(("Text", "", "樹", " "))
        elif kind == "CURVE":
            curve.splines.new("BEZIER").bezier_points.add(2)
            curve.bevel_depth = random.choice((0.0, 0.1))
        return curve
    if kind == "META":
        ball = bpy.data.metaballs.new(name)
        ball.elements.new()
        return ball
    if kind == "LIGHT":
        return bpy.data.lights.new(name, random.choice(("SUN", "POINT", "AREA")))
    return {"LATTICE": bpy.data.lattices.new, "VOLUME": bpy.data.volumes.new}.get(kind, lambda _: None)(name)


def _add_camera(random: Random, collection: bpy.types.Collection) -> bpy.types.Object:
    data = bpy.data.cameras.new(random_inputs.random_name(random))
    data.type = random.choice(("PERSP", "PERSP", "ORTHO", "PANO"))
    data.lens, data.ortho_scale = random.choice((50.0, 1.0, 5000.0)), random.choice((6.0, 0.0, 1e6))
    item = bpy.data.objects.new(random_inputs.random_name(random), data)
    item.location = (0.0, -random.choice((3.0, 10.0, 1000.0, *LENGTHS)), 1.0)
    item.rotation_euler.x = 1.4
    collection.objects.link(item)
    return item


def _move(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    item.location[random.randrange(3)] = _clamp(random.choice(LENGTHS))
    item.scale[random.randrange(3)] = _clamp(random.choice(SCALES))
    item.rotation_euler[random.randrange(3)] = random.choice((0.0, 0.3, 100.0, math.nan))


def _hide(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    attribute = random.choice(("hide_render", "hide_viewport", "hide_select", "visible_camera"))
    setattr(item, attribute, not getattr(item, attribute))
    if random.random() < 0.3:
        with suppress(RuntimeError):  # not in the view layer
            item.hide_set(True)


def _add_material(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    if not hasattr(item.data, "materials"):
        return
    for _ in range(random.randint(1, 3)):
        item.data.materials.append(None if random.random() < 0.25 else _create_material(random))
    if random.random() < 0.3 and item.type == "MESH":
        for polygon in item.data.polygons:
            polygon.material_index = random.randrange(5)
    if random.random() < 0.1:
        item.data.materials.clear()


def _create_material(random: Random) -> bpy.types.Material:
    material = bpy.data.materials.new(random_inputs.random_name(random))
    if random.random() < 0.2:
        return material
    enable_nodes(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next((node for node in nodes if node.type == "BSDF_PRINCIPLED"), None)
    choice = random.randrange(6)
    if choice == 0:
        nodes.clear()
    elif choice == 1 and shader is not None:
        shader.inputs["Base Color"].default_value = [_clamp(random.choice((0.0, 0.5, 1.0, -1.0, 1e30, math.nan))) for _ in range(4)]
    elif choice == 2 and shader is not None:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = random.choice((None, bpy.data.images.new(random_inputs.random_name(random), 8, 8, alpha=True)))
        if texture.image is not None and random.random() < 0.3:
            texture.image.source, texture.image.filepath = "FILE", "//missing/image.png"
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    elif choice == 3 and shader is not None:
        emission = nodes.new("ShaderNodeEmission")
        emission.inputs["Strength"].default_value = random.choice((0.0, 1.0, -1.0, 1e30))
        links.new(emission.outputs["Emission"], next(node for node in nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    return material


def _add_modifier(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    if item.type not in ("MESH", "CURVE", "FONT", "SURFACE"):
        return
    with suppress(TypeError):  # this type of object has no such modifier
        modifier = item.modifiers.new("", random.choice(MODIFIERS))
        if modifier is not None and hasattr(modifier, "object") and random.random() < 0.7:
            modifier.object = random.choice([other for other in objects if other.type == "MESH"] or [None])


def _set_parent(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    parent = random.choice(objects)
    if parent is item or item in (parent.parent, getattr(parent.parent, "parent", None)):
        return
    item.parent = parent
    parent.location.x = random.choice((0.0, 2.0, 1e6))


def _add_layers(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    if item.type != "MESH":
        return
    for _ in range(random.choice((1, 3, 8))):
        item.data.uv_layers.new(name=random_inputs.random_name(random))
    group = item.vertex_groups.new(name=random_inputs.random_name(random))
    group.add([index for index in range(len(item.data.vertices)) if random.random() < 0.5], random.random(), "REPLACE")
    if random.random() < 0.3:
        item.shape_key_add(name="Basis")
    if random.random() < 0.3:
        item.data.attributes.new("normal", "FLOAT_VECTOR", "POINT")


def _rename(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    item.name = random_inputs.random_name(random)


def _use_twice(random: Random, item: bpy.types.Object, objects: list[bpy.types.Object]) -> None:
    """Add an object with the same data, or put the object into a second collection."""
    if random.random() < 0.5:
        bpy.context.scene.collection.objects.link(bpy.data.objects.new(item.name, item.data))
    elif item.name not in bpy.context.scene.collection.objects:
        bpy.context.scene.collection.objects.link(item)


CHANGES = (_move, _move, _hide, _add_material, _add_material, _add_modifier, _set_parent, _add_layers, _rename, _use_twice)


def _link_from_library(random: Random, item: bpy.types.Object, library: Path) -> None:
    """Replace an object by itself, linked from a file or as an override."""
    name = item.name
    bpy.data.libraries.write(str(library), {item})
    bpy.data.objects.remove(item)
    with bpy.data.libraries.load(str(library), link=True) as (_, content):
        content.objects = [name]
    linked = content.objects[0]
    if linked is None:
        return
    bpy.context.scene.collection.objects.link(linked)
    if random.random() < 0.4:
        linked.override_create(remap_local_usages=True)


def _clamp(number: float) -> float:
    return max(-MAX_COORDINATE, min(MAX_COORDINATE, number)) if math.isfinite(number) else number
