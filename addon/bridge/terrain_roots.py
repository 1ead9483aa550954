"""Terrains in a scene: an Empty at the root with the settings as custom properties, and mesh objects as its children.

All objects of a terrain have the frame of its root, and vertices are relative to it. The terrain position at the root, its origin, is
stored in double precision.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import bpy
import mathutils
import numpy as np

from ..core.errors import SettingsError
from ..core.geometry.transforms import transform_points
from ..core.geometry.viewers import Viewer
from ..core.json_values import parse_json
from ..core.settings import Settings
from .geometry.mesh_pool import is_local


@dataclass(frozen=True)
class TerrainRoot:
    """A terrain in the scene. References to objects must not be kept while the user works, so it is identified by the name of its root.

    Attributes:
        tool: identifier of the tool, part of the names of custom properties; set by a subclass, like the following two.
        label: what messages call its terrains.
        settings_type: the type of their settings.
        name: of the root.
        library_path: the file that the terrain is linked from, None for a terrain of this file. Both can have terrains of the same name.
    """

    tool: ClassVar[str] = ""
    label: ClassVar[str] = "terrain"
    settings_type: ClassVar[type[Settings]] = Settings

    name: str
    library_path: str | None = None

    @classmethod
    def settings_key(cls) -> str:
        """Return the name of the custom property that has the settings as JSON text."""
        return f"farfield_{cls.tool}_settings"

    @classmethod
    def origin_key(cls) -> str:
        """Return the name of the custom property that has the terrain position at the root."""
        return f"farfield_{cls.tool}_origin"

    @classmethod
    def in_scene(cls, scene: bpy.types.Scene) -> list[Self]:
        """Return all terrains of a scene, linked ones included."""
        return [cls._of_root(item) for item in scene.objects if cls.settings_key() in item]

    @classmethod
    def of_object(cls, item: bpy.types.Object | None) -> Self | None:
        """Return the terrain that an object is the root or a descendant of."""
        while item is not None:
            if cls.settings_key() in item:
                return cls._of_root(item)
            item = item.parent
        return None

    @classmethod
    def _of_root(cls, root: bpy.types.Object) -> Self:
        return cls(root.name, root.library.filepath if root.library is not None else None)

    @classmethod
    def create(cls, scene: bpy.types.Scene, name: str, origin: np.ndarray, settings: Any, display_size: float) -> Self:
        """Create the Empty of a new terrain in a new collection.

        origin: (3,) float64, terrain position at the root. settings: a dataclass of values that JSON can store.
        """
        root = bpy.data.objects.new(name, None)
        root.empty_display_size = display_size
        link_collection(scene, name).objects.link(root)
        root[cls.origin_key()] = origin.tolist()
        root[cls.settings_key()] = json.dumps(asdict(settings))
        return cls(root.name)

    @property
    def root(self) -> bpy.types.Object | None:
        """The Empty at the root, None if it was removed or renamed."""
        item = bpy.data.objects.get((self.name, self.library_path))
        return item if item is not None and self.settings_key() in item else None

    @property
    def read_only_reason(self) -> str:
        """Why its objects cannot be changed, an empty string if they can."""
        if is_local(self.root):
            return ""
        kind = "linked from another file" if self.root.override_library is None else "a library override"
        return f'The terrain "{self.name}" is {kind}; make it local (Object > Relations > Make Local > All)'

    @property
    def origin(self) -> np.ndarray:
        """Terrain position (3,) float64, scene units, at the root.

        Raises:
            SettingsError: the custom property is missing or has another type.
        """
        return self.read_position(self.origin_key())

    @property
    def meter(self) -> float:
        """The length of a meter of its landscape in the space of the root. Raises SettingsError."""
        return 1.0

    def read_position(self, key: str) -> np.ndarray:
        """Return the position (3,) float64 that is stored in a custom property of the root.

        Raises:
            SettingsError: the custom property is missing or has another type.
        """
        try:
            position = np.array(self.root[key], np.float64)
        except (KeyError, TypeError, ValueError):
            position = np.empty(0)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise SettingsError(f'The custom property "{key}" of the terrain "{self.name}" is invalid; create the terrain again.')
        return position

    def input_paths(self) -> list[Path]:
        """Return the files and folders that the terrain is made from.

        Raises:
            FarfieldError: they cannot be found.
        """
        raise NotImplementedError

    @property
    def settings(self) -> Any:
        """The stored settings, of the type `settings_type`.

        Raises:
            SettingsError: they cannot be read, for example because a newer version wrote them.
        """
        try:
            return self.settings_type(**parse_json(self.root[self.settings_key()]))
        except SettingsError as error:
            raise SettingsError(f'The settings of the terrain "{self.name}" are invalid: {error} Create the terrain again.') from error
        except (ArithmeticError, TypeError, ValueError) as error:
            raise SettingsError(f'The settings of the terrain "{self.name}" cannot be read: {error}. Create the terrain again.') from error

    def store_settings(self, settings: Any) -> None:
        """Store settings, a dataclass of values that JSON can store, in the root."""
        self.root[self.settings_key()] = json.dumps(asdict(settings))

    def viewer_position(self, matrix: mathutils.Matrix | np.ndarray) -> np.ndarray:
        """Return the terrain position (3,) float64 of a viewer with the given matrix (4, 4) in world space."""
        return transform_points(self.matrix_to_terrain(), np.array(matrix, np.float64)[:3, 3])

    def matrix_to_terrain(self) -> np.ndarray:
        """Return the matrix (4, 4) float64 from world space to terrain space."""
        matrix = self._inverse_matrix()
        matrix[:3, 3] += self.origin
        return matrix

    def to_terrain_space(self, viewer: Viewer) -> Viewer:
        """Return a viewer in world space as a viewer in terrain space."""
        return viewer.transform(self._inverse_matrix(), self.origin)

    def _inverse_matrix(self) -> np.ndarray:
        """Return the matrix (4, 4) float64 from world space to the frame of the root."""
        return np.array(self.root.matrix_world.inverted_safe(), np.float64)

    def add_child(self, name: str, mesh: bpy.types.Mesh) -> bpy.types.Object:
        """Create an object with the frame of the root, in the collections of the root."""
        root = self.root
        child = bpy.data.objects.new(name, mesh)
        child.parent = root
        soften_terminator(child)
        collections = [collection for collection in root.users_collection if is_local(collection)]
        for collection in collections or [scene.collection for scene in root.users_scene]:
            collection.objects.link(child)
        return child

    def shown_objects(self) -> list[bpy.types.Object]:
        """Return its mesh objects, which moves create and remove: children with a custom property of the tool."""
        prefix = f"farfield_{self.tool}_"
        return [child for child in self.root.children if child.type == "MESH" and any(key.startswith(prefix) for key in child.keys())]  # noqa: SIM118

    def ground_objects(self) -> list[bpy.types.Object]:
        """Return the mesh objects that show its ground."""
        return self.shown_objects()

    def remove_shown(self) -> None:
        """Remove its mesh objects and their meshes, before undo brings back those of an undo step."""
        shown = [child for child in self.shown_objects() if is_local(child)]
        meshes = [child.data for child in shown]
        bpy.data.batch_remove(shown)
        bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0 and is_local(mesh)])

    def link_shown(self) -> None:
        """Link its mesh objects to the collections of the root where undo has not."""
        collections = [collection for collection in self.root.users_collection if is_local(collection)]
        for child in self.shown_objects():
            if is_local(child) and not child.users_collection:
                for collection in collections:
                    collection.objects.link(child)

    def select(self, view_layer: bpy.types.ViewLayer) -> None:
        """Select the root, make it active and deselect everything else."""
        for item in view_layer.objects.selected:
            item.select_set(False, view_layer=view_layer)
        self.root.select_set(True, view_layer=view_layer)
        view_layer.objects.active = self.root


def link_collection(scene: bpy.types.Scene, name: str) -> bpy.types.Collection:
    """Return a new collection of a scene."""
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    return collection


def copy_material(material: bpy.types.Material | None, root: bpy.types.Object) -> bpy.types.Material | None:
    """Return a copy of the material of a terrain for objects that have the frame of its root themselves."""
    if material is None:
        return None
    copy = material.copy()
    for node in copy.node_tree.nodes if copy.node_tree is not None else ():
        if node.type == "TEX_COORD" and node.object == root:
            node.object = None
    return copy


def remove_terrain(terrain: TerrainRoot, children: list[bpy.types.Object]) -> None:
    """Remove a terrain with its mesh objects `children` and, if nothing else is in it, its collection."""
    root = terrain.root
    collections, meshes = root.users_collection, [child.data for child in children]
    bpy.data.batch_remove([*children, root])
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0 and is_local(mesh)])
    for collection in collections:
        if not collection.all_objects and not collection.children and collection in bpy.data.collections.values():
            bpy.data.collections.remove(collection)


def soften_terminator(item: bpy.types.Object) -> None:
    """Let Cycles ignore shadows that coarse triangles cast on themselves and their neighbors near the terminator, where a low light
    is in front of the normals but behind the triangles; they would be dark notches."""
    item.shadow_terminator_geometry_offset = 1.0
