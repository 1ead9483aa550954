"""The job of the bake operator and script: bakes relightable textures for a billboard cloud in the scene."""

import shutil
import tempfile
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge.billboards import clouds
from ...bridge.billboards.level_objects import built_center, read_level_quads, read_level_texels, read_pbr_alpha
from ...bridge.billboards.scene_clouds import SceneCloud, read_cloud
from ...bridge.billboards.source_objects import read_source_objects
from ...bridge.btf.capture import snapshot as btf_snapshot
from ...bridge.btf.capture import source_renderers as btf_capture
from ...bridge.btf.capture import worker as btf_worker
from ...bridge.btf.levels import emission_levels as btf_clouds
from ...bridge.btf.levels.level_checks import check_editable, check_level, is_unchanged
from ...bridge.btf.levels.surface_levels import assign_surface_material, check_maps, read_two_sided_texels
from ...bridge.geometry import meshes
from ...bridge.imaging import images
from ...bridge.objects import find_by_uid
from ...bridge.shading.shared_parameters import Value, read_shared_parameters
from ...bridge.snapshots import may_run_python_drivers
from ...bridge.viewers import describe_solid_cloud
from ...core.billboards.texels import QuadPolygons, Texels
from ...core.btf.capture.capture_run import CaptureRun, render_missing_views
from ...core.btf.capture.capture_spec import LevelCaptureSpec
from ...core.btf.capture.observations import LOW_ORDER_LIGHTS
from ...core.btf.capture.shards import ShardLayout, ShardStore
from ...core.btf.compression import CompressedTextures, LevelCompressor
from ...core.btf.refinement.training import training_views
from ...core.btf.settings import SURFACE_CHANNELS, BtfSettings
from ...core.btf.surface_compression import SurfaceCompressor, SurfaceTextures
from ...core.errors import FarfieldError, FileError, GeometryError
from ...core.files.temporary_folders import folder_prefix
from ...core.files.user_folders import open_private_folder
from ...core.geometry.cameras import OrthographicView
from ...core.jobs import heartbeat
from ...core.jobs.dispatch import Shard
from ...core.jobs.executors import Executor, LocalExecutor, parse_executor
from ...core.jobs.progress import StageClock, Steps, subprogress
from ...core.messages import join_sentences
from . import estimates

CAPTURE_FRACTION = 0.8  # End of the capture in the progress bar.
COMPRESS_END, REFINE_END = 0.5, 0.9  # Fractions of the remaining progress of a level.


@dataclass(frozen=True)
class LevelBake:
    """One level to bake.

    Attributes:
        spec: Input of its capture.
        quads: Its polygons.
        views: Captured views.
        has_maps: Whether it has PBR maps.
        center: (3,) mean of its vertices when it was built.
        store: Finished views.
        open_compressor: Creates the compressor of its model, which takes memory.
    """

    spec: LevelCaptureSpec
    quads: QuadPolygons
    views: list[OrthographicView]
    has_maps: bool
    center: np.ndarray
    store: ShardStore
    open_compressor: Callable[[], LevelCompressor | SurfaceCompressor]


@dataclass(frozen=True)
class BakedLevel:
    """One baked level. max_depth_complexity: maximum number of its quads behind each other."""

    texels: Texels
    textures: CompressedTextures | SurfaceTextures
    max_depth_complexity: int


