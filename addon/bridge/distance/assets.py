"""Assets: what a scene shows once or many times, by objects, linked duplicates, collection instances or geometry nodes.

All places of an asset share its levels of detail.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import bpy
import mathutils
import numpy as np

from ...core.distance.forecasts import Places
from ...core.geometry.transforms import is_invertible, transform_points
from ..geometry.mesh_arrays import count_triangles, read_positions
from ..geometry.meshes import is_collection_instance, may_have_surface
from ..lod_sets import KIND
from ..objects import world_matrix
from .chains import HOST
from .level_switch import level_modifiers
from .particles import SCATTER
from .references import InstancedObjects, find_readers

TYPES = {"MESH", "CURVE", "SURFACE", "FONT"}
# Modifiers that move a surface within its object, or whose purpose needs the mesh.
LIVING = {"ARMATURE", "CLOTH", "SOFT_BODY", "MESH_SEQUENCE_CACHE", "OCEAN", "WAVE", "FLUID", "DYNAMIC_PAINT", "EXPLODE", "COLLISION"}
LIVING |= {"PARTICLE_SYSTEM", "PARTICLE_INSTANCE", "SURFACE_DEFORM", "MESH_DEFORM", "LATTICE", "HOOK", "LAPLACIANDEFORM", "BUILD"}
MIN_OFFSET = 1e-3  # Of bounding boxes that do not count as equal, relative to their size.
MAX_TOLERANCE = 0.2  # Of the bounding box of an asset, relative to its size.
MAX_FRACTION = 0.3  # Of the distance to the nearest bounding box of another object.


@dataclass
class Asset:
    """What levels are made of.

    Attributes:
        name: of the object or collection.
        objects: with its surface; of linked duplicates one.
        frame: from the space of the asset, in which it is placed, to that of its objects.
        hosts: objects that are the asset.
        scatterers: objects whose geometry nodes instance it.
        empties: collection instances of it.
        matrices: of each place, from the space of the asset to the world.
        triangles: at one place.
        low: lowest corner (3,) of the bounding box, in the space of the asset.
        high: highest corner (3,) of the bounding box, in the space of the asset.
        tolerances: by scatterer, how much the bounding box of an instance may differ.
    """

    name: str
    objects: list[bpy.types.Object]
    frame: mathutils.Matrix
    hosts: list[bpy.types.Object] = field(default_factory=list)
    scatterers: list[bpy.types.Object] = field(default_factory=list)
    empties: list[bpy.types.Object] = field(default_factory=list)
    matrices: list[mathutils.Matrix] = field(default_factory=list)
    triangles: int = 0
    low: np.ndarray = field(default_factory=lambda: np.zeros(3))
    high: np.ndarray = field(default_factory=lambda: np.zeros(3))
    tolerances: dict[bpy.types.Object, float] = field(default_factory=dict)

    def measure(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Compute the number of triangles and the bounding box."""
        self.triangles = sum(count_own_triangles(item.evaluated_get(depsgraph)) for item in self.objects)
        self.low, self.high = read_box(self.objects, self.frame, depsgraph)

    @property
    def source(self) -> bpy.types.ID:
        """The object or the collection by which the asset is known."""
        return self.empties[0].instance_collection if self.empties else self.objects[0]

    @property
    def places(self) -> Places:
        """All places, with the bounding box."""
        return Places(np.array([np.array(matrix) for matrix in self.matrices]), self.low, self.high)


