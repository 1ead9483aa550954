"""The jobs of the operators and the script: analyze textured meshes in scale space, and make their levels of detail."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...bridge.geometry.meshes import find_material
from ...bridge.objects import find_by_uid
from ...bridge.texmesh.level_meshes import create_level_mesh
from ...bridge.texmesh.level_sets import FIGURES, LevelSet, NewLevel, add_level_set, find_level_set, remove_level_set
from ...bridge.texmesh.rebaked_images import RebakeTextures
from ...bridge.texmesh.scale_attributes import write_scale_map
from ...bridge.texmesh.sources import TexturedSource
from ...core.errors import GeometryError
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, join_sentences
from ...core.texmesh.level_chain import LevelChain, make_levels
from ...core.texmesh.rebaking.rebake import RebakedTextures
from ...core.texmesh.scale_space.analysis import analyze_scale_space
from ...core.texmesh.scale_space.features import ScaleMap
from ...core.texmesh.settings import AnalysisSettings, SceneSettings, TexmeshSettings
from .rebaking import create_images, read_textures, rebake_chain
from .sources import describe_small, read_sources

MAX_LISTED = 3  # The levels of more objects are counted together in the result.
REBAKE_FRACTION = 0.3  # This part of the progress of an object is rebaking.


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
        objects = [_find_source(source) for source in self.sources]
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
        rebake_textures: what textures are rebaked from, per source, None to keep them.
        chains: the levels by the name of their collection.
    """

    core_fraction = 0.95

    sources: list[TexturedSource]
    settings: TexmeshSettings
    scene_settings: SceneSettings
    scene_uid: int
    skipped: list[str]
    rebake_textures: list[RebakeTextures | None]
    chains: dict[str, LevelChain] = field(default_factory=dict)

    def core_steps(self) -> Steps[list[tuple[LevelChain, RebakedTextures | None]]]:
        """Make the levels of every mesh, and their textures."""
        weights = np.array([len(source.mesh.triangles) for source in self.sources], float)
        starts = np.concatenate([[0.0], weights.cumsum() / weights.sum()])
        chains = []
        ranges = zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)
        for source, textures, (start, stop) in zip(self.sources, self.rebake_textures, ranges, strict=True):
            baking = stop if textures is None else stop - REBAKE_FRACTION * (stop - start)
            chain = yield from subprogress(make_levels(source.mesh, source.textures, self.settings), start, baking)
            steps = None if textures is None else rebake_chain(source, chain, textures)
            chains.append((chain, None if steps is None else (yield from subprogress(steps, baking, stop))))
        return chains

    def scene_steps(self, core_result: list[tuple[LevelChain, RebakedTextures | None]]) -> Steps[str]:
        """Create the objects.

        Raises:
            GeometryError: an object or the scene was removed meanwhile; nothing was created.
        """
        yield Progress(0.0, "Creating objects")
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        if scene is None:
            raise GeometryError("The scene was removed while levels were being made; make them again.")
        objects = [_find_source(source) for source in self.sources]
        materials = [[None if key is None else find_material(key) for key in source.evaluated.materials] for source in self.sources]
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        remarks = []
        for index, (chain, rebaked) in enumerate(core_result):
            remarks += self._add(objects[index], index, chain, rebaked, materials[index], scene)
        counts = _count_triangles(self.sources, [chain for chain, _ in core_result], self.settings)
        return join_sentences([*counts, *remarks, *describe_skipped(self.skipped)])

    def _add(
        self,
        item: bpy.types.Object,
        index: int,
        chain: LevelChain,
        rebaked: RebakedTextures | None,
        materials: Sequence[bpy.types.Material | None],
        scene: bpy.types.Scene,
    ) -> list[str]:
        """Add the levels of the object made from source `index` in place of those made before, and return remarks about them."""
        source, textures = self.sources[index], self.rebake_textures[index]
        earlier = find_level_set(scene, item)
        if earlier is not None and earlier.is_editable:
            remove_level_set(earlier)
        images = None if rebaked is None else create_images(item.name, materials, textures, rebaked)
        is_subset = self.settings.vertices == "original"
        new = [
            NewLevel(
                create_level_mesh(f"{item.name} L{number}", item, source, level.mesh, chain.scale_map, is_subset),
                level.pixel_size,
                level.distance,
                self._switch_distance(level.pixel_size),
                {} if images is None else images.levels[number],
            )
            for number, level in enumerate(chain.levels)
        ]
        levels = add_level_set(item, scene, f"{item.name} Levels", new, materials)
        levels.collection[FIGURES] = json.dumps(describe_chain(chain))
        self.chains[levels.collection.name] = chain
        _show(levels, scene, self.scene_settings)
        return [*([] if images is None else images.remarks), chain.scale_map.losses, *source.remarks]

    def _switch_distance(self, pixel_size: float) -> float:
        """Return the distance, in units of the object, at which a pixel of the display has a size."""
        return pixel_size / np.tan(np.radians(1.0 / self.settings.pixels_per_degree))


def _count_triangles(sources: Sequence[TexturedSource], chains: Sequence[LevelChain], settings: TexmeshSettings) -> list[str]:
    """Return sentences about the triangles of the levels of each object, or, of more than `MAX_LISTED` objects, of all together."""
    if len(chains) > MAX_LISTED:
        finest, coarsest = (sum(len(chain.levels[index].mesh.triangles) for chain in chains) for index in (0, -1))
        stopped = sum(any(level.constraint for level in chain.levels) for chain in chains)
        why = f" {format_count(stopped, 'object')} could not get as few triangles as intended." if stopped else ""
        return [f"{len(chains)} objects have levels, {finest:,} triangles in the finest and {coarsest:,} in the coarsest.{why}"]
    sentences = []
    for source, chain in zip(sources, chains, strict=True):
        counts = ", ".join(f"{len(level.mesh.triangles):,}" for level in chain.levels)
        has_levels = f'"{source.name}" has {format_count(len(chain.levels), "level")} with {counts} triangles.'
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
    sources, skipped = read_sources(context, objects)
    textures = read_textures(sources, settings)
    return LevelsJob(sources, settings, scene_settings, context.scene.session_uid, skipped, textures)


def _show(levels: LevelSet, scene: bpy.types.Scene, settings: SceneSettings) -> None:
    if settings.cross_fade:
        levels.add_crossfade(scene, settings.fade_range)
    else:
        levels.show(0)
    if not settings.keep_original_visible:
        levels.hide_source(True)
    bpy.context.view_layer.update()
    first = levels.levels[0]
    if first.name in bpy.context.view_layer.objects:
        bpy.context.view_layer.objects.active = first
        first.select_set(True)


def _find_source(source: TexturedSource) -> bpy.types.Object:
    item = find_by_uid(bpy.data.objects, source.object_uid)
    if item is None:
        raise GeometryError(f'"{source.name}" was removed while it was being worked on; nothing was changed.')
    return item


def describe_skipped(skipped: Sequence[str]) -> list[str]:
    """Return a sentence about the objects that were skipped, if there are any."""
    return [f"Skipped: {'; '.join(skipped)}."] if skipped else []
