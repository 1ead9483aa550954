"""The jobs of the operators and the script: analyze textured meshes in scale space, and make their levels of detail."""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ...bridge.geometry.meshes import find_material
from ...bridge.objects import find_by_uid
from ...bridge.texmesh.level_meshes import create_level_mesh
from ...bridge.texmesh.level_sets import (
    FIGURES,
    LevelSet,
    NewLevel,
    Placement,
    add_collections,
    add_level_set,
    add_materials,
    find_level_set,
    level_sets_in,
    remove_level_set,
)
from ...bridge.texmesh.placed_sources import SharedSources
from ...bridge.texmesh.scale_attributes import write_scale_map
from ...bridge.texmesh.sources import TexturedSource
from ...core.billboards.cloud import Cloud
from ...core.errors import GeometryError, SettingsError
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, join_sentences, list_first
from ...core.texmesh.level_chain import LevelChain, estimate_costs, make_levels
from ...core.texmesh.scale_space.analysis import analyze_scale_space
from ...core.texmesh.scale_space.features import ScaleMap
from ...core.texmesh.settings import AnalysisSettings, SceneSettings, TexmeshSettings
from .cloud_levels import CloudSource, read_cloud_sources
from .estimates import estimator
from .sources import describe_small, read_sources

MAX_LISTED = 3  # The levels of more objects are counted together in the result.


@dataclass
class AnalysisJob:
    """Analyzes meshes and writes the last scale of each vertex as an attribute. `results` holds the scale map of each object."""

    core_fraction = 0.98

    sources: list[TexturedSource]
    settings: AnalysisSettings
    skipped: list[str]
    results: list[tuple[str, ScaleMap]] = field(default_factory=list)

    def core_steps(self) -> Steps[list[ScaleMap]]:
        """Analyze every mesh."""
        maps = []
        for index, source in enumerate(self.sources):
            steps = analyze_scale_space(source.mesh, source.textures, self.settings)
            maps.append((yield from subprogress(steps, index / len(self.sources), (index + 1) / len(self.sources))))
        return maps

    def scene_steps(self, core_result: list[ScaleMap]) -> Steps[str]:
        """Write the attributes.

        Raises:
            GeometryError: an object was removed meanwhile; nothing was written.
        """
        yield Progress(0.0, "Writing attributes")
        objects = [_find_object(source) for source in self.sources]
        sentences = []
        for item, source, scale_map in zip(objects, self.sources, core_result, strict=True):
            is_written = write_scale_map(item, source, scale_map)
            features = ", ".join(f"{int(scale_map.counts[scale]):,}" for scale in (1, 5, 10, 20))
            note = "" if is_written else ", not as an attribute, since modifiers change the vertices"
            sentences.append(f'"{item.name}" has {features} features at scales 1, 5, 10 and 20{note}.')
            sentences += [scale_map.losses, *source.remarks]
            self.results.append((item.name, scale_map))
        return join_sentences([*sentences, *describe_skipped(self.skipped)])


