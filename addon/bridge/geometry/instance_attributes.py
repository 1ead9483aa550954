"""Attributes that Geometry Nodes give to instances, which shaders read with Attribute nodes of the type Instancer.

Blender numbers an instance by its place in the geometry or collection that makes it, one number for each geometry within another. The
numbers lead from the object through these to the attributes, which Python has no other way to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from .mesh_arrays import VALUE_KEYS, read_attribute

NO_NUMBER = 2**31 - 1  # Fills the persistent ID of an instance that is made by fewer steps.
BUILT_IN = {"position", "instance_transform", ".reference_index"}
COMPONENTS = {"mesh": "MESH", "volume": "VOLUME", "curves": "CURVES", "pointcloud": "POINTCLOUD", "grease_pencil": "GREASEPENCIL"}

Values = dict[str, tuple[float, ...]]  # By name, one to four numbers each.


@dataclass(frozen=True)
class _Instances:
    """The instances of one geometry.

    Attributes:
        own_count: number of other parts that it shows, which are numbered first.
        values: (N, width) of each attribute, by name.
        reference_indices: (N,) into references.
        references: objects, collections and geometries that are instanced.
    """

    own_count: int
    values: dict[str, np.ndarray]
    reference_indices: np.ndarray
    references: Sequence[bpy.types.Object | bpy.types.Collection | bpy.types.GeometrySet]


class InstanceAttributes:
    """The attributes of the instances in one evaluated scene. Each geometry is read once."""

    def __init__(self) -> None:
        self._read: dict[tuple[int, ...], _Instances | None] = {}

    def find(self, owner: bpy.types.Object, persistent_id: Sequence[int]) -> Values:
        """Return the attributes of an instance that the evaluated object `owner` makes. Inner ones hide those of the instances around
        them, as in renders."""
        numbers = [number for number in reversed(persistent_id) if number != NO_NUMBER]
        return self._find_in_object(owner, numbers, (owner.as_pointer(),))

    def _find_in_object(self, item: bpy.types.Object, numbers: list[int], path: tuple[int, ...]) -> Values:
        if item.instance_type == "COLLECTION" and item.instance_collection is not None:
            return self._find_in_collection(item.instance_collection, numbers, path)
        if item.instance_type != "NONE" or not numbers:
            return {}
        if path not in self._read:
            self._read[path] = _read_instances(item.evaluated_geometry(), item.type)
        return self._find_in_geometry(item, numbers, path)

    def _find_in_collection(self, collection: bpy.types.Collection, numbers: list[int], path: tuple[int, ...]) -> Values:
        objects = collection.all_objects
        if len(numbers) < 2 or numbers[0] >= len(objects):
            return {}
        return self._find_in_object(objects[numbers[0]], numbers[1:], (*path, numbers[0]))

    def _find_in_geometry(self, item: bpy.types.Object, numbers: list[int], path: tuple[int, ...]) -> Values:
        instances = self._read[path]
        if instances is None:
            return {}
        if instances.own_count:  # A number that leads to the instances precedes theirs.
            if numbers[0] < instances.own_count:
                return {}
            numbers = numbers[1:]
        if not numbers or numbers[0] >= len(instances.reference_indices):
            return {}
        number, remaining = numbers[0], numbers[1:]
        values = {name: tuple(array[number].tolist()) for name, array in instances.values.items()}
        reference, inner = instances.references[instances.reference_indices[number]], (*path, number)
        if isinstance(reference, bpy.types.Object):
            return values | self._find_in_object(reference, remaining, inner)
        if isinstance(reference, bpy.types.Collection):
            return values | self._find_in_collection(reference, remaining, inner)
        if not remaining:
            return values
        if inner not in self._read:
            self._read[inner] = _read_instances(reference, "")
        return values | self._find_in_geometry(item, remaining, inner)


def _read_instances(geometry: bpy.types.GeometrySet, object_type: str) -> _Instances | None:
    """Return the instances of a geometry, None if it has none. object_type: of the object that it belongs to, "" if it is instanced."""
    points = geometry.instances_pointcloud()
    if points is None:
        return None
    shown = [name for name, own_type in COMPONENTS.items() if own_type != object_type and getattr(geometry, name) is not None]
    attributes = [item for item in points.attributes if item.name not in BUILT_IN and item.data_type in VALUE_KEYS]
    values = {item.name: np.asarray(read_attribute(item), np.float64).reshape(len(item.data), -1) for item in attributes}
    return _Instances(len(shown), values, read_attribute(points.attributes[".reference_index"]), geometry.instance_references())
