"""Objects that hair particles instance, as instances of geometry nodes, which levels by distance can replace.

They stand where the particles were; the particle systems stay as they are, but are hidden.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import mathutils
import numpy as np

from ..blender import remove_unused_data
from ..geometry.geometry_nodes import TREE, GeometryBuilder
from ..lod_sets import KIND
from ..objects import parent_collection, world_matrix
from .level_switch import level_modifiers

SCATTER = "distance_particles"  # The KIND of objects that instance what particles did.
EMITTER = "farfield_emitter"  # Property of such an object: the object with the particle system.
SYSTEM = "farfield_particle_system"  # The same: name of the particle system.
SHOWN = "farfield_particles_shown"  # The same: whether viewport and render showed it.
TRANSFORM, SOURCE = "farfield_transform", "farfield_source"  # Attributes of its points: relative to the emitter; number of the object.
NAME = "Farfield Particles"

Instances = dict[bpy.types.Object, list[mathutils.Matrix]]
"""Matrices in world space by instanced object."""


def replace_particles(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, objects: Iterable[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Instance by geometry nodes what the hair particles of `objects` instance, hide these particles, and return the objects that do so;
    those of an earlier build are brought up to date."""
    emitters = [item for item in objects if item.is_editable and item.get(KIND) is None and any(_modifiers(item))]
    known = {(host[EMITTER], host[SYSTEM]): host for host in find_scatters(scene)}
    hosts: list[bpy.types.Object] = []
    if not emitters:
        return hosts
    for host in known.values():
        if host[EMITTER] in emitters:
            _show(host)
    with _as_rendered(emitters):
        view_layer.update()
        found = _read_instances(view_layer.depsgraph, set(emitters))
    for (emitter, name), instances in found.items():
        host = known.get((emitter, name)) or _add_host(scene, emitter, name)
        _write(host, instances)
        modifier = _find_modifier(emitter, name)
        host[SHOWN] = [modifier.show_viewport, modifier.show_render]
        modifier.show_viewport = modifier.show_render = False
        hosts.append(host)
    view_layer.update()
    return hosts


