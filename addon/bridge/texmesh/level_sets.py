"""Levels of detail of a textured mesh in a scene: one collection with the objects of all levels, found by their custom properties.

Level 0 is the source as it was evaluated. A level shows where a pixel is larger than its error, in units of the object.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from ...core.geometry.cameras import Camera, distance_to_box
from ...core.geometry.transforms import mean_scale, transform_points
from .. import lod_crossfade
from ..blender import remove_unused_data
from ..geometry.joined_meshes import find_frame
from ..geometry.mesh_arrays import count_triangles
from ..geometry.mesh_pool import is_local
from ..imaging.images import find_images
from ..lod_sets import ERROR, KIND, NUMBER, LodSet, set_hidden
from ..objects import parent_collection, world_matrix
from ..rendering import render_properties
from ..rendering.render_properties import copy_render_properties
from ..shading.solid_view import show_color_image
from ..source_links import store_sources
from .rigs import follow_parent, follow_rig, moves_with_armature
from .temporary_visibility import restore

LEVEL = "texmesh_level"  # the KIND of the objects
IMAGE = "texmesh_image"  # the KIND of images that are removed with the levels: those of billboard clouds
TRIANGLES = "farfield_triangles"
SURFACE_DISTANCE = "farfield_surface_distance"  # in units of the object, see `NewLevel`
SWITCH_DISTANCE = "farfield_switch_distance"  # in units of the object, for the display that the levels were made for
MATERIAL = "farfield_material"  # property of the copy of a material: the name of the original
PART = "farfield_part"  # Property of the collection: what the source instances, "" for its own mesh.
FIGURES = "farfield_texmesh_figures"  # Property of the collection: JSON about how the levels were made.


@dataclass(frozen=True)
class NewLevel:
    """A level to be added.

    Attributes:
        mesh: the level.
        error: the size of a pixel above which it shows, in object units, 0 for the finest.
        surface_distance: no point of it is farther from the original, in object units.
        switch_distance: from the camera, in object units, 0 for the finest.
    """

    mesh: bpy.types.Mesh
    error: float
    surface_distance: float
    switch_distance: float


class LevelSet(LodSet):
    """The levels of one object. `errors` are the pixel sizes above which each shows, in units of the objects; 0 for the finest."""

    kind = LEVEL

    @property
    def source(self) -> bpy.types.Object | None:
        """The object that the levels were made from, also under another name; None if it does not exist any more."""
        return next(iter(self.sources), None)

    @property
    def source_name(self) -> str:
        """The name of the source, or its stored name."""
        return next(iter(self.source_names), "")

    @property
    def label(self) -> str:
        """The name of the source, with that of what it instances."""
        return " ".join(filter(None, [self.source_name or self.collection.name, str(self.collection.get(PART, ""))]))

    @property
    def is_editable(self) -> bool:
        """Whether the levels can be changed: not if they are linked from a library."""
        return is_local(self.collection) and all(is_local(level) for level in self.levels)

    def hide_source(self, hidden: bool) -> None:
        """Hide the source in viewports and renders, or show it, unless it is linked from a library or does not exist any more."""
        source = self.source
        if source is not None and source.is_editable:
            set_hidden(source, hidden)

    def add_crossfade(self, scene: bpy.types.Scene, fade_range: float) -> None:
        """Cross-fade all levels for the active camera, over `fade_range`, a fraction of the switch distance."""
        self.remove_crossfade()
        ends = [*self.errors[1:], lod_crossfade.MAX_PIXEL]
        for number, (level, end) in enumerate(zip(self.levels, ends, strict=True)):
            lod_crossfade.add_crossfade(level, self.errors[number] if number else lod_crossfade.MIN_PIXEL, end, fade_range)
            set_hidden(level, False)
        render_properties.ensure_transparent_bounces(scene, 8 * len(self.levels))

    def remove_crossfade(self) -> None:
        """Let every level show at any distance, and end a temporary visibility."""
        restore([*self.levels, self.source])
        for level in self.levels:
            others = _find_sharing(level)
            is_used = any(map(lod_crossfade.is_fading, others))
            lod_crossfade.remove_crossfade(level, () if is_used else level.data.materials)
            if others:  # They may cross-fade now or later, with the same materials.
                lod_crossfade.show_always(level)

    def choose_level(self, camera: Camera) -> int:
        """Return the index of the coarsest level whose error is at most a pixel of `camera` at the nearest point of the object."""
        low, high, scale = self.bounds()
        pixel = camera.pixel_size(distance_to_box(camera.position, low, high)) / scale
        return max(number for number, error in enumerate(self.errors) if number == 0 or error <= pixel)

    def show(self, number: int) -> None:
        """Show one level and hide the others. Removes a cross-fade."""
        self.remove_crossfade()
        for index, level in enumerate(self.levels):
            set_hidden(level, index != number)

    def bounds(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the lowest and highest corner of the bounding box in world space, and the scale of the objects."""
        level = self.levels[0]
        matrix = np.array(world_matrix(level), np.float64)
        corners = transform_points(matrix, level.bound_box)
        return corners.min(axis=0), corners.max(axis=0), float(mean_scale(matrix)) or 1.0


