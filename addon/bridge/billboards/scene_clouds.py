"""Billboard clouds in a scene, found by their custom properties."""

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.geometry.cameras import Camera, choose_level, distance_to_box
from ...core.geometry.transforms import mean_scale, transform_points
from .. import lod_crossfade
from ..geometry import meshes
from ..lod_sets import ERROR, NUMBER, LodSet, set_hidden
from ..objects import temporarily_visible, world_matrix
from ..rendering import render_properties
from ..source_links import find_sources
from . import clouds, source_objects
from .level_objects import pbr_material


class SceneCloud(LodSet):
    """One cloud in a scene: its collection and its level objects, finest first. `errors` are in scene units."""

    kind = clouds.CLOUD
    figures = (NUMBER, ERROR, "farfield_quads", "farfield_texels")

    @classmethod
    def is_level(cls, item: bpy.types.Object) -> bool:
        """Return whether `item` is a level with all its figures, and with an error."""
        return super().is_level(item) and item[ERROR] > 0.0

    @property
    def is_editable(self) -> bool:
        """Whether the cloud can be changed: not if it is linked from a library."""
        return self.collection.is_editable and all(level.is_editable for level in self.levels)

    @property
    def can_crossfade(self) -> bool:
        """Whether a cross-fade can be added: it needs a local cloud, because a library override keeps neither new objects nor nodes."""
        materials = [material for level in self.levels for material in level.data.materials if material is not None]
        is_local = self.collection.override_library is None and all(level.override_library is None for level in self.levels)
        return self.is_editable and is_local and all(material.is_editable for material in materials)

    @property
    def notes(self) -> list[str]:
        """Sentences about the cloud, see `Cloud.notes`."""
        return str(self.collection.get(clouds.NOTES, "")).splitlines()

    @property
    def missing_source_names(self) -> list[str]:
        """The stored names of the source objects that no longer exist."""
        return [name for name, source in find_sources(self.collection, self.index) if source is None]

    def sources_in(self, view_layer: bpy.types.ViewLayer) -> list[bpy.types.Object]:
        """Return the source objects in `view_layer`; others cannot be shown there, because their collection is excluded."""
        return [source for source in self.sources if meshes.is_in_view_layer(source, view_layer)]

    def is_in(self, view_layer: bpy.types.ViewLayer) -> bool:
        """Return whether a level is in `view_layer`."""
        return any(meshes.is_in_view_layer(level, view_layer) for level in self.levels)

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

    def texture_bytes(self, level: int) -> int:
        """Return the uncompressed size of the textures of one level."""
        material = next(iter(self.levels[level].data.materials), None)
        nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else []
        images = [node.image for node in nodes if node.type == "TEX_IMAGE"]
        return sum(image.size[0] * image.size[1] * 4 for image in images if image is not None)

    def distance(self, position: np.ndarray) -> float:
        """Return the distance from `position` (3,) in world space to the bounding box of the cloud."""
        level = next((level for level in self.levels if not level.hide_viewport), self.levels[0])
        corners = transform_points(world_matrix(level), level.bound_box)
        return distance_to_box(position, corners.min(axis=0), corners.max(axis=0))

    def add_crossfade(self, context: bpy.types.Context, fade_range: float) -> None:
        """Cross-fade the source and all levels for the active camera, over `fade_range`, a fraction of the switch distance.

        Each level begins to show where its error is one pixel; without a source that can be read in the view layer, the finest level shows
        from the camera on. Proxies of the source objects fade; the objects themselves are hidden.
        """
        self.remove_crossfade()
        sources, errors = self.sources_in(context.view_layer), [*self.errors, lod_crossfade.MAX_PIXEL]
        if sources:
            with temporarily_visible(context, sources) as depsgraph:
                source_objects.add_source_proxies(sources, self.collection, depsgraph)
        proxies = source_objects.find_source_proxies(self.collection)
        for item in proxies:
            scale = mean_scale(np.array(item.matrix_basis))
            lod_crossfade.add_crossfade(item, lod_crossfade.MIN_PIXEL, errors[0] / max(scale, 1e-12), fade_range)
        for index, level in enumerate(self.levels):
            start = errors[index] if proxies or index else lod_crossfade.MIN_PIXEL
            lod_crossfade.add_crossfade(level, start, errors[index + 1], fade_range)
            set_hidden(level, False)
        bounces = render_properties.estimate_transparent_bounces(self.levels, all_visible=True)
        render_properties.ensure_transparent_bounces(context.scene, bounces)
        self._set_collection_hidden(False)
        self.hide_sources()

    def remove_crossfade(self) -> None:
        """Let every level show at any distance, and remove the proxies of the source. The visibility of objects stays as it is."""
        source_objects.remove_source_proxies(self.collection)
        for level in self.levels:
            materials = [material for material in (*level.data.materials, pbr_material(level)) if material is not None]
            lod_crossfade.remove_crossfade(level, [material for material in materials if material.is_editable])

    def show_level_for(self, camera: Camera, view_layer: bpy.types.ViewLayer) -> int | None:
        """Show the level that suits `camera` and hide the others; show the sources if all levels are too coarse.

        Returns the index of the level, or None for the sources.
        """
        self.remove_crossfade()
        shown_level = choose_level(self.errors, self.distance(camera.position), camera)
        if shown_level is None and not self.sources_in(view_layer):
            shown_level = 0  # The sources cannot be shown: the finest level is the best substitute.
        for index, level in enumerate(self.levels):
            set_hidden(level, index != shown_level)
        self._set_collection_hidden(False)
        for source in self.editable_sources:
            set_hidden(source, shown_level is not None)
        return shown_level

    def hide_sources(self) -> None:
        """Hide the editable source objects."""
        for source in self.editable_sources:
            set_hidden(source, True)

    def unhide_sources(self) -> None:
        """Show the editable source objects."""
        for source in self.editable_sources:
            set_hidden(source, False)

    def hide_cloud(self) -> None:
        """Hide the collection of the cloud, so that `show_cloud` shows the same level, or the same cross-fade, again."""
        self._set_collection_hidden(True)

    def show_sources(self) -> None:
        """Show the editable source objects and hide the cloud."""
        self.hide_cloud()
        self.unhide_sources()

    def show_cloud(self) -> None:
        """Show the cloud, at its finest level if no level was visible, and hide the editable source objects."""
        self._set_collection_hidden(False)
        if all(level.hide_viewport for level in self.levels):
            set_hidden(self.levels[0], False)
        self.hide_sources()

    def activate_visible(self, context: bpy.types.Context) -> None:
        """If the active object belongs to the cloud and is hidden, make a visible object of the cloud active: the panel depends on it.

        If it is an original, the others are selected as well: the cloud stands for all of them.
        """
        context.view_layer.update()
        active = context.view_layer.objects.active
        candidates = [*self.levels, *self.sources]
        visible = [item for item in candidates if meshes.is_in_view_layer(item, context.view_layer) and item.visible_get()]
        if active in candidates and active not in visible and visible:
            _activate(visible[0], context.view_layer)
            for item in visible if visible[0] in self.sources else ():
                item.select_set(True, view_layer=context.view_layer)

    def activate(self, context: bpy.types.Context) -> None:
        """Make the finest level active, if it is in the view layer."""
        context.view_layer.update()
        if meshes.is_in_view_layer(self.levels[0], context.view_layer):
            _activate(self.levels[0], context.view_layer)

    def _set_collection_hidden(self, hidden: bool) -> None:
        if self.collection.is_editable:
            self.collection.hide_viewport = self.collection.hide_render = hidden


clouds_in, find_cloud, read_cloud = SceneCloud.in_scene, SceneCloud.find, SceneCloud.read


def clouds_of_levels(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> list[SceneCloud]:
    """Return the clouds of those of `objects` that are levels, each once."""
    selected = set(objects)
    return [cloud for cloud in clouds_in(scene) if not selected.isdisjoint(cloud.levels)]


def _activate(item: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> None:
    view_layer.objects.active = item
    item.select_set(True, view_layer=view_layer)
