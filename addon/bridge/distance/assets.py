"""Assets: what a scene shows once or many times, by objects, linked duplicates, collection instances or instances of geometry nodes.

All places of an asset share its levels of detail.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import bpy
import mathutils
import numpy as np

from ...core.geometry.transforms import transform_points
from ..geometry.meshes import is_collection_instance, may_have_surface
from ..lod_sets import KIND
from ..objects import world_matrix

Key = tuple[str, int]  # "object" or "collection", and its session UID


@dataclass
class Asset:
    """What levels are made of.

    Attributes:
        key: identifies it in this session.
        name: of the object or collection.
        objects: with its surface; of linked duplicates one.
        frame: from the space of the asset, in which it is placed, to that of its objects.
        hosts: objects that are the asset.
        scatterers: objects whose geometry nodes instance it.
        empties: collection instances of it.
        count: number of places.
    """

    key: Key
    name: str
    objects: list[bpy.types.Object]
    frame: mathutils.Matrix
    hosts: list[bpy.types.Object] = field(default_factory=list)
    scatterers: list[bpy.types.Object] = field(default_factory=list)
    empties: list[bpy.types.Object] = field(default_factory=list)
    count: int = 0


def find_assets(objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> tuple[list[Asset], list[str]]:
    """Return the assets that `objects` show, and names of what is left out with the reason."""
    found: dict[Key, Asset] = {}
    shared: dict[tuple, Asset] = {}
    skipped: list[str] = []
    for item in objects:
        if item.get(KIND) is not None:
            skipped.append(f"{item.name} (made by Farfield)")
        elif is_collection_instance(item):
            if item.instance_collection is not None and _surfaces(item.instance_collection.all_objects):
                asset = found.setdefault(_key(item.instance_collection), _collection_asset(item.instance_collection))
                asset.empties.append(item)
                asset.count += 1
        elif may_have_surface(item):
            _add_object(item, depsgraph, found, shared, skipped)
    return list(found.values()), skipped


def _add_object(
    item: bpy.types.Object, depsgraph: bpy.types.Depsgraph, found: dict[Key, Asset], shared: dict[tuple, Asset], skipped: list[str]
) -> None:
    """Add the asset that `item` is, and those that it instances."""
    geometry = item.evaluated_get(depsgraph).evaluated_geometry()
    references, points = geometry.instance_references(), geometry.instances_pointcloud()
    if references and item.type == "MESH":
        indices = np.zeros(len(points.points), np.int32)
        points.attributes[".reference_index"].data.foreach_get("value", indices)
        counts = np.bincount(indices, minlength=len(references)).tolist()
        for reference, count in zip(references, counts, strict=True):
            original = getattr(reference, "original", None)
            if isinstance(original, bpy.types.Object) and original.type in {"MESH", "CURVE", "SURFACE", "FONT"}:
                asset = found.setdefault(_key(original), Asset(_key(original), original.name, [original], world_matrix(original).copy()))
            elif isinstance(original, bpy.types.Collection) and _surfaces(original.all_objects):
                asset = found.setdefault(_key(original), _collection_asset(original))
            else:
                skipped.append(f"instances in {item.name} (neither an object nor a collection)")
                continue
            if item not in asset.scatterers:
                asset.scatterers.append(item)
            asset.count += count
    mesh = geometry.mesh
    if mesh is None or not len(mesh.polygons):
        return
    if references:
        skipped.append(f"the surface of {item.name} (it has instances)")
        return
    if any(modifier.type == "ARMATURE" for modifier in item.modifiers):
        skipped.append(f"{item.name} (an armature deforms it)")
        return
    identity = (item.data.session_uid, *(slot.material and slot.material.session_uid for slot in item.material_slots))
    asset = None if item.modifiers else shared.get(identity)
    if asset is None:
        asset = found.setdefault(_key(item), Asset(_key(item), item.name, [item], world_matrix(item).copy()))
        if not item.modifiers:
            shared[identity] = asset
    asset.hosts.append(item)
    asset.count += 1


def _collection_asset(collection: bpy.types.Collection) -> Asset:
    frame = mathutils.Matrix.Translation(collection.instance_offset)
    return Asset(_key(collection), collection.name, _surfaces(collection.all_objects), frame)


def _surfaces(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    return [item for item in objects if may_have_surface(item) and not is_collection_instance(item) and not item.hide_render]


def _key(data_block: bpy.types.ID) -> Key:
    return ("collection" if isinstance(data_block, bpy.types.Collection) else "object", data_block.session_uid)


def bounding_box(asset: Asset, depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner (3,) of an asset in its space, of the boxes of its evaluated objects."""
    inverse = asset.frame.inverted_safe()
    corners = [
        transform_points(np.array(inverse @ world_matrix(item)), np.array(item.evaluated_get(depsgraph).bound_box)) for item in asset.objects
    ]
    points = np.concatenate(corners)
    return points.min(axis=0), points.max(axis=0)