@dataclass
class BakeJob:
    """Bakes all levels of one cloud.

    Attributes:
        collection: Name of the cloud's collection.
        collection_uid: Its session UID, since the user may rename it.
        fingerprint: Fingerprint of the source.
        settings: Settings of the bake.
        executor: Where views are rendered.
        levels: Levels to bake.
        folder: Folder for finished views.
        run: The run that writes there.
        run_drivers: Whether drivers in the source may run any Python.
        parameters: Shared parameters of the source's shaders, see `read_shared_parameters`.
        keep_finished_views: Whether views stay when the job is finished; when it is cancelled they always stay.
        temporary_folder: Deletes the folder together with the job.
        figures: Description of each level, once the job is finished.
        clock: Run time per stage.
    """

    core_fraction = 0.9

    collection: str
    collection_uid: int
    fingerprint: str
    settings: BtfSettings
    executor: Executor
    levels: list[LevelBake]
    folder: Path
    run: CaptureRun
    run_drivers: bool
    parameters: dict[str, Value]
    keep_finished_views: bool
    temporary_folder: tempfile.TemporaryDirectory | None
    figures: list[dict[str, Any]] = field(default_factory=list)
    clock: StageClock = field(default_factory=StageClock)
    _rendered_count: int = 0

    def core_steps(self) -> Steps[list[BakedLevel]]:
        """Let worker processes capture missing views, then compress.

        Raises:
            FarfieldError: if workers fail; see `render_missing_views`.
        """
        with closing(self.run):
            with self.clock.stage("capture"):
                self._rendered_count = yield from subprogress(self._capture(), 0.0, CAPTURE_FRACTION)
            baked = []
            for index in range(len(self.levels)):
                span = (CAPTURE_FRACTION + (1.0 - CAPTURE_FRACTION) * i / len(self.levels) for i in (index, index + 1))
                baked.append((yield from subprogress(self._renewing(self._compress(index)), *span)))
            return baked

    def scene_steps(self, core_result: list[BakedLevel]) -> Steps[str]:
        """Assign the relightable materials of all levels.

        Raises:
            GeometryError: if the cloud was removed or rebuilt in the meantime.
        """
        yield from ()
        cloud = self._find_cloud()
        is_complete = self._rendered_count == self.settings.view_count * len(self.levels)
        if is_complete and isinstance(self.executor, LocalExecutor):  # Estimates are of bakes on this machine.
            estimates.cache.remember_pace(cloud, self.settings, sum(self.clock.seconds.values()))
        with self.clock.stage("assign"):
            for level_object, baked in zip(cloud.levels, core_result, strict=True):
                if self.settings.bakes_emission:
                    btf_clouds.assign_relightable_material(level_object, baked.texels, baked.textures, self.settings)
                else:
                    assign_surface_material(level_object, baked.texels, baked.textures, self.settings, self.parameters)
            btf_clouds.raise_transparent_bounces(cloud.collection, max(baked.max_depth_complexity for baked in core_result))
        if self.temporary_folder is not None:
            self.temporary_folder.cleanup()
        elif not self.keep_finished_views and not heartbeat.is_alive(self.folder):  # Another Blender may have started the same bake.
            shutil.rmtree(self.folder, ignore_errors=True)
        message = f'Baked "{self.collection}": {sum(figure["renders"] for figure in self.figures):,} renders.'
        return join_sentences([message, describe_solid_cloud()])

    def _capture(self) -> Steps[int]:
        """Let worker processes capture missing views; return their number."""
        stores = [level.store for level in self.levels]
        return render_missing_views(self.run.heartbeat, stores, len(self.settings.view_grid), self.executor, self._shard_command)

    def _shard_command(self, shard: Shard[int]) -> list[str]:
        return btf_worker.shard_command(self.folder, self.run.snapshot_folder, shard, run_drivers=self.run_drivers)

    def _renewing(self, steps: Steps[BakedLevel]) -> Steps[BakedLevel]:
        """Run `steps` and touch the heartbeat file at each: the finished views are still in use. Raises FileError if another run starts."""
        with closing(steps):
            try:
                while True:
                    step = next(steps)
                    self.run.heartbeat.renew()
                    yield step
            except StopIteration as end:
                return end.value

    def _find_cloud(self) -> SceneCloud:
        """Return the cloud, which the user may have changed during the renders."""
        collection = find_by_uid(bpy.data.collections, self.collection_uid) or bpy.data.collections.get(self.collection)
        cloud = read_cloud(collection) if collection is not None else None
        if cloud is None:
            raise GeometryError(f'The cloud "{self.collection}" was removed while it was being baked; build and bake it again.')
        if cloud.collection.get(clouds.FINGERPRINT) != self.fingerprint or len(cloud.levels) != len(self.levels):
            raise GeometryError(f'The cloud "{self.collection}" was rebuilt while it was being baked; bake it again.')
        check_editable(cloud)
        for level_object, level in zip(cloud.levels, self.levels, strict=True):
            if not is_unchanged(level_object, level.quads, level.has_maps):
                raise GeometryError(f'The level "{level_object.name}" was changed while it was being baked; undo that and bake again.')
        return cloud

    def _compress(self, index: int) -> Steps[BakedLevel]:
        """Compress the textures of one level. All its views must be finished."""
        level = self.levels[index]
        texels, store, settings = level.spec.texels, level.store, self.settings
        compressor = level.open_compressor()
        with self.clock.stage("compress"):
            textures = yield from subprogress(compressor.compress(), 0.0, COMPRESS_END)
        with self.clock.stage("refine"):
            training = training_views(level.quads, texels, level.views, store)
            if settings.refine:
                textures = yield from subprogress(compressor.refine(textures, training), COMPRESS_END, REFINE_END)
            max_depth_complexity = max(view.max_depth_complexity() for view in training)
        component_errors = []
        if settings.bakes_emission:
            with self.clock.stage("measure"):
                component_errors = yield from subprogress(compressor.measure_error(textures), REFINE_END, 1.0)
        view_count, renders_per_view = settings.view_count, settings.images_per_view
        self.figures.append(
            {
                "level": index,
                "renders": view_count * renders_per_view,
                "shards": view_count,
                "texels": len(texels),
                "max_depth_complexity": max_depth_complexity,
                "bare_render_seconds": round(store.render_seconds(view_count), 3),
                "raw_bytes": 2 * 3 * len(texels) * view_count * renders_per_view,
                "captured_bytes": store.total_bytes(view_count),
                "compressed_bytes": textures.nbytes,
                "component_errors": [asdict(error) for error in component_errors],
            }
        )
        return BakedLevel(texels, textures, max_depth_complexity)


