"""Builds the chain of levels of one asset in a temporary scene, with the jobs of perceptual levels and billboard clouds."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import bpy
import mathutils
import numpy as np

from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_in
from ...bridge.distance.assets import Asset, count_own_triangles, read_box
from ...bridge.distance.chains import Chain, NewLevel, create_chain
from ...bridge.distance.foliage import Foliage, find_foliage, simplify_foliage
from ...bridge.distance.level_switch import level_modifiers
from ...bridge.distance.simplified_meshes import MIN_TRIANGLES, SimplifiedMesh, discard_unused, has_texture, simplify_solid
from ...bridge.geometry.mesh_arrays import count_triangles
from ...bridge.geometry.meshes import read_mesh
from ...bridge.objects import world_matrix
from ...bridge.rendering.render_properties import copy_render_properties
from ...bridge.texmesh.level_sets import LevelSet, level_sets_in, remove_level_set
from ...core.arrays import TINY
from ...core.billboards.settings import BillboardSettings, BuildOptions
from ...core.distance.levels import LevelCandidate, choose_levels, choose_vanishing, combine_levels, is_light
from ...core.distance.settings import DistanceSettings
from ...core.errors import Cancelled, FarfieldError
from ...core.geometry.transforms import mean_scale
from ...core.jobs.progress import BackgroundThread, Progress, Steps, subprogress
from ...core.texmesh.settings import SceneSettings, TexmeshSettings
from ..billboards.job import prepare_job
from ..job_run import Job
from ..texmesh.job import prepare_levels

SCENE_NAME = "Farfield Build"
CLOUD_LEVELS = 2
POLL = 0.05  # Seconds between two looks at a thread.
SIMPLIFY_FRACTION, LEVELS_FRACTION = 0.1, 0.45  # Of the work on an asset.
MAX_PERCEPTUAL_TRIANGLES = 200_000  # Of objects with a texture that get perceptual levels, which take minutes.
MIN_PART_TRIANGLES = 8  # Of levels of one of many objects.
MAX_BASE_PIXEL = 0.01  # Pixel size of the mesh that clouds are made of, relative to the longest side; it is the error of the cloud.


@dataclass(frozen=True)
class Simplified:
    """An object of an asset, and what was made of it without its jobs.

    Attributes:
        copy: of the object.
        base: object that clouds are made of: `copy`, or a lighter one that looks like it from some distance.
        base_size: of the pixels above which it does, in units of the object.
        levels: lighter meshes, finest first.
        is_textured: whether it has a texture, which Decimate moves, and few enough triangles for perceptual levels.
        foliage: its leaves, for which a cloud would be no use; None without.
    """

    copy: bpy.types.Object
    base: bpy.types.Object
    base_size: float
    levels: list[SimplifiedMesh]
    is_textured: bool = False
    foliage: Foliage | None = None


@dataclass(frozen=True)
class Part:
    """An object of an asset, and its levels.

    Attributes:
        copy: of the object.
        meshes: of the levels and their matrices in the asset, finest first, of which the first is that of the object; None where it
            vanishes.
        candidates: the same as numbers, in units of the asset.
        size: (3,) of the bounding box, in units of the asset.
    """

    copy: bpy.types.Object
    meshes: list[tuple[bpy.types.Mesh, mathutils.Matrix] | None]
    candidates: list[LevelCandidate]
    size: np.ndarray


def build_chain(asset: Asset, fingerprint: str, settings: DistanceSettings, remarks: list[str]) -> Steps[Chain]:
    """Make the levels of an asset. What could not be made is added to `remarks`."""
    try:
        with temporary_scene() as scene:
            side = float((asset.high - asset.low).max())
            copies = [_copy_object(item, scene) for item in asset.objects]
            simplified = yield from subprogress(_simplify(copies, scene, side * mean_scale(asset.frame), settings), 0.0, SIMPLIFY_FRACTION)
            textured = [item.copy for item in simplified if item.is_textured]
            parts, combined = _combine(asset, simplified, scene, settings)
            if textured and settings.perceptual_levels and not is_light([level for level, _ in combined], side, len(asset.matrices)):
                steps = _run(scene, lambda: _prepare_levels(textured), f'levels of "{asset.name}"', remarks)
                yield from subprogress(steps, SIMPLIFY_FRACTION, LEVELS_FRACTION)
                parts, combined = _combine(asset, simplified, scene, settings)
            is_needed = not settings.perceptual_levels or not is_light([level for level, _ in combined], side, len(asset.matrices))
            base_size = 0.0
            if settings.billboard_cloud and is_needed and not any(item.foliage is not None for item in simplified):
                bases = [item.base for item in simplified]
                base_size = max(item.base_size * _scale(asset, item.copy) for item in simplified)
                steps = _run(scene, lambda: _prepare_cloud(bases, base_size / side), f'cloud of "{asset.name}"', remarks)
                yield from subprogress(steps, LEVELS_FRACTION, 1.0)
            yield Progress(1.0, "Creating levels")
            return _assemble(asset, fingerprint, parts, combined, clouds_in(scene), base_size, settings)
    finally:
        discard_unused()


def _simplify(
    copies: Sequence[bpy.types.Object], scene: bpy.types.Scene, side: float, settings: DistanceSettings
) -> Steps[list[Simplified]]:
    """Return light meshes of all objects. side: the longest one of all together, in world space."""
    found = []
    scene.view_layers[0].update()
    depsgraph = scene.view_layers[0].depsgraph
    for index, copy in enumerate(copies):
        span = index / len(copies), (index + 1) / len(copies)
        yield Progress(span[0], "Reading the mesh")
        item = Simplified(copy, copy, 0.0, [])
        if settings.perceptual_levels:
            evaluated = read_mesh(copy.evaluated_get(depsgraph), depsgraph)
            foliage = find_foliage(evaluated)
            if foliage is not None:
                levels = yield from subprogress(simplify_foliage(copy, foliage, scene), *span)
                item = Simplified(copy, copy, 0.0, levels, foliage=foliage)
            else:
                is_textured = has_texture(evaluated) and len(evaluated.triangles) <= MAX_PERCEPTUAL_TRIANGLES
                own_side = side / max(mean_scale(world_matrix(copy)), TINY)
                min_triangles = max(MIN_TRIANGLES // len(copies), MIN_PART_TRIANGLES)
                levels = yield from subprogress(simplify_solid(copy, evaluated, scene, own_side, min_triangles), *span)
                base = next((level for level in reversed(levels) if level.pixel_size <= MAX_BASE_PIXEL * own_side), None)
                if base is not None and not is_textured:
                    item = Simplified(copy, _add_base(copy, base, scene), base.pixel_size, levels)
                else:
                    item = Simplified(copy, copy, 0.0, levels, is_textured)
        found.append(item)
    return found


def _add_base(copy: bpy.types.Object, level: SimplifiedMesh, scene: bpy.types.Scene) -> bpy.types.Object:
    """Return a new object that shows a level at the place of `copy`."""
    base = bpy.data.objects.new(copy.name, level.mesh)
    copy_render_properties(copy, base)
    base.matrix_world = world_matrix(copy)
    scene.collection.objects.link(base)
    return base


@contextmanager
def temporary_scene() -> Iterator[bpy.types.Scene]:
    """Yield a scene, and remove it afterwards with everything in it that nothing else uses."""
    scene = bpy.data.scenes.new(SCENE_NAME)
    try:
        yield scene
    finally:
        for levels in level_sets_in(scene):
            remove_level_set(levels)
        for cloud in clouds_in(scene):
            clouds.discard_collection(cloud.collection)
        for collection in scene.collection.children_recursive:
            bpy.data.collections.remove(collection)
        bpy.data.batch_remove(scene.objects[:])
        bpy.data.scenes.remove(scene)


def _copy_object(item: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Object:
    """Return a copy of an object, with the same data and at the same place, in another scene."""
    matrix, copy = world_matrix(item).copy(), item.copy()
    for modifier in level_modifiers(copy):
        copy.modifiers.remove(modifier)
    copy.constraints.clear()
    copy.animation_data_clear()
    copy.parent = None
    copy.matrix_world = matrix
    copy.hide_viewport = copy.hide_render = copy.hide_select = False
    scene.collection.objects.link(copy)
    return copy


def _prepare_levels(copies: Sequence[bpy.types.Object]) -> Job:
    scene_settings = SceneSettings(cross_fade=False, keep_original_visible=True)
    return prepare_levels(bpy.context, copies, TexmeshSettings(), scene_settings)


def _prepare_cloud(copies: Sequence[bpy.types.Object], base_size: float) -> Job:
    """Prepare a cloud with texels for the pixels from which it shows. base_size: see `_assemble`, relative to the longest side."""
    options = BuildOptions(combine_selected=True, keep_original_visible=True)
    settings = BillboardSettings(levels=CLOUD_LEVELS)
    settings = replace(settings, texel_size=settings.texel_size * (1.0 + base_size / settings.error))
    return prepare_job(bpy.context, copies, settings, options)


def _run(scene: bpy.types.Scene, prepare: Callable[[], Job], subject: str, remarks: list[str]) -> Steps[None]:
    """Prepare and run a job in another scene. Its first half runs in a thread, so that the interface stays usable. If it fails, its error
    becomes a remark."""
    context = {"scene": scene, "view_layer": scene.view_layers[0]}
    try:
        with bpy.context.temp_override(**context):
            scene.view_layers[0].update()
            job = prepare()
        result = yield from subprogress(in_thread(job.core_steps()), 0.0, job.core_fraction)
        yield from subprogress(_in_scene(job.scene_steps(result), context), job.core_fraction, 1.0)
    except Cancelled:
        raise
    except FarfieldError as error:
        remarks.append(f"No {subject}: {error}")


def in_thread(steps: Steps[object]) -> Steps[object]:
    """Run steps that do not use Blender in a thread."""
    thread = BackgroundThread(steps)
    try:
        while not thread.wait(POLL):
            yield thread.progress
        return thread.result()
    finally:
        thread.cancel()
        thread.wait()


def _in_scene(steps: Steps[object], context: dict[str, bpy.types.ID]) -> Steps[object]:
    """Run the steps with another scene as that of the context."""
    try:
        while True:
            with bpy.context.temp_override(**context):
                step = next(steps)
            yield step
    except StopIteration as end:
        return end.value
    finally:
        with bpy.context.temp_override(**context):
            steps.close()


def _scale(asset: Asset, item: bpy.types.Object) -> float:
    """Return the length of a unit of an object in units of the asset."""
    return mean_scale(asset.frame.inverted_safe() @ world_matrix(item))


def _combine(
    asset: Asset, simplified: Sequence[Simplified], scene: bpy.types.Scene, settings: DistanceSettings
) -> tuple[list[Part], list[tuple[LevelCandidate, tuple[int, ...]]]]:
    """Return the objects of an asset with their levels, and the levels of all together, see `combine_levels`."""
    sets = level_sets_in(scene)
    parts = [_read_part(asset, *pair, sets) for pair in zip(asset.objects, simplified, strict=True)]
    for part, may_vanish in zip(parts, choose_vanishing(np.array([part.size for part in parts])), strict=True):
        if may_vanish and settings.perceptual_levels:
            part.meshes.append(None)
            part.candidates.append(LevelCandidate(0, float(np.linalg.norm(part.size))))
    return parts, combine_levels([part.candidates for part in parts])


def _read_part(asset: Asset, item: bpy.types.Object, simplified: Simplified, sets: Sequence[LevelSet]) -> Part:
    """Return an object of an asset with those of its light meshes and perceptual levels that pay."""
    inverse, unit = asset.frame.inverted_safe(), mean_scale(asset.frame)
    matrix, copy = inverse @ world_matrix(item), simplified.copy
    evaluated = copy.evaluated_get(copy.users_scene[0].view_layers[0].depsgraph)
    transparent = 0 if simplified.foliage is None else simplified.foliage.transparent_triangles
    meshes, candidates = [(item.data, matrix)], [LevelCandidate(count_own_triangles(evaluated), 0.0, transparent)]
    for level in simplified.levels:
        meshes.append((level.mesh, matrix))
        candidates.append(LevelCandidate(level.triangles, level.pixel_size * _scale(asset, copy), level.transparent))
    for levels in (levels for levels in sets if levels.source == copy):
        for level, error in zip(levels.levels[1:], levels.errors[1:], strict=True):
            world = world_matrix(level)
            candidates.append(LevelCandidate(count_triangles(level.data), error * mean_scale(world) / unit))
            meshes.append((level.data, inverse @ world))
    chosen = choose_levels(candidates)
    meshes, candidates = [meshes[index] for index in chosen], [candidates[index] for index in chosen]
    low, high = read_box([copy], mathutils.Matrix.Identity(4), copy.users_scene[0].view_layers[0].depsgraph)
    return Part(copy, meshes, candidates, (high - low) / unit)


def _assemble(
    asset: Asset,
    fingerprint: str,
    parts: Sequence[Part],
    combined: Sequence[tuple[LevelCandidate, tuple[int, ...]]],
    scene_clouds: Sequence[SceneCloud],
    base_size: float,
    settings: DistanceSettings,
) -> Chain:
    """Choose among the levels of all objects together, see `combine_levels`, and those of the cloud, and create the chain.

    base_size: of the pixels above which what the cloud was made of looks like the asset.
    """
    inverse, unit = asset.frame.inverted_safe(), mean_scale(asset.frame)
    quads = [(level, base_size + error / unit) for cloud in scene_clouds for level, error in zip(cloud.levels, cloud.errors, strict=True)]
    candidates = [candidate for candidate, _ in combined]
    candidates += [LevelCandidate(count_triangles(level.data), error) for level, error in quads]
    levels = []
    for index in choose_levels(candidates):
        if index < len(combined):
            indices = combined[index][1]
            shown = [(part, number) for part, number in zip(parts, indices, strict=True) if part.meshes[number] is not None]
            objects = [_create_object(part, number) for part, number in shown]
        else:
            level = quads[index - len(combined)][0]
            objects = [(level, inverse @ world_matrix(level))]
            for collection in list(level.users_collection):
                collection.objects.unlink(level)
        for item, _ in objects:
            item.name = f"{asset.name} Level {len(levels)}"
        levels.append(NewLevel(objects, candidates[index].pixel_size, candidates[index].triangles))
    return create_chain(asset.name, fingerprint, levels, (asset.low, asset.high), settings.fade_range)


def _create_object(part: Part, number: int) -> tuple[bpy.types.Object, mathutils.Matrix]:
    """Return a new object that shows a level of `part`, and its matrix."""
    mesh, matrix = part.meshes[number]
    if not number:
        return part.copy.copy(), matrix
    item = bpy.data.objects.new(part.copy.name, mesh)
    copy_render_properties(part.copy, item)
    return item, matrix
