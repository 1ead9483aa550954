"""Which objects a scene instances, where, and which objects others read the mesh of."""

from collections.abc import Iterable

import bpy
import mathutils
import numpy as np

from ..geometry.mesh_arrays import read_positions
from .level_switch import level_modifiers

WITHOUT_SURFACE = {"LIGHT", "LIGHT_PROBE", "CAMERA", "SPEAKER", "VOLUME"}


class InstancedObjects:
    """The instances that the depsgraph of a scene has.

    objects: that are instanced, by whatever. places: of the instances of each object that the geometry nodes of another one make, in world
    space. anonymous: objects with instances of geometry that is that of no object. lighting: objects with instances of lights and the like.
    """

    def __init__(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        empties = [item.instance_collection for item in scene.objects if item.instance_collection is not None]
        self.objects = {member for collection in empties for member in collection.all_objects}
        self.places: dict[bpy.types.Object, dict[bpy.types.Object, list[mathutils.Matrix]]] = {}
        self.anonymous: set[bpy.types.Object] = set()
        self.lighting: set[bpy.types.Object] = set()
        self._by_mesh: dict[tuple[int, str], bpy.types.Object | None] = {}
        self._depsgraph = depsgraph
        for instance in depsgraph.object_instances:
            if instance.is_instance:
                self._add(instance)

    def _add(self, instance: bpy.types.DepsgraphObjectInstance) -> None:
        parent, source = instance.parent.original, instance.instance_object.original
        if source == parent:
            mesh = instance.object.data
            if parent.type != "MESH" or not isinstance(mesh, bpy.types.Mesh):
                return  # Curves and texts show their own surface like that.
            source = self._find_source(mesh)
            if source is None:
                self.anonymous.add(parent)
                return
        else:
            self.objects.add(source)
        if instance.object.type in WITHOUT_SURFACE:
            self.lighting.add(parent)
        if parent.instance_type == "NONE" and not parent.particle_systems and instance.object.type == "MESH":
            self.places.setdefault(parent, {}).setdefault(source, []).append(instance.matrix_world.copy())

    def _find_source(self, mesh: bpy.types.Mesh) -> bpy.types.Object | None:
        """Return the object with this evaluated mesh, which geometry nodes have read."""
        key = (len(mesh.vertices), mesh.name)
        if key not in self._by_mesh:
            positions = read_positions(mesh)
            self._by_mesh[key] = next((item for item in bpy.data.objects if self._has_positions(item, positions)), None)
        return self._by_mesh[key]

    def _has_positions(self, item: bpy.types.Object, positions: np.ndarray) -> bool:
        evaluated = item.evaluated_get(self._depsgraph) if item.type == "MESH" else None
        is_alike = evaluated is not None and len(evaluated.data.vertices) == len(positions)
        return is_alike and np.allclose(read_positions(evaluated.data), positions, atol=1e-6 * max(np.ptp(positions), 1e-6))


def find_readers(objects: Iterable[bpy.types.Object]) -> set[bpy.types.Object]:
    """Return those of `objects` whose mesh geometry nodes or modifiers of other objects may read."""
    users = bpy.data.user_map(subset=list(objects))
    return {item for item, found in users.items() if any(_may_read(user, item) for user in found)}


def _may_read(user: bpy.types.ID, item: bpy.types.Object) -> bool:
    if isinstance(user, bpy.types.GeometryNodeTree):
        return True
    if not isinstance(user, bpy.types.Object) or user == item:
        return False
    own = level_modifiers(user)
    modifiers = [modifier for modifier in user.modifiers if modifier not in own]
    return any(user.parent != item or modifier.type == "NODES" or _refers_to(modifier, item) for modifier in modifiers)


def _refers_to(modifier: bpy.types.Modifier, item: bpy.types.Object) -> bool:
    pointers = [prop.identifier for prop in modifier.bl_rna.properties if prop.type == "POINTER"]
    return any(getattr(modifier, name) == item for name in pointers)