def prepare_bake(
    context: bpy.types.Context,
    cloud: SceneCloud,
    settings: BtfSettings,
    work_folder: Path | None,
    keep_finished_views: bool,
    executor: Executor | None = None,
) -> BakeJob:
    """Prepare the bake of `cloud`. Its source objects must be unchanged since the cloud was built; see `BakeJob`.

    work_folder: for finished views; None for a temporary one that is deleted with the job. All input of the workers is written there now.
    executor: where views are rendered; that of the settings if it is None.

    Raises:
        GeometryError: if a source object was removed or edited, or an older version of Farfield built the cloud.
        FileError: if an image file of a material is missing, or the folder belongs to another bake or cannot be written.
        SettingsError: see `BtfSettings.check_table_size`; or if the executor does not exist.
    """
    settings.check_table_size()
    executor = parse_executor(settings.executor) if executor is None else executor
    check_editable(cloud)
    name = cloud.collection.name
    source_objects, missing = cloud.sources, cloud.missing_source_names
    if missing or not source_objects:
        raise GeometryError(f'Source objects of "{name}" are missing: {", ".join(missing)}. Restore them or rebuild the cloud.')
    if clouds.DRAWN not in cloud.levels[0].data or clouds.FINGERPRINT not in cloud.collection:
        raise GeometryError(f'"{name}" was built by an older version of Farfield; rebuild the cloud.')
    source = read_source_objects(context, source_objects)
    if source.fingerprint != cloud.collection[clouds.FINGERPRINT]:
        raise GeometryError(f'The source objects of "{name}" were edited or moved after the cloud was built; rebuild the cloud.')
    images.check_images(source)
    for level_object in cloud.levels:
        check_level(level_object, source)
        if not settings.bakes_emission:
            check_maps(level_object)
    temporary_folder = _create_temporary_folder() if work_folder is None else None
    folder = work_folder if temporary_folder is None else Path(temporary_folder.name)
    open_private_folder(folder)
    levels = [_read_level(level_object, source, settings, folder, index) for index, level_object in enumerate(cloud.levels)]
    for level in levels:
        level.store.open(f"{source.fingerprint} {settings.capture_fingerprint} {len(level.spec.texels)} {level.spec.error:.9g}")
    run = CaptureRun(folder)  # From here on, no other run writes to the folder.
    try:
        btf_snapshot.write_snapshot(run.snapshot_folder, context.scene, source_objects, source, [level.spec for level in levels], settings)
    except FarfieldError:
        with closing(run):
            run.heartbeat.renew()  # The error may be that another run has taken over.
        raise
    return BakeJob(
        collection=name,
        collection_uid=cloud.collection.session_uid,
        fingerprint=source.fingerprint,
        settings=settings,
        executor=executor,
        levels=levels,
        folder=folder,
        run=run,
        run_drivers=may_run_python_drivers(),
        parameters=read_shared_parameters(source.materials),
        keep_finished_views=keep_finished_views,
        temporary_folder=temporary_folder,
    )


def _read_level(level_object: bpy.types.Object, source: meshes.Source, settings: BtfSettings, folder: Path, index: int) -> LevelBake:
    center = built_center(level_object, source.origin)
    texels, quads = read_level_texels(level_object, center), read_level_quads(level_object, center)
    views = btf_capture.build_views(source, settings.view_grid, texels.texel_size)
    spec = LevelCaptureSpec(texels, *clouds.read_drawn_primitives(level_object.data), float(level_object["farfield_error"]))
    reference_count = LOW_ORDER_LIGHTS if settings.bakes_emission else SURFACE_CHANNELS
    counts = len(texels), settings.images_per_view, reference_count, views[0].resolution, settings.view_count, settings.shadow_count
    store = ShardStore(btf_snapshot.store_folder(folder, index), ShardLayout(*counts))
    if settings.bakes_emission:
        surface = btf_clouds.read_texel_surface(level_object, texels)
        has_maps = surface is not None
        open_compressor = partial(LevelCompressor, store, texels, read_pbr_alpha(level_object, texels), surface, settings)
    else:
        has_maps = True
        open_compressor = partial(SurfaceCompressor, store, read_two_sided_texels(level_object, texels), settings)
    return LevelBake(spec, quads, views, has_maps, center, store, open_compressor)


def _create_temporary_folder() -> tempfile.TemporaryDirectory:
    try:
        return tempfile.TemporaryDirectory(prefix=folder_prefix(), ignore_cleanup_errors=True)
    except OSError as error:
        raise FileError(f"No temporary folder can be created ({error.strerror}); free some space on that disk.") from error