class AssetSearch:
    """Finds the assets that objects of a scene show. `skipped` has the names of the objects that are left out, with the reason."""

    def __init__(self, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
        self.skipped: list[str] = []
        self._scene, self._depsgraph = scene, depsgraph
        self._instanced = InstancedObjects(scene, depsgraph)
        self._readers = find_readers(scene.objects)
        self._found: dict[bpy.types.ID, Asset] = {}
        self._shared: dict[tuple, Asset] = {}

    def find(self, objects: Sequence[bpy.types.Object]) -> list[Asset]:
        """Return the assets that `objects` show. The levels of earlier builds must not show while they are read."""
        for item in objects:
            if item.get(KIND) == HOST:
                continue
            if item.get(KIND) not in {None, SCATTER}:
                self._skip(item.name, "made by Farfield")
            elif not item.is_editable:
                self._skip(item.name, "linked from a library; make a library override or make it local")
            elif is_collection_instance(item) or (item.type == "EMPTY" and item.instance_collection is not None):
                self._add_empty(item)
            elif may_have_surface(item):
                self._add_object(item)
        found = [asset for asset in self._found.values() if asset.matrices]
        for asset in found:
            asset.measure(self._depsgraph)
        self._find_tolerances(found)
        return [asset for asset in found if asset.matrices]

    def _add_empty(self, item: bpy.types.Object) -> None:
        collection = item.instance_collection
        if collection is None:
            return
        members = list(collection.all_objects)
        surfaces = [member for member in members if may_have_surface(member) and not member.hide_render]
        reason = next(filter(None, map(self._refuse_shape, surfaces)), "" if surfaces else "no surface")
        if any(member.type == "LIGHT" or is_collection_instance(member) for member in members):
            reason = "its collection has lights or instances"
        if item in self._instanced.objects:
            reason = "it is instanced itself"
        if reason:
            self._skip(item.name, reason)
            return
        frame = mathutils.Matrix.Translation(collection.instance_offset)
        asset = self._found.setdefault(collection, Asset(collection.name, surfaces, frame))
        asset.empties.append(item)
        asset.matrices.append(world_matrix(item))

    def _add_object(self, item: bpy.types.Object) -> None:
        """Add the asset that `item` is, and those that it instances."""
        places = self._instanced.places.get(item, {})
        if places and item.type == "MESH":
            for source, matrices in places.items():
                reason = self._refuse_scatterer(item) or self._refuse_shape(source)
                if reason:
                    self._skip(f"{source.name} in {item.name}", reason)
                    continue
                asset = self._found.setdefault(source, Asset(source.name, [source], world_matrix(source).copy()))
                asset.scatterers.append(item)
                asset.matrices += matrices
        if item in self._instanced.anonymous:
            self._skip(f"instances in {item.name}", "they are of no object")
        if places or item in self._instanced.anonymous or not count_own_triangles(item.evaluated_get(self._depsgraph)):
            return
        reason = self._refuse_shape(item) or self._refuse_host(item)
        if reason:
            self._skip(item.name, reason)
            return
        own_modifiers = [modifier for modifier in item.modifiers if modifier not in level_modifiers(item)]
        identity = (item.data, *(slot.material for slot in item.material_slots), item.pass_index, *item.color)
        asset = None if own_modifiers else self._shared.get(identity)
        if asset is None:
            asset = self._found.setdefault(item, Asset(item.name, [item], world_matrix(item).copy()))
            if not own_modifiers:
                self._shared[identity] = asset
        asset.hosts.append(item)
        asset.matrices.append(world_matrix(item).copy())

    def _refuse_scatterer(self, item: bpy.types.Object) -> str:
        """Return why the instances of an object cannot be replaced, or an empty string."""
        if item in self._instanced.lighting:
            return "it also instances lights, cameras or volumes"
        return "it is instanced itself" if item in self._instanced.objects else ""

    def _refuse_shape(self, item: bpy.types.Object) -> str:
        """Return why no levels can stand for the surface of an object, or an empty string."""
        if item.type not in TYPES:
            return f"levels cannot show a {item.type.lower()}"
        if item.get(KIND) is not None:
            return "made by Farfield"
        living = [modifier.name for modifier in item.modifiers if modifier.type in LIVING]
        if living:
            return f'its modifier "{living[0]}" needs the mesh'
        keys = getattr(item.data, "shape_keys", None)
        if keys is not None and keys.animation_data is not None:
            return "its shape keys are animated"
        if item.particle_systems or item.instance_type != "NONE":
            return "it has particles or instances"
        return "" if is_invertible(np.array(world_matrix(item))) else "its scale is 0 along an axis"

    def _refuse_host(self, item: bpy.types.Object) -> str:
        """Return why the geometry of an object cannot be replaced where it is, or an empty string."""
        if item in self._instanced.objects:
            return "it is instanced elsewhere"
        if item in self._readers:
            return "other objects read its mesh"
        if item.rigid_body is not None and item.rigid_body.collision_shape in {"MESH", "CONVEX_HULL"}:
            return "it is a rigid body with the shape of its mesh"
        return ""

    def _find_tolerances(self, assets: Sequence[Asset]) -> None:
        """Find how much bounding boxes of instances may differ from those of assets, by which geometry nodes recognize them: viewports and
        renders may differ. Remove assets from scatterers that instance another object with the same box."""
        for scatterer in dict.fromkeys(item for asset in assets for item in asset.scatterers):
            boxes = {source: read_box([source], world_matrix(source), self._depsgraph) for source in self._instanced.places[scatterer]}
            for asset in [asset for asset in assets if scatterer in asset.scatterers]:
                size = float(np.linalg.norm(asset.high - asset.low))
                others = [box for source, box in boxes.items() if source != asset.objects[0]]
                offsets = [np.linalg.norm(asset.low - low) + np.linalg.norm(asset.high - high) for low, high in others]
                nearest = min(offsets, default=np.inf)
                asset.tolerances[scatterer] = float(min(MAX_TOLERANCE * size, MAX_FRACTION * nearest))
                if nearest < MIN_OFFSET * size:
                    self._skip(f"{asset.name} in {scatterer.name}", "another object that it instances has the same bounding box")
                    asset.scatterers.remove(scatterer)
                    places = {id(matrix) for matrix in self._instanced.places[scatterer][asset.objects[0]]}
                    asset.matrices = [matrix for matrix in asset.matrices if id(matrix) not in places]

    def _skip(self, name: str, reason: str) -> None:
        self.skipped.append(f"{name} ({reason})")


def read_box(objects: Sequence[bpy.types.Object], frame: mathutils.Matrix, depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner (3,) of the meshes of objects, in the space from which `frame` leads to the world. Blender's own
    bounding box is that of the cage if the mesh is subdivided."""
    corners, inverse = [], frame.inverted_safe()
    for item in objects:
        geometry = item.evaluated_get(depsgraph).evaluated_geometry()
        if geometry.mesh is not None and len(geometry.mesh.vertices):
            corners.append(transform_points(np.array(inverse @ world_matrix(item)), read_positions(geometry.mesh)))
    points = np.concatenate(corners) if corners else np.zeros((1, 3))
    return points.min(axis=0), points.max(axis=0)


def count_own_triangles(evaluated: bpy.types.Object) -> int:
    """Return the number of triangles of an evaluated object itself, without its instances."""
    geometry = evaluated.evaluated_geometry()  # It owns the mesh.
    return 0 if geometry.mesh is None else count_triangles(geometry.mesh)


def visible_objects(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, selected: Iterable[bpy.types.Object]
) -> list[bpy.types.Object]:
    """Return the `selected` objects that may have a surface; without any, all such objects that are visible in viewport and render."""
    chosen = [item for item in selected if may_have_surface(item)]
    if chosen:
        return chosen
    hosts = [item for item in scene.objects if may_have_surface(item) or item.type == "EMPTY"]
    return [item for item in hosts if not item.hide_render and item.visible_get(view_layer=view_layer)]