level_sets_in, find_level_set, read_level_set = LevelSet.in_scene, LevelSet.find, LevelSet.read


@dataclass(frozen=True)
class Placement:
    """Where levels are.

    Attributes:
        name: of the object that they were made from.
        object_uid: its session UID.
        part: what it instances, "" for its own mesh.
        matrix: (4, 4), of an instance to the world; None to be where the object is.
    """

    name: str
    object_uid: int
    part: str = ""
    matrix: np.ndarray | None = None

    @property
    def label(self) -> str:
        """The name of the levels."""
        return f"{self.name} {self.part}" if self.part else self.name


def add_materials(levels: Sequence[NewLevel], materials: Sequence[bpy.types.Material | None]) -> None:
    """Give the meshes of levels copies of the `materials` of their slots, so that a cross-fade leaves those of the source as they are."""
    copies = [None if material is None else _copy_material(material) for material in materials]
    for level in levels:
        for material in copies:
            level.mesh.materials.append(material)


def add_level_set(
    source: bpy.types.Object,
    levels: Sequence[NewLevel],
    collection: bpy.types.Collection,
    placement: Placement | None = None,
) -> LevelSet:
    """Add an object per level to a new `collection`: at the position of the source, or at that of its instance. Sets may share meshes."""
    placement = placement or Placement(source.name, source.session_uid)
    objects = []
    for number, level in enumerate(levels):
        item = bpy.data.objects.new(f"{placement.label} L{number}", level.mesh)
        if placement.matrix is None:
            _place(item, source)
        else:
            item.matrix_world = mathutils.Matrix(placement.matrix.tolist())
        item[KIND], item[NUMBER], item[ERROR] = LEVEL, number, float(level.error)
        item[SWITCH_DISTANCE], item[TRIANGLES] = float(level.switch_distance), count_triangles(level.mesh)
        item[SURFACE_DISTANCE] = float(level.surface_distance)
        copy_render_properties(source, item)
        collection.objects.link(item)
        objects.append(item)
    store_sources(collection, [source])
    collection[PART] = placement.part
    return LevelSet(collection, objects)


def add_collections(source: bpy.types.Object, scene: bpy.types.Scene, labels: Sequence[str]) -> list[bpy.types.Collection]:
    """Return new collections for levels of a source, next to it; several are in one for all of them."""
    parent = parent_collection(source, scene)
    if len(labels) > 1:
        group = bpy.data.collections.new(f"{source.name} Levels")
        group[KIND] = LEVEL
        parent.children.link(group)
        parent = group
    collections = [bpy.data.collections.new(f"{label} Levels") for label in labels]
    for collection in collections:
        parent.children.link(collection)
    return collections


def _place(item: bpy.types.Object, source: bpy.types.Object) -> None:
    """Put the object of a level where its source is, and let armatures move and deform it like that."""
    follow_rig(item, source)
    matrix = np.array(source.matrix_world)
    frame = find_frame(matrix)
    if moves_with_armature(source) and np.array_equal(frame, matrix):
        follow_parent(item, source)
    else:
        item.matrix_world = mathutils.Matrix(frame.tolist())


def remove_level_set(levels: LevelSet) -> None:
    """Remove the objects, meshes, materials and images of levels that nothing else uses, and their collection if it is empty then."""
    restore([levels.source])
    data = [level.data for level in levels.levels]
    materials = [material for mesh in data for material in mesh.materials if material is not None]
    images = [image for image in find_images(materials) if image.get(KIND) == IMAGE]
    bpy.data.batch_remove(levels.levels)
    remove_unused_data(data, materials, images)
    groups = [item for item in bpy.data.collections if item.get(KIND) == LEVEL and levels.collection.name in item.children]
    for collection in (levels.collection, *groups):
        if not collection.objects and not collection.children:
            bpy.data.collections.remove(collection)


def _find_sharing(level: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the other objects with the mesh of a level."""
    if level.data.users < 2:
        return []
    return [item for item in bpy.data.objects if item.data == level.data and item != level]


def _copy_material(material: bpy.types.Material) -> bpy.types.Material:
    copy = material.copy()
    copy.use_transparent_shadow = True
    copy[MATERIAL] = material.name
    show_color_image(copy)
    return copy