def find_scatters(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects of a scene that stand for particles."""
    return [item for item in scene.objects if item.get(KIND) == SCATTER and isinstance(item.get(EMITTER), bpy.types.Object)]


def restore_particles(scene: bpy.types.Scene) -> None:
    """Show the particles again for which no levels stand, and remove what stood for them."""
    for host in [host for host in find_scatters(scene) if not level_modifiers(host)]:
        _show(host)
        trees = [modifier.node_group for modifier in host.modifiers if modifier.type == "NODES" and modifier.node_group is not None]
        bpy.data.batch_remove([host, host.data])
        remove_unused_data(trees)


def _modifiers(item: bpy.types.Object) -> Iterator[bpy.types.Modifier]:
    """Yield the modifiers of particle systems that instance objects and do not move."""
    for modifier in item.modifiers:
        if modifier.type == "PARTICLE_SYSTEM":
            settings = modifier.particle_system.settings
            if settings.type == "HAIR" and settings.render_type in {"OBJECT", "COLLECTION"}:
                yield modifier


def _find_modifier(item: bpy.types.Object, name: str) -> bpy.types.Modifier | None:
    return next((modifier for modifier in _modifiers(item) if modifier.particle_system.name == name), None)


def _show(host: bpy.types.Object) -> None:
    """Show the particles that `host` stands for as before."""
    modifier = _find_modifier(host[EMITTER], host[SYSTEM])
    if modifier is not None:
        modifier.show_viewport, modifier.show_render = map(bool, host[SHOWN])


@contextmanager
def _as_rendered(emitters: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Let viewports show as many particles as renders for a time."""
    settings = {modifier.particle_system.settings for item in emitters for modifier in _modifiers(item)}
    kept = [(each, each.display_percentage, each.child_percent) for each in settings]
    try:
        for each in settings:
            each.display_percentage, each.child_percent = 100, each.rendered_child_count
        yield
    finally:
        for each, percentage, children in kept:
            each.display_percentage, each.child_percent = percentage, children


def _read_instances(depsgraph: bpy.types.Depsgraph, emitters: set[bpy.types.Object]) -> dict[tuple[bpy.types.Object, str], Instances]:
    """Return what each particle system instances; not those that also instance something without a mesh."""
    found: dict[tuple[bpy.types.Object, str], Instances] = {}
    refused = set()
    for instance in depsgraph.object_instances:
        if not instance.is_instance or instance.particle_system is None or instance.parent.original not in emitters:
            continue
        emitter, name = instance.parent.original, instance.particle_system.name
        if _find_modifier(emitter, name) is None:
            continue
        if instance.object.type != "MESH":
            refused.add((emitter, name))
        sources = found.setdefault((emitter, name), {})
        sources.setdefault(instance.instance_object.original, []).append(instance.matrix_world.copy())
    return {key: instances for key, instances in found.items() if key not in refused}


def _add_host(scene: bpy.types.Scene, emitter: bpy.types.Object, name: str) -> bpy.types.Object:
    """Add an object at the place of the emitter, which it follows."""
    host = bpy.data.objects.new(f"{emitter.name} {name}", bpy.data.meshes.new(f"{emitter.name} {name}"))
    host[KIND], host[EMITTER], host[SYSTEM] = SCATTER, emitter, name
    parent_collection(emitter, scene).objects.link(host)
    host.parent, host.hide_select = emitter, True
    host.modifiers.new(NAME, "NODES").node_group = bpy.data.node_groups.new(f"{NAME}: {host.name}", TREE)
    return host


def _write(host: bpy.types.Object, instances: Instances) -> None:
    """Let `host` instance objects at matrices in world space."""
    inverse = world_matrix(host[EMITTER]).inverted_safe()
    matrices = [inverse @ matrix for places in instances.values() for matrix in places]
    mesh = host.data
    mesh.clear_geometry()
    mesh.vertices.add(len(matrices))
    mesh.vertices.foreach_set("co", np.array([matrix.translation for matrix in matrices], np.float32).ravel())
    transforms = np.array([np.array(matrix).T for matrix in matrices], np.float32)  # Columns come first.
    mesh.attributes.new(TRANSFORM, "FLOAT4X4", "POINT").data.foreach_set("value", transforms.ravel())
    numbers = np.repeat(np.arange(len(instances), dtype=np.int32), [len(places) for places in instances.values()])
    mesh.attributes.new(SOURCE, "INT", "POINT").data.foreach_set("value", numbers)
    mesh.update()
    _fill(host.modifiers[NAME].node_group, list(instances))


def _fill(tree: bpy.types.NodeTree, sources: Sequence[bpy.types.Object]) -> None:
    """Let a node tree instance the `sources` at the points that have their numbers."""
    tree.nodes.clear()
    tree.interface.clear()
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    builder = GeometryBuilder(tree)
    points, join = builder.node("NodeGroupInput").outputs[0], builder.node("GeometryNodeJoinGeometry")
    number = builder.call("GeometryNodeInputNamedAttribute", {"Name": SOURCE}, {"data_type": "INT"}).outputs["Attribute"]
    matrix = builder.call("GeometryNodeInputNamedAttribute", {"Name": TRANSFORM}, {"data_type": "FLOAT4X4"}).outputs["Attribute"]
    for index, source in enumerate(sources):
        is_own = builder.less(builder.math("ABSOLUTE", builder.math("SUBTRACT", number, float(index))), 0.5)
        shape = builder.call("GeometryNodeObjectInfo", {"Object": source, "As Instance": True}).outputs["Geometry"]
        placed = builder.call("GeometryNodeInstanceOnPoints", {0: points, 1: is_own, 2: shape}).outputs[0]
        placed = builder.call("GeometryNodeSetInstanceTransform", {0: placed, 2: matrix}).outputs[0]
        tree.links.new(placed, join.inputs[0])
    tree.links.new(join.outputs[0], builder.node("NodeGroupOutput").inputs[0])
