"""The billboard clouds that stand in a scene, found by what Farfield wrote on them."""

import json
from dataclasses import dataclass

import bpy
import numpy as np

from ..bridge import btf_clouds, clouds, fade_originals, fades, originals
from ..core.cameras import Camera, choose_level, distance_to_box

SOURCES = "farfield_sources"  # on a cloud's collection: names, so that a linked cloud does not drag its source along


@dataclass(frozen=True)
class StandingCloud:
    """One cloud in a scene: its collection and its level objects, finest first. Not to be kept across redraws."""

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
        """The objects that the cloud stands for, those that still exist under their names."""
        return [bpy.data.objects[name] for name in self.source_names if name in bpy.data.objects]

    def texture_bytes(self, level: int) -> int:
        """Bytes that the textures of one level take in memory, unpacked."""
        tree = self.levels[level].data.materials[0].node_tree
        images = [node.image for node in tree.nodes if node.type == "TEX_IMAGE"] if tree else []
        return sum(image.size[0] * image.size[1] * 4 for image in images)

    def distance(self, position: np.ndarray) -> float:
        """Distance from `position` (3,) in world space to the bounding box of the cloud."""
        level = next((level for level in self.levels if not level.hide_viewport), self.levels[0])  # hidden objects are not kept up to date
        matrix = np.array(level.matrix_world)
        corners = np.array(level.bound_box) @ matrix[:3, :3].T + matrix[:3, 3]
        return distance_to_box(position, corners.min(axis=0), corners.max(axis=0))

    @property
    def fades(self) -> bool:
        """Whether the levels fade into each other."""
        return any(fades.FADE in level for level in self.levels)

    def fade(self, context: bpy.types.Context, span: float) -> None:
        """Let the original and all levels fade into each other for the scene's camera, over the share `span` of the distance.

        Each level begins to show where its error is one pixel. Stand-ins with the original's surfaces fade; the sources themselves are
        hidden.
        """
        self.unfade()
        sources, errors = self.sources, [*self.errors, fades.FOREVER]
        if sources:
            with originals.shown(context, sources) as depsgraph:
                fade_originals.add_originals(sources, self.collection, depsgraph)
        for item in fade_originals.originals_in(self.collection):
            size = np.linalg.norm(np.array(item.matrix_basis)[:3, :3]) / 3.0**0.5
            fades.fade(item, fades.ALWAYS, errors[0] / max(size, 1e-12), span)
        for number, level in enumerate(self.levels):
            fades.fade(level, errors[number] if sources or number else fades.ALWAYS, errors[number + 1], span)
            _set_hidden(level, False)
        for source in sources:
            _set_hidden(source, True)
        clouds.allow_transparent_bounces(context.scene, clouds.needed_transparent_bounces(self.levels, together=True))

    def unfade(self) -> None:
        """Let every level show wherever it is not hidden; all stay visible but for the original's stand-ins, which go."""
        fade_originals.remove_originals(self.collection)
        for level in self.levels:
            fades.unfade(level, [*level.data.materials, btf_clouds.plain_material(level)])

    def show_for(self, camera: Camera) -> int | None:
        """Show the level that suits `camera` and hide the others; the sources when all are too coarse. Returns the level or None."""
        self.unfade()
        chosen = choose_level(self.errors, self.distance(camera.position), camera)
        sources = self.sources
        if chosen is None and not sources:
            chosen = 0  # the original is gone: the finest level is the best there is
        for index, level in enumerate(self.levels):
            _set_hidden(level, index != chosen)
        for source in sources:
            _set_hidden(source, chosen is not None)
        return chosen


def remember_sources(collection: bpy.types.Collection, names: list[str]) -> None:
    """Write down which objects the cloud in `collection` stands for."""
    collection[SOURCES] = json.dumps(names)


def clouds_in(scene: bpy.types.Scene) -> list[StandingCloud]:
    """All clouds whose collections hang below the scene's collection."""
    found = [cloud_of(collection) for collection in scene.collection.children_recursive]
    return [cloud for cloud in found if cloud is not None]


def cloud_for(scene: bpy.types.Scene, target: bpy.types.Object | None) -> StandingCloud | None:
    """The cloud that `target` is a level of, or else the newest one that stands for it."""
    if target is None:
        return None
    matching = [cloud for cloud in clouds_in(scene) if target in cloud.levels or target in cloud.sources]
    return matching[-1] if matching else None


def cloud_of(collection: bpy.types.Collection) -> StandingCloud | None:
    """The cloud in `collection`, if it holds one."""
    levels = [item for item in collection.objects if item.get(clouds.KIND) == clouds.CLOUD]
    return StandingCloud(collection, sorted(levels, key=lambda item: item["farfield_level"])) if levels else None


def _set_hidden(target: bpy.types.Object, hidden: bool) -> None:
    target.hide_viewport = hidden
    target.hide_render = hidden
