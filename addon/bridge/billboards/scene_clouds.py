"""Billboard clouds in a scene, found by their custom properties."""

import json
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.geometry.cameras import Camera, choose_level, distance_to_box
from . import clouds, lod_crossfade, source_objects, source_proxies, transparent_bounces
from .level_objects import level_world_matrix, pbr_material

SOURCES = "farfield_sources"  # custom property of a cloud's collection: names, so that a linked cloud does not also link its sources


@dataclass(frozen=True)
class SceneCloud:
    """One cloud in a scene: its collection and its level objects, finest first. Do not keep it across redraws."""

    collection: bpy.types.Collection
    levels: list[bpy.types.Object]

    @property
    def errors(self) -> list[float]:
        """The error of each level in scene units."""
        return [level["farfield_error"] for level in self.levels]

    @property
    def source_names(self) -> list[str]:
        """The names of the objects that the cloud was built from."""
        return json.loads(self.collection.get(SOURCES, "[]"))

    @property
    def sources(self) -> list[bpy.types.Object]:
        """The objects that the cloud was built from, as far as they still exist under their names."""
        return [bpy.data.objects[name] for name in self.source_names if name in bpy.data.objects]

    @property
    def editable_sources(self) -> list[bpy.types.Object]:
        """The source objects whose visibility can be changed: not those that are linked from a library."""
        return [source for source in self.sources if source.is_editable]

    @property
    def linked_source_names(self) -> list[str]:
        """The names of the source objects that are linked from a library, so that their visibility cannot be changed."""
        return [source.name for source in self.sources if not source.is_editable]

    @property
    def shows_sources(self) -> bool:
        """Whether the cloud is hidden by `show_sources`, or an editable source object is visible in the viewport or in renders."""
        return self.collection.hide_viewport or any(not (source.hide_viewport and source.hide_render) for source in self.editable_sources)

    @property
    def has_crossfade(self) -> bool:
        """Whether the levels cross-fade."""
        return any(lod_crossfade.CROSSFADE in level for level in self.levels)

    def texture_bytes(self, level: int) -> int:
        """Return the uncompressed size of the textures of one level."""
        tree = self.levels[level].data.materials[0].node_tree
        images = [node.image for node in tree.nodes if node.type == "TEX_IMAGE"] if tree else []
        return sum(image.size[0] * image.size[1] * 4 for image in images)

    def distance(self, position: np.ndarray) -> float:
        """Return the distance from `position` (3,) in world space to the bounding box of the cloud."""
        level = next((level for level in self.levels if not level.hide_viewport), self.levels[0])
        matrix = np.array(level_world_matrix(level))
        corners = np.array(level.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
        return distance_to_box(position, corners.min(axis=0), corners.max(axis=0))

    def add_crossfade(self, context: bpy.types.Context, fade_range: float) -> None:
        """Cross-fade the source and all levels for the active camera, over `fade_range`, a fraction of the switch distance.

        Each level begins to show where its error is one pixel. Proxies of the source objects fade; the objects themselves are hidden.
        """
        self.remove_crossfade()
        sources, errors = self.sources, [*self.errors, lod_crossfade.MAX_PIXEL]
        if sources:
            with source_objects.temporarily_visible(context, sources) as depsgraph:
                source_proxies.add_source_proxies(sources, self.collection, depsgraph)
        for item in source_proxies.find_source_proxies(self.collection):
            scale = np.linalg.norm(np.array(item.matrix_basis)[:3, :3]) / 3.0**0.5
            lod_crossfade.add_crossfade(item, lod_crossfade.MIN_PIXEL, errors[0] / max(scale, 1e-12), fade_range)
        for index, level in enumerate(self.levels):
            start = errors[index] if sources or index else lod_crossfade.MIN_PIXEL
            lod_crossfade.add_crossfade(level, start, errors[index + 1], fade_range)
            _set_hidden(level, False)
        bounces = transparent_bounces.estimate_transparent_bounces(self.levels, all_visible=True)
        transparent_bounces.ensure_transparent_bounces(context.scene, bounces)
        self._set_collection_hidden(False)
        self.hide_sources()

    def remove_crossfade(self) -> None:
        """Let every level show at any distance, and remove the proxies of the source. The visibility of objects stays as it is."""
        source_proxies.remove_source_proxies(self.collection)
        for level in self.levels:
            lod_crossfade.remove_crossfade(level, [*level.data.materials, pbr_material(level)])

    def show_level_for(self, camera: Camera) -> int | None:
        """Show the level that suits `camera` and hide the others; show the sources if all levels are too coarse.

        Returns the index of the level, or None for the sources.
        """
        self.remove_crossfade()
        shown_level = choose_level(self.errors, self.distance(camera.position), camera)
        sources = self.sources
        if shown_level is None and not sources:
            shown_level = 0  # the sources no longer exist: the finest level is the best substitute
        for index, level in enumerate(self.levels):
            _set_hidden(level, index != shown_level)
        self._set_collection_hidden(False)
        for source in self.editable_sources:
            _set_hidden(source, shown_level is not None)
        return shown_level

    def hide_sources(self) -> None:
        """Hide the editable source objects."""
        for source in self.editable_sources:
            _set_hidden(source, True)

    def show_sources(self) -> None:
        """Show the editable source objects and hide the cloud.

        This hides the collection of the cloud, so that `show_cloud` shows the same level, or the same cross-fade, again.
        """
        self._set_collection_hidden(True)
        for source in self.editable_sources:
            _set_hidden(source, False)

    def show_cloud(self) -> None:
        """Show the cloud, at its finest level if no level was visible, and hide the editable source objects."""
        self._set_collection_hidden(False)
        if all(level.hide_viewport for level in self.levels):
            _set_hidden(self.levels[0], False)
        self.hide_sources()

    def activate_visible(self, context: bpy.types.Context) -> None:
        """If the active object belongs to the cloud and is hidden, make a visible object of the cloud active: the panel depends on it."""
        context.view_layer.update()
        active = context.view_layer.objects.active
        candidates = [*self.levels, *self.sources]
        visible = [item for item in candidates if item.visible_get()]
        if active in candidates and active not in visible and visible:
            context.view_layer.objects.active = visible[0]
            visible[0].select_set(True)

    def _set_collection_hidden(self, hidden: bool) -> None:
        if self.collection.is_editable:
            self.collection.hide_viewport = self.collection.hide_render = hidden


def store_source_names(collection: bpy.types.Collection, names: list[str]) -> None:
    """Store the names of the objects that the cloud in `collection` was built from."""
    collection[SOURCES] = json.dumps(names)


def clouds_in(scene: bpy.types.Scene) -> list[SceneCloud]:
    """Return all clouds whose collections are in `scene`, at any depth."""
    scene_clouds = [read_cloud(collection) for collection in scene.collection.children_recursive]
    return [cloud for cloud in scene_clouds if cloud is not None]


def find_cloud(scene: bpy.types.Scene, item: bpy.types.Object | None) -> SceneCloud | None:
    """Return the cloud that has `item` as a level, or the newest one that was built from it."""
    if item is None:
        return None
    matches = [cloud for cloud in clouds_in(scene) if item in cloud.levels or item in cloud.sources]
    return matches[-1] if matches else None


def read_cloud(collection: bpy.types.Collection) -> SceneCloud | None:
    """Return the cloud in `collection`, or None if it contains none."""
    levels = [item for item in collection.objects if item.get(clouds.KIND) == clouds.CLOUD]
    return SceneCloud(collection, sorted(levels, key=lambda item: item["farfield_level"])) if levels else None


def _set_hidden(item: bpy.types.Object, hidden: bool) -> None:
    item.hide_viewport = hidden
    item.hide_render = hidden