@dataclass
class LevelsJob:
    """Makes levels of meshes and adds their objects.

    Attributes:
        sources: the meshes.
        settings: of the levels.
        scene_settings: what happens in the scene.
        scene_uid: the scene that gets the levels.
        skipped: names of other objects with the reason.
        placements: where each source is.
        clouds: what billboard clouds are made of, per source, None without.
        chains: the levels by the name of their collection, one per placement.
    """

    core_fraction = 0.95

    sources: list[TexturedSource]
    settings: TexmeshSettings
    scene_settings: SceneSettings
    scene_uid: int
    skipped: list[str]
    placements: list[list[Placement]]
    clouds: list[CloudSource | None]
    chains: dict[str, LevelChain] = field(default_factory=dict)

    @property
    def placed(self) -> list[tuple[TexturedSource, Placement]]:
        """Each source at each of its places, in the order of `chains`."""
        pairs = zip(self.sources, self.placements, strict=True)
        return [(source, placement) for source, placements in pairs for placement in placements]

    def core_steps(self) -> Steps[list[tuple[LevelChain, Cloud | None]]]:
        """Make the levels of every mesh, and its billboard cloud."""
        started, counts = time.monotonic(), np.array([len(source.mesh.triangles) for source in self.sources])
        ends = estimate_costs(counts, self.settings).cumsum()
        starts = np.concatenate([[0.0], ends / ends[-1]]).tolist()
        chains = []
        for index, source in enumerate(self.sources):
            start, stop = starts[index : index + 2]
            prefix = f"{source.name} ({index + 1} of {len(counts)}): " if len(counts) > 1 else ""
            chain = yield from subprogress(make_levels(source.mesh, source.textures, self.settings), start, stop, prefix)
            chains.append((chain, (yield from subprogress(self._build_cloud(index), stop, stop, prefix))))
        if not any(self.clouds):
            estimator.remember(counts.tolist(), self.settings, (time.monotonic() - started) / self.core_fraction)
        return chains

    def _build_cloud(self, index: int) -> Steps[Cloud | None]:
        """Return the billboard cloud of source `index`, None if it is not wanted or needs more quads."""
        if self.clouds[index] is None:
            return None
        try:
            return (yield from self.clouds[index].build())
        except SettingsError as error:
            self.clouds[index] = None
            self.skipped.append(f"the billboard cloud ({str(error).removesuffix('.')})")
            return None

    def scene_steps(self, core_result: list[tuple[LevelChain, Cloud | None]]) -> Steps[str]:
        """Render the images of billboard clouds, and create the objects.

        Raises:
            GeometryError: an object or the scene was removed meanwhile; nothing was created.
        """
        images = []
        for source, (_, cloud) in zip(self.clouds, core_result, strict=True):
            images.append(None if source is None else (yield from subprogress(source.capture(cloud), 0.0, 0.9)))
        yield Progress(0.9, "Creating objects")
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        if scene is None:
            raise GeometryError("The scene was removed while levels were being made; make them again.")
        objects = {placement.object_uid: _find_object(placement) for _, placement in self.placed}
        materials = [[None if key is None else find_material(key) for key in source.evaluated.materials] for source in self.sources]
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        active = bpy.context.view_layer.objects.active
        earlier = find_level_set(scene, active)
        active_source = active if earlier is None else earlier.source
        collections = self._replace_collections(objects, scene)
        remarks = []
        for index, (chain, cloud) in enumerate(core_result):
            last = None if cloud is None else self.clouds[index].create_level(cloud, images[index], chain.levels[-1].pixel_size, scene)
            remarks += self._add(objects, index, chain, materials[index], scene, collections, last)
        made = find_level_set(scene, active_source)
        if made is not None:
            _activate(made)
        counts = _count_triangles(self.sources, self.placements, [chain for chain, _ in core_result], self.settings)
        return join_sentences([*counts, *remarks, *describe_skipped(self.skipped)])

    def _replace_collections(self, objects: dict[int, bpy.types.Object], scene: bpy.types.Scene) -> dict[int, bpy.types.Collection]:
        """Remove the levels that the objects had, and return a new collection for each placement, by its `id`."""
        for levels in level_sets_in(scene):
            if levels.source in objects.values() and levels.is_editable:
                remove_level_set(levels)
        found: dict[int, bpy.types.Collection] = {}
        for uid, item in objects.items():
            own = [placement for _, placement in self.placed if placement.object_uid == uid]
            made = add_collections(item, scene, [placement.label for placement in own])
            found |= {id(placement): collection for placement, collection in zip(own, made, strict=True)}
        return found

    def _add(
        self,
        objects: dict[int, bpy.types.Object],
        index: int,
        chain: LevelChain,
        materials: Sequence[bpy.types.Material | None],
        scene: bpy.types.Scene,
        collections: dict[int, bpy.types.Collection],
        cloud: NewLevel | None,
    ) -> list[str]:
        """Add the levels of source `index` and its billboard `cloud` at all its places, and return remarks about them."""
        source = self.sources[index]
        is_subset = self.settings.vertices == "original"
        new = [
            NewLevel(
                create_level_mesh(f"{source.name} L{number}", objects[source.object_uid], source, level.mesh, chain.scale_map, is_subset),
                level.pixel_size,
                level.distance,
                self._switch_distance(level.pixel_size),
            )
            for number, level in enumerate(chain.levels)
        ]
        add_materials(new, materials)
        if cloud is not None:
            new.append(replace(cloud, switch_distance=self._switch_distance(cloud.error)))
        figures = json.dumps(describe_chain(chain))
        for placement in self.placements[index]:
            levels = add_level_set(objects[placement.object_uid], new, collections[id(placement)], placement)
            levels.collection[FIGURES] = figures
            self.chains[levels.collection.name] = chain
            _show(levels, scene, self.scene_settings)
        last = None if cloud is None else f'The last level of "{source.name}" is a billboard cloud of {len(cloud.mesh.polygons)} quads.'
        return [last, chain.scale_map.losses, *source.remarks]

    def _switch_distance(self, pixel_size: float) -> float:
        """Return the distance, in units of the object, at which a pixel of the display has a size."""
        return pixel_size / np.tan(np.radians(1.0 / self.settings.pixels_per_degree))


