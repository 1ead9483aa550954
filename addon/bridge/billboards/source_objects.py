"""The source objects of a cloud: reading them again, also while they are hidden, and proxies that cross-fade into the cloud.

Proxies are the same evaluated meshes with copies of their materials, since a cross-fade adds a node to materials.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import bpy
import mathutils
import numpy as np

from ...core.errors import FarfieldError, GeometryError
from ...core.geometry.transforms import is_mirroring
from ..geometry import meshes
from ..geometry.instance_attributes import InstanceAttributes
from ..geometry.joined_meshes import find_frame
from ..objects import temporarily_visible, world_matrix
from ..rendering.render_properties import copy_render_properties
from .cloud_materials import create_gray_material
from .clouds import KIND

UNNAMED = re.compile(r"Collection( \d+)?(\.\d+)?")  # The names that Blender gives to collections.
SOURCE_PROXY = "source_proxy"  # Value of farfield_kind.


def read_source_objects(context: bpy.types.Context, sources: Sequence[bpy.types.Object]) -> meshes.Source:
    """Read the geometry of `sources` in the scene of `context`, also of those that are hidden because their cloud is shown instead.

    Raises:
        GeometryError: it cannot be read, or an object is not in the view layer.
    """
    absent = [item.name for item in sources if not meshes.is_in_view_layer(item, context.view_layer)]
    if absent:
        names = ", ".join(absent)
        raise GeometryError(f"The original of the cloud cannot be read: {names} is not in the view layer; include its collection there.")
    with temporarily_visible(context, sources) as depsgraph:
        first = sources[0].evaluated_get(depsgraph).data
        try:
            if len(sources) == 1 and isinstance(first, bpy.types.Mesh) and len(first.vertices) and not len(first.polygons):
                return meshes.read_point_cloud(sources[0])
            return read_combined(list(sources), depsgraph)
        except FarfieldError as error:
            raise GeometryError(f"The original of the cloud cannot be read: {error}") from error


def read_combined(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> meshes.Source:
    """Read `objects` as one source, see `read_source`.

    Several objects have the name and the origin of their nearest common parent, which may be one of them. Without one they have the origin
    of the first object, and the name of the smallest collection of which they are all that can be seen and to which a user has given a
    name, otherwise that of the first.
    """
    source = meshes.read_source(objects, depsgraph)
    read = {instance.object_uid for instance in source.instances}
    items = [item for item in objects if item.session_uid in read]
    if len(items) < 2:
        return source
    parent = _find_common_parent(items)
    if parent is not None:
        return replace(source, name=parent.name, origin=np.array(world_matrix(parent).translation, np.float64))
    return replace(source, name=_find_collection_name(items) or source.name)


def _find_common_parent(items: Sequence[bpy.types.Object]) -> bpy.types.Object | None:
    """Return the nearest object that each of `items` is or has as a parent, also over several generations."""
    chains = []
    for item in items:
        chain = [item]
        while chain[-1].parent is not None:
            chain.append(chain[-1].parent)
        chains.append(chain)
    shared = set(chains[0]).intersection(*chains[1:])
    return next((item for item in chains[0] if item in shared), None)


def _find_collection_name(items: Sequence[bpy.types.Object]) -> str:
    """Return the name of the smallest collection whose visible objects with a surface are `items`, "" if there is none."""
    wanted = set(items)
    names = {}
    for collection in bpy.data.collections:
        members = set(collection.all_objects)
        if UNNAMED.fullmatch(collection.name):
            continue
        if wanted <= members and not any(meshes.may_have_surface(item) and item.visible_get() for item in members - wanted):
            names[len(members)] = names.get(len(members), collection.name)
    return names[min(names)] if names else ""


def add_source_proxies(sources: Sequence[bpy.types.Object], collection: bpy.types.Collection, depsgraph: bpy.types.Depsgraph) -> None:
    """Add proxies of everything that `sources` show to `collection`, evaluated with modifiers, instances and their materials.

    The sources must be visible in `depsgraph`. Instances of the same data share one mesh.
    """
    wanted = {item.name_full for item in sources}
    copied_meshes: dict[tuple[int, bytes], bpy.types.Mesh] = {}
    copies: dict[bpy.types.Material | None, bpy.types.Material] = {}
    instance_attributes = InstanceAttributes()
    for owner, instance in meshes.visible_meshes(wanted, depsgraph):
        evaluated, matrix = instance.object, np.array(instance.matrix_world, np.float64)
        frame = find_frame(matrix)
        within = np.eye(4)
        if not np.array_equal(frame, matrix):  # a matrix that objects without parents cannot have
            within[:3, :3] = matrix[:3, :3]
        key = evaluated.data.as_pointer(), within.tobytes()
        if key not in copied_meshes:
            copied_meshes[key] = _copy_mesh(evaluated, f"{collection.name} {evaluated.name}", depsgraph, copies)
            _transform_mesh(copied_meshes[key], within)
        proxy = bpy.data.objects.new(copied_meshes[key].name, copied_meshes[key])
        if instance.is_instance:  # Shaders read a custom property where an object is not an instance.
            for name, values in instance_attributes.find(instance.parent, instance.persistent_id).items():
                proxy[name] = values
        copy_render_properties(owner, proxy)
        proxy[KIND] = SOURCE_PROXY
        proxy.matrix_world = mathutils.Matrix(frame.tolist())
        collection.objects.link(proxy)


def find_source_proxies(collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Return the proxies in `collection`."""
    return [item for item in collection.objects if item.get(KIND) == SOURCE_PROXY]


def remove_source_proxies(collection: bpy.types.Collection) -> None:
    """Remove the proxies in `collection`, with the meshes and materials that nothing else uses."""
    for item in find_source_proxies(collection):
        mesh = item.data
        bpy.data.objects.remove(item)
        if mesh.users == 0:
            materials = [material for material in mesh.materials if material is not None]
            bpy.data.meshes.remove(mesh)
            for material in dict.fromkeys(materials):
                if material.users == 0:
                    bpy.data.materials.remove(material)


def _copy_mesh(
    evaluated: bpy.types.Object, name: str, depsgraph: bpy.types.Depsgraph, copies: dict[bpy.types.Material | None, bpy.types.Material]
) -> bpy.types.Mesh:
    """Return a copy of the evaluated mesh of `evaluated`, with a copy of each of its materials."""
    slots = [slot.material for slot in evaluated.material_slots]
    mesh = bpy.data.meshes.new_from_object(evaluated, preserve_all_data_layers=True, depsgraph=depsgraph)
    mesh.name = name
    if not mesh.materials:
        mesh.materials.append(None)
    for index, material in enumerate(mesh.materials):
        shown = slots[index] if index < len(slots) else material
        original = None if shown is None else shown.original
        if original not in copies:
            copies[original] = _copy_material(original)
        mesh.materials[index] = copies[original]  # Replaced in place, because clear() assigns all faces to the first slot.
    return mesh


def _transform_mesh(mesh: bpy.types.Mesh, matrix: np.ndarray) -> None:
    """Transform a mesh by a matrix (4, 4); mirrored faces keep their fronts outside."""
    if not np.array_equal(matrix, np.eye(4)):
        mesh.transform(mathutils.Matrix(matrix.tolist()))
        if is_mirroring(matrix):
            mesh.flip_normals()


def _copy_material(material: bpy.types.Material | None) -> bpy.types.Material:
    if material is None:
        return create_gray_material("Farfield Source")
    copy = material.copy()
    copy.use_transparent_shadow = True
    return copy
