"""Objects and what they instance as sources of levels, each mesh once, with all places where it is shown."""

import hashlib
from dataclasses import replace

import bpy
import numpy as np

from ..geometry.evaluated_mesh import EvaluatedMesh
from ..geometry.joined_meshes import find_frame, join_instances
from ..geometry.meshes import SourceInstance, is_collection_instance, read_instances
from .level_sets import Placement
from .rigs import describe_frozen, has_rig
from .sources import TexturedSource, build_textured_source, read_source_at_rest

MAX_INSTANCES = 256  # An object that makes more of them has levels of all together.
PlacedSource = tuple[TexturedSource, Placement]


def read_placed_sources(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[PlacedSource]:
    """Read an object at rest, see `read_source_at_rest`. If it makes instances, by geometry nodes, a collection or particles, return each
    of them, and its own mesh; they share sources.

    Raises:
        GeometryError: see `read_textured_source`.
    """
    instances = read_instances([item], depsgraph)
    if not 1 < len(instances) <= MAX_INSTANCES:
        source = read_source_at_rest(item, depsgraph)
        remarks = (*source.remarks, *_describe_instanced(item))
        return [(replace(source, remarks=remarks), Placement(item.name, item.session_uid))]
    sources: dict[int, TexturedSource] = {}
    placed: list[PlacedSource] = []
    counts: dict[str, int] = {}
    for instance in instances:
        frame = find_frame(instance.matrix)
        is_shared = np.array_equal(frame, instance.matrix)
        source = sources.get(id(instance.mesh)) if is_shared else None
        if source is None:
            source = build_textured_source(item, instance.mesh if is_shared else _shear(instance, frame), _name(item, instance))
            source = replace(source, remarks=(*source.remarks, *describe_frozen(item), *_describe_instanced(item)))
        if is_shared:
            sources[id(instance.mesh)] = source
        counts[instance.part] = number = counts.get(instance.part, -1) + 1
        part = f"{instance.part}.{number:03}" if number else instance.part
        is_own = not instance.part
        placed.append((source, Placement(item.name, item.session_uid, part, None if is_own else frame)))
    return placed


def _name(item: bpy.types.Object, instance: SourceInstance) -> str:
    return f"{item.name} {instance.part}" if instance.part else item.name


def _shear(instance: SourceInstance, frame: np.ndarray) -> EvaluatedMesh:
    """Return the mesh of an instance that is sheared, as objects cannot be, in the space of `frame` (4, 4)."""
    return join_instances([instance], np.linalg.inv(frame))


def _describe_instanced(item: bpy.types.Object) -> list[str]:
    """Return a sentence if an instanced collection has objects that armatures or shape keys deform."""
    is_rigged = is_collection_instance(item) and item.instance_collection and any(map(has_rig, item.instance_collection.all_objects))
    text = (
        f'The levels of "{item.name}" have its current shape; they do not follow armatures and shape keys of the objects in its collection.'
    )
    return [text] if is_rigged else []


class SharedSources:
    """Sources of which no two are equal, such as those of linked duplicates, with all their places."""

    def __init__(self) -> None:
        self._found: dict[bytes, tuple[TexturedSource, list[Placement]]] = {}

    @property
    def sources(self) -> list[TexturedSource]:
        """The sources, in the order in which they were read."""
        return [source for source, _ in self._found.values()]

    @property
    def placements(self) -> list[list[Placement]]:
        """The places of each source."""
        return [placements for _, placements in self._found.values()]

    def read(self, item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> list[Placement]:
        """Add what an object shows, and return where. Raises the errors of `read_placed_sources`."""
        keys: dict[int, bytes] = {}
        placed = read_placed_sources(item, depsgraph)
        for source, placement in placed:
            if id(source) not in keys:
                keys[id(source)] = digest(source)
            known, placements = self._found.get(keys[id(source)], (source, []))
            remarks = tuple(dict.fromkeys((*known.remarks, *source.remarks)))
            self._found[keys[id(source)]] = replace(known, remarks=remarks), [*placements, placement]
        return [placement for _, placement in placed]


def digest(source: TexturedSource) -> bytes:
    """Return a digest that is equal for sources whose levels are equal: mesh, attributes, materials and rig."""
    mesh, rig = source.evaluated, source.rig
    result = hashlib.blake2b()
    for name, attribute in mesh.attributes.items():
        _add(result, (name, attribute.domain), attribute.values)
    arrays = (mesh.vertices, mesh.triangles, mesh.loops, mesh.polygons, mesh.normals, mesh.generated, mesh.material_indices)
    _add(result, (mesh.materials, mesh.uv_map, mesh.color, source.uv_map), *arrays)
    if rig is not None:
        _add(result, (rig.groups, rig.basis, rig.keys_uid), rig.weights.data, rig.weights.indices, rig.weights.indptr)
        for key in rig.keys:
            _add(result, key.name, key.offsets)
    return result.digest()


def _add(result: "hashlib._Hash", label: object, *arrays: np.ndarray) -> None:
    result.update(repr((label, [(array.shape, array.dtype.str) for array in arrays])).encode())
    for array in arrays:
        result.update(np.ascontiguousarray(array).data)