def _count_triangles(
    sources: Sequence[TexturedSource], placements: Sequence[Sequence[Placement]], chains: Sequence[LevelChain], settings: TexmeshSettings
) -> list[str]:
    """Return sentences about the triangles of the levels: of all places together, if there are several meshes, and of each of up to
    `MAX_LISTED` meshes."""
    places, sentences = [len(found) for found in placements], []
    if len(chains) > 1:
        finest, coarsest = (
            sum(number * len(chain.levels[index].mesh.triangles) for number, chain in zip(places, chains, strict=True)) for index in (0, -1)
        )
        which = (
            f"{sum(places):,} objects and instances of {len(chains):,} meshes" if sum(places) > len(chains) else f"{len(chains)} objects"
        )
        sentences.append(f"{which} have levels, {finest:,} triangles in the finest and {coarsest:,} in the coarsest.")
    if len(chains) > MAX_LISTED:
        stopped = sum(any(level.constraint for level in chain.levels) for chain in chains)
        small = sum(bool(describe_small(source, settings)) for source in sources)
        sentences.append(f"Too few triangles to simplify: {format_count(small, 'object')}." if small else "")
        return [*sentences, f"{format_count(stopped, 'object')} could not get as few triangles as intended." if stopped else ""]
    for source, number, chain in zip(sources, places, chains, strict=True):
        counts = ", ".join(f"{len(level.mesh.triangles):,}" for level in chain.levels)
        where = f", shared by {number:,} objects or instances" if number > 1 else ""
        has_levels = f'"{source.name}" has {format_count(len(chain.levels), "level")} with {counts} triangles{where}.'
        sentences += [describe_small(source, settings) or has_levels, *(level.constraint for level in chain.levels)]
        if settings.levels == "number" and len(chain.levels) < settings.number:
            sentences.append(f'"{source.name}" has fewer than {settings.number} levels, since there are no more with different triangles.')
    return sentences


def describe_chain(chain: LevelChain) -> dict:
    """Return figures about levels for reports and plots."""
    return {
        "levels": [
            {
                "triangles": len(level.mesh.triangles),
                "scale": level.scale,
                "pixel_size": level.pixel_size,
                "pixels": None if level.switch is None else level.switch.pixels,
                "difference": None if level.switch is None else level.switch.difference,
                "distance": level.distance,
                "distance_pixels": level.distance / level.pixel_size if level.pixel_size else 0.0,
                "is_optimized": level.is_moved,
                "constraint": level.constraint,
                "drastic_steps": list(level.drastic_steps),
            }
            for level in chain.levels
        ],
        "candidates": [{"triangles": triangles, "pixel_size": size} for triangles, size in chain.candidates],
        "distance_factor": chain.distance_factor,
        "weber_fractions": [float(value) for value in chain.impacts.fractions],
        "features": [int(count) for count in chain.scale_map.counts],
        "sigmas": [float(sigma) for sigma in chain.scale_map.sigmas],
        "ranges": [float(value) for value in chain.scale_map.ranges],
    }


def prepare_analysis(context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: AnalysisSettings) -> AnalysisJob:
    """Return the job that analyzes `objects`. Raises FarfieldError if none can be read."""
    sources, skipped = read_sources(context, objects)
    return AnalysisJob(sources, settings, skipped)


def prepare_levels(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: TexmeshSettings, scene_settings: SceneSettings
) -> LevelsJob:
    """Return the job that makes levels of `objects`. Raises FarfieldError if none can be read."""
    shared = SharedSources()
    _, skipped = read_sources(context, objects, shared.read)
    clouds, without = read_cloud_sources(context, shared.sources, shared.placements, scene_settings)
    skipped += without
    return LevelsJob(shared.sources, settings, scene_settings, context.scene.session_uid, skipped, shared.placements, clouds)


def _show(levels: LevelSet, scene: bpy.types.Scene, settings: SceneSettings) -> None:
    if settings.cross_fade:
        levels.add_crossfade(scene, settings.fade_range)
    else:
        levels.show(0)
    if not settings.keep_original_visible:
        levels.hide_source(True)
    _activate(levels)


def _activate(levels: LevelSet) -> None:
    """Select the finest level and make it active, if it is in the view layer."""
    bpy.context.view_layer.update()
    first = levels.levels[0]
    if first.name in bpy.context.view_layer.objects:
        bpy.context.view_layer.objects.active = first
        first.select_set(True)


def _find_object(source: TexturedSource | Placement) -> bpy.types.Object:
    item = find_by_uid(bpy.data.objects, source.object_uid)
    if item is None:
        raise GeometryError(f'"{source.name}" was removed while it was being worked on; nothing was changed.')
    return item


def describe_skipped(skipped: Sequence[str]) -> list[str]:
    """Return a sentence about the objects that were skipped, if there are any."""
    return [f"Skipped: {list_first(skipped)}."] if skipped else []
