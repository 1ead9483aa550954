"""What deforms objects: vertex groups, armatures and shape keys. Levels are made at rest, and deformed like their source."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from scipy.sparse import csr_array

from ..geometry.mesh_arrays import read_positions

FROZEN_TYPES = {"CLOTH", "HOOK", "LATTICE", "MESH_CACHE", "MESH_DEFORM", "MESH_SEQUENCE_CACHE", "SOFT_BODY", "SURFACE_DEFORM"}


@dataclass(frozen=True)
class ShapeKey:
    """A shape key: offsets (V, 3) float32 from the shape that it is relative to, in object space, if its value is 1."""

    name: str
    offsets: np.ndarray


@dataclass(frozen=True)
class Rig:
    """What deforms the V vertices of an evaluated mesh at rest.

    Attributes:
        groups: names of the G vertex groups.
        weights: (V, G), 0 where a vertex is in no group.
        keys: without that of the rest shape.
        basis: the name of the key of the rest shape, "" without shape keys.
        keys_uid: session UID of the shape keys whose values those of levels follow, 0 without.
    """

    groups: tuple[str, ...]
    weights: csr_array
    keys: tuple[ShapeKey, ...]
    basis: str
    keys_uid: int = 0


def find_armatures(item: bpy.types.Object) -> list[bpy.types.ArmatureModifier]:
    """Return the modifiers by which armatures deform an object now."""
    modifiers = [modifier for modifier in item.modifiers if modifier.type == "ARMATURE"]
    return [modifier for modifier in modifiers if modifier.show_viewport and modifier.object is not None]


def find_armature(item: bpy.types.Object) -> bpy.types.Object | None:
    """Return the armature that deforms an object, the last one if there are several."""
    modifiers = find_armatures(item)
    return modifiers[-1].object if modifiers else item.parent if _is_deformed_by_parent(item) else None


def is_animated(item: bpy.types.Object) -> bool:
    """Return whether an object has an action or tracks of actions."""
    animation = item.animation_data
    return animation is not None and (animation.action is not None or bool(animation.nla_tracks))


def has_rig(item: bpy.types.Object) -> bool:
    """Return whether armatures or relative shape keys deform a mesh object."""
    if item.type != "MESH":
        return False
    return bool(find_armatures(item)) or _is_deformed_by_parent(item) or _has_relative_keys(item)


@contextmanager
def at_rest(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Iterator[None]:
    """Show a mesh object without its armatures and shape keys, but with all other modifiers, and update the evaluated scene."""
    armatures, is_child = find_armatures(item), _is_deformed_by_parent(item)
    pin = item.show_only_shape_key, item.active_shape_key_index
    try:
        for modifier in armatures:
            modifier.show_viewport = False
        if is_child:
            item.parent_type = "OBJECT"
            item.update_tag(refresh={"DATA"})
        if _has_relative_keys(item):
            item.show_only_shape_key, item.active_shape_key_index = True, 0
        depsgraph.update()
        yield
    finally:
        for modifier in armatures:
            modifier.show_viewport = True
        if is_child:
            item.parent_type = "ARMATURE"
            item.update_tag(refresh={"DATA"})
        item.show_only_shape_key, item.active_shape_key_index = pin
        depsgraph.update()


def read_rig(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph, to_object: np.ndarray) -> Rig | None:
    """Return what deforms an object that is `at_rest`; None if shape keys change the number of its vertices.

    to_object: (3, 3), from directions in the space of the object to those in the space of its levels.
    """
    data = item.evaluated_get(depsgraph).data
    groups = tuple(group.name for group in item.vertex_groups)
    rows = [(vertex.index, found.group, found.weight) for vertex in data.vertices for found in vertex.groups] if groups else []
    vertices, numbers, values = np.array(rows, np.float64).reshape(-1, 3).T
    is_known = numbers < len(groups)
    entries = values[is_known], (vertices[is_known].astype(np.int64), numbers[is_known].astype(np.int64))
    weights = csr_array(entries, shape=(len(data.vertices), len(groups)))
    if not _has_relative_keys(item):
        return Rig(groups, weights, (), "")
    blocks = item.data.shape_keys.key_blocks
    shapes = [_read_shape(item, index, depsgraph) for index in range(len(blocks))]
    item.active_shape_key_index = 0
    depsgraph.update()
    if len({len(shape) for shape in shapes}) > 1:
        return None
    relative = [shapes[blocks.find(block.relative_key.name)] for block in blocks]
    offsets = [(shape - other) @ to_object.T for shape, other in zip(shapes, relative, strict=True)]
    keys = [ShapeKey(block.name, found) for block, found in zip(blocks, offsets, strict=True)]
    return Rig(groups, weights, tuple(keys[1:]), blocks[0].name, item.data.shape_keys.session_uid)


def _read_shape(item: bpy.types.Object, index: int, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """Return the positions (V, 3) that the shape key `index` alone gives."""
    block = item.data.shape_keys.key_blocks[index]
    is_muted = block.mute
    block.mute, item.active_shape_key_index = False, index
    try:
        depsgraph.update()
        return read_positions(item.evaluated_get(depsgraph).data).astype(np.float64)
    finally:
        block.mute = is_muted


def write_rig(mesh: bpy.types.Mesh, rig: Rig, vertex_weights: csr_array, keys: bpy.types.Key | None) -> None:
    """Write vertex groups and shape keys to the mesh of a level.

    vertex_weights: (N, V), which interpolate values of the source at the vertices of the level. keys: of the source, whose values those
    of the level follow.
    """
    item = bpy.data.objects.new(mesh.name, mesh)
    weights = (vertex_weights @ rig.weights).tocsc()
    for number, name in enumerate(rig.groups):
        column = slice(weights.indptr[number], weights.indptr[number + 1])
        _write_group(item.vertex_groups.new(name=name), weights.indices[column], weights.data[column])
    if rig.basis:
        item.shape_key_add(name=rig.basis, from_mix=False)
        rest = read_positions(mesh).astype(np.float64)
        for key in rig.keys:
            block = item.shape_key_add(name=key.name, from_mix=False)
            block.points.foreach_set("co", (rest + vertex_weights @ key.offsets).astype(np.float32).ravel())
            if keys is not None and key.name in keys.key_blocks:
                _follow_key(block, keys)
    bpy.data.objects.remove(item)


def _write_group(group: bpy.types.VertexGroup, vertices: np.ndarray, weights: np.ndarray) -> None:
    rounded = weights.astype(np.float32)
    order = np.argsort(rounded, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(rounded[order])) + 1):
        if len(part) and rounded[part[0]] > 0.0:
            group.add(vertices[part].tolist(), float(rounded[part[0]]), "REPLACE")


def _follow_key(block: bpy.types.ShapeKey, keys: bpy.types.Key) -> None:
    """Let the value of a key follow that of the same name in `keys`, which sliders, drivers or actions may change."""
    original = keys.key_blocks[block.name]
    block.slider_min, block.slider_max = original.slider_min, original.slider_max
    block.value, block.mute = original.value, original.mute
    driver = block.driver_add("value").driver
    driver.type = "AVERAGE"
    target = driver.variables.new().targets[0]
    target.id_type, target.id, target.data_path = "KEY", keys, f"{original.path_from_id()}.value"


def follow_rig(item: bpy.types.Object, source: bpy.types.Object) -> None:
    """Give the object of a level the armatures of its source."""
    for modifier in find_armatures(source):
        copy = item.modifiers.new(modifier.name, "ARMATURE")
        for setting in modifier.bl_rna.properties:
            if not setting.is_readonly and setting.identifier != "name":
                setattr(copy, setting.identifier, getattr(modifier, setting.identifier))


def moves_with_armature(item: bpy.types.Object) -> bool:
    """Return whether an object has a parent, and an armature deforms or moves it."""
    parent = item.parent
    while parent is not None and parent.type != "ARMATURE":
        parent = parent.parent
    return parent is not None or (item.parent is not None and item.type == "MESH" and bool(find_armatures(item)))


def follow_parent(item: bpy.types.Object, source: bpy.types.Object) -> None:
    """Let an object have the parent of another one, and the same place."""
    item.parent, item.parent_type = source.parent, source.parent_type
    if source.parent_type == "BONE":
        item.parent_bone = source.parent_bone
    if source.parent_type in {"VERTEX", "VERTEX_3"}:
        item.parent_vertices = source.parent_vertices
    item.matrix_parent_inverse, item.matrix_basis = source.matrix_parent_inverse, source.matrix_basis


def describe_frozen(item: bpy.types.Object, rig: Rig | None = None) -> list[str]:
    """Return a sentence if an object is deformed in a way that its levels with `rig` do not follow."""
    reasons: list[str] = []
    if rig is None and (find_armatures(item) or _is_deformed_by_parent(item)):
        reasons.append("its armature")
    if item.type == "MESH" and item.data.shape_keys is not None and (rig is None or not rig.basis):
        reasons.append("its shape keys")
    reasons += [
        f'its modifier "{modifier.name}"' for modifier in item.modifiers if modifier.type in FROZEN_TYPES and modifier.show_viewport
    ]
    return [f'The levels of "{item.name}" have its current shape; they do not follow {_join(reasons)}.'] if reasons else []


def _join(texts: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(texts[:-1]), texts[-1]]))


def _is_deformed_by_parent(item: bpy.types.Object) -> bool:
    return item.parent is not None and item.parent.type == "ARMATURE" and item.parent_type == "ARMATURE"


def _has_relative_keys(item: bpy.types.Object) -> bool:
    keys = item.data.shape_keys
    return keys is not None and keys.use_relative and len(keys.key_blocks) > 1
