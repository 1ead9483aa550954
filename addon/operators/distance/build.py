"""Builds the chain of levels of one asset in a temporary scene, with the jobs of perceptual levels and billboard clouds."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import mathutils

from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_in
from ...bridge.distance.assets import Asset, count_own_triangles
from ...bridge.distance.chains import Chain, NewLevel, create_chain
from ...bridge.distance.level_switch import level_modifiers
from ...bridge.geometry.mesh_arrays import count_triangles
from ...bridge.objects import world_matrix
from ...bridge.rendering.render_properties import copy_render_properties
from ...bridge.texmesh.level_sets import LevelSet, level_sets_in, remove_level_set
from ...core.billboards.settings import BillboardSettings, BuildOptions
from ...core.distance.levels import LevelCandidate, choose_levels, combine_levels
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
LEVELS_FRACTION = 0.5  # Of the work on an asset.


@dataclass(frozen=True)
class Part:
    """An object of an asset, and its levels. copy: of the object. meshes: of the levels and their matrices in the asset, finest first, of
    which the first is that of the object. candidates: the same as numbers, in units of the asset."""

    copy: bpy.types.Object
    meshes: list[tuple[bpy.types.Mesh, mathutils.Matrix]]
    candidates: list[LevelCandidate]


def build_chain(asset: Asset, fingerprint: str, settings: DistanceSettings, remarks: list[str]) -> Steps[Chain]:
    """Make the levels of an asset. What could not be made is added to `remarks`."""
    with temporary_scene() as scene:
        copies = [_copy_object(item, scene) for item in asset.objects]
        fraction = LEVELS_FRACTION if settings.perceptual_levels and settings.billboard_cloud else float(settings.perceptual_levels)
        if settings.perceptual_levels:
            yield from subprogress(_run(scene, lambda: _prepare_levels(copies), f'levels of "{asset.name}"', remarks), 0.0, fraction)
        if settings.billboard_cloud:
            yield from subprogress(_run(scene, lambda: _prepare_cloud(copies), f'cloud of "{asset.name}"', remarks), fraction, 1.0)
        yield Progress(1.0, "Creating levels")
        parts = [_read_part(asset, item, copy, level_sets_in(scene)) for item, copy in zip(asset.objects, copies, strict=True)]
        return _assemble(asset, fingerprint, parts, clouds_in(scene), settings)


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


def _prepare_cloud(copies: Sequence[bpy.types.Object]) -> Job:
    options = BuildOptions(combine_selected=True, keep_original_visible=True)
    return prepare_job(bpy.context, copies, BillboardSettings(levels=CLOUD_LEVELS), options)


def _run(scene: bpy.types.Scene, prepare: Callable[[], Job], subject: str, remarks: list[str]) -> Steps[None]:
    """Prepare and run a job in another scene. Its first half runs in a thread, so that the interface stays usable. If it fails, its error
    becomes a remark."""
    context = {"scene": scene, "view_layer": scene.view_layers[0]}
    try:
        with bpy.context.temp_override(**context):
            scene.view_layers[0].update()
            job = prepare()
        result = yield from subprogress(_wait_for_core(job), 0.0, job.core_fraction)
        yield from subprogress(_in_scene(job.scene_steps(result), context), job.core_fraction, 1.0)
    except Cancelled:
        raise
    except FarfieldError as error:
        remarks.append(f"No {subject}: {error}")


def _wait_for_core(job: Job) -> Steps[object]:
    thread = BackgroundThread(job.core_steps())
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


def _read_part(asset: Asset, item: bpy.types.Object, copy: bpy.types.Object, sets: Sequence[LevelSet]) -> Part:
    """Return an object of an asset with its perceptual levels, if it has any."""
    inverse = asset.frame.inverted_safe()
    unit = mean_scale(asset.frame)
    meshes, candidates = [(item.data, inverse @ world_matrix(item))], []
    for levels in (levels for levels in sets if levels.source == copy):
        for level, error in zip(levels.levels, levels.errors, strict=True):
            world = world_matrix(level)
            candidates.append(LevelCandidate(count_triangles(level.data), error * mean_scale(world) / unit))
            if len(candidates) > 1:
                meshes.append((level.data, inverse @ world))
    if not candidates:
        evaluated = copy.evaluated_get(copy.users_scene[0].view_layers[0].depsgraph)
        candidates.append(LevelCandidate(count_own_triangles(evaluated), 0.0))
    return Part(copy, meshes, candidates)


def _assemble(
    asset: Asset, fingerprint: str, parts: Sequence[Part], scene_clouds: Sequence[SceneCloud], settings: DistanceSettings
) -> Chain:
    """Choose among the levels of all objects together and those of the cloud, and create the chain."""
    combined = combine_levels([part.candidates for part in parts])
    inverse, unit = asset.frame.inverted_safe(), mean_scale(asset.frame)
    quads = [(level, error / unit) for cloud in scene_clouds for level, error in zip(cloud.levels, cloud.errors, strict=True)]
    candidates = [candidate for candidate, _ in combined]
    candidates += [LevelCandidate(count_triangles(level.data), error) for level, error in quads]
    copies: dict[bpy.types.Material, bpy.types.Material] = {}
    levels = []
    for index in choose_levels(candidates):
        if index < len(combined):
            indices = combined[index][1]
            objects = [_create_object(part, number, copies) for part, number in zip(parts, indices, strict=True)]
        else:
            level = quads[index - len(combined)][0]
            objects = [(level, inverse @ world_matrix(level))]
            for collection in list(level.users_collection):
                collection.objects.unlink(level)
        for item, _ in objects:
            item.name = f"{asset.name} Level {len(levels)}"
        levels.append(NewLevel(objects, candidates[index].pixel_size, candidates[index].triangles))
    return create_chain(asset.name, fingerprint, levels, (asset.low, asset.high), settings.fade_range)


def _create_object(
    part: Part, number: int, copies: dict[bpy.types.Material, bpy.types.Material]
) -> tuple[bpy.types.Object, mathutils.Matrix]:
    """Return a new object that shows a level of `part`, and its matrix. That of the first level has copies of the materials of the
    original, so that a cross-fade leaves these as they are."""
    mesh, matrix = part.meshes[number]
    if number:
        item = bpy.data.objects.new(part.copy.name, mesh)
        copy_render_properties(part.copy, item)
        return item, matrix
    item = part.copy.copy()
    for slot in item.material_slots:
        material = slot.material
        if material is not None:
            copies.setdefault(material, None)
            copies[material] = copies[material] or material.copy()
            slot.link, slot.material = "OBJECT", copies[material]
    return item, matrix
