"""The job of the operator and the script: build billboard clouds of source objects and add them to the scene."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import bpy

from ...bridge.billboards import capture, clouds
from ...bridge.billboards.decimate_comparison import can_compare, compare_with_decimate
from ...bridge.billboards.luminance_fit import fit_luminance
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_of_levels, read_cloud
from ...bridge.billboards.source_losses import describe_source_losses
from ...bridge.geometry import meshes
from ...bridge.imaging import images
from ...bridge.objects import find_by_uid, instances_lights
from ...bridge.rendering import render_properties
from ...bridge.source_links import store_sources
from ...bridge.viewers import describe_solid_cloud
from ...core.billboards.build import build_cloud
from ...core.billboards.cloud import Cloud
from ...core.billboards.comparison import LevelComparison, describe_comparison
from ...core.billboards.settings import BillboardSettings, BuildOptions
from ...core.errors import GeometryError
from ...core.geometry.local_origin import describe_coarseness
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count
from .sources import linked_sources_message, read_sources

LUMINANCE_FRACTION = 0.6  # End of the renders of the maps in the progress of the capture of one source.
CAPTURE_FRACTION = 0.9  # End of the capture in the progress of the scene steps.


@dataclass
class BillboardJob:
    """Builds one cloud per source.

    Attributes:
        sources: What to build clouds of.
        settings: Settings of the clouds.
        options: Settings that concern the selected objects.
        scene_uid: Session UID of the scene.
        rebuilt_uids: Session UIDs of the collections of clouds that are built again.
        skipped: Names of other objects with the reason.
        built_clouds: Each cloud with the name of its collection, once the job is done.
        linked_sources: Names of source objects whose visibility cannot be changed.
        hidden_clouds: Names of clouds that were hidden.
        comparisons: Per cloud, its levels compared with decimated meshes, as far as they can be.
        seconds: Run time per stage.
    """

    core_fraction = 0.35  # Renders take longer than the search for planes.

    sources: list[meshes.Source]
    settings: BillboardSettings
    options: BuildOptions
    scene_uid: int
    rebuilt_uids: list[int]
    skipped: list[str]
    built_clouds: list[tuple[str, Cloud]] = field(default_factory=list)
    linked_sources: list[str] = field(default_factory=list)
    hidden_clouds: list[str] = field(default_factory=list)
    comparisons: list[list[LevelComparison]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def core_steps(self) -> Steps[list[Cloud]]:
        """Find the quads of every source."""
        built = []
        for index, source in enumerate(self.sources):
            steps = build_cloud(source.geometry, self.settings, source.name)
            built.append((yield from subprogress(steps, *_progress_range(index, len(self.sources)))))
        return built

    def scene_steps(self, core_result: list[Cloud]) -> Steps[str]:
        """Capture the textures of every cloud and compare the levels with decimated meshes, then add the objects of all clouds at once.

        Raises:
            GeometryError: an object, a material or the scene was removed after the job started; nothing was created.
        """
        uids: list[int] = []
        is_complete = False
        try:
            if self.settings.textures:
                core_result = [
                    replace(cloud, notes=[*cloud.notes, *describe_source_losses(source)])
                    for source, cloud in zip(self.sources, core_result, strict=True)
                ]
            textures = yield from subprogress(self._capture(core_result), 0.0, CAPTURE_FRACTION)
            yield Progress(CAPTURE_FRACTION, "Creating objects")
            uids += self._build_collections(core_result, textures)
            yield from subprogress(self._compare(uids), CAPTURE_FRACTION, 1.0)
            self._add_to_scene(core_result, uids)
            is_complete = True
        except ReferenceError:
            raise GeometryError("The original or its materials were removed while the cloud was being built; build it again.") from None
        finally:
            for collection in [] if is_complete else [find_by_uid(bpy.data.collections, uid) for uid in uids]:
                if collection is not None:
                    clouds.discard_collection(collection)
        return self._summary()

    def _capture(self, built: list[Cloud]) -> Steps[list]:
        started = time.perf_counter()
        textures = []
        for index, (source, cloud) in enumerate(zip(self.sources, built, strict=True)):
            if self.settings.textures:
                steps = self._capture_source(source, cloud)
                textures.append((yield from subprogress(steps, *_progress_range(index, len(self.sources)))))
            else:
                textures.append(None)
        self.seconds["capture"] = time.perf_counter() - started
        return textures

    def _capture_source(self, source: meshes.Source, cloud: Cloud) -> Steps[list]:
        textures = yield from subprogress(capture.capture_textures(source, cloud, self.settings), 0.0, LUMINANCE_FRACTION)
        objects = _find_objects(source)
        if source.mesh is None or instances_lights(objects):
            return textures
        started = time.perf_counter()
        fit = fit_luminance(source, objects, cloud, textures)
        textures = yield from subprogress(fit, LUMINANCE_FRACTION, 1.0)
        self.seconds["luminance"] = self.seconds.get("luminance", 0.0) + time.perf_counter() - started
        return textures

    def _build_collections(self, built: list[Cloud], textures: list) -> list[int]:
        """Create the collection of each cloud, not yet in the scene, and return their session UIDs."""
        started, scene = time.perf_counter(), self._find_scene()
        for source in self.sources:
            _find_objects(source)
        collections = [
            clouds.build_collection(cloud, level_textures, source, scene.collection)
            for source, cloud, level_textures in zip(self.sources, built, textures, strict=True)
        ]
        self.seconds["objects"] = time.perf_counter() - started
        return [collection.session_uid for collection in collections]

    def _compare(self, uids: list[int]) -> Steps[None]:
        """Compare the levels of each cloud with decimated meshes."""
        started = time.perf_counter()
        for index, (source, uid) in enumerate(zip(self.sources, uids, strict=True)):
            objects, found = _find_objects(source), []
            if self.settings.textures and can_compare(source, objects):
                levels = find_by_uid(bpy.data.collections, uid).objects[:]
                steps = compare_with_decimate(source, objects, levels)
                found = yield from subprogress(steps, *_progress_range(index, len(self.sources)))
            self.comparisons.append(found)
        self.seconds["comparison"] = time.perf_counter() - started

    def _add_to_scene(self, built: list[Cloud], uids: list[int]) -> None:
        started, scene = time.perf_counter(), self._find_scene()
        objects_of_sources = [_find_objects(source) for source in self.sources]
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")  # Undo in Edit Mode covers only the edited mesh, not the objects created here.
        scene_clouds = []
        for uid, cloud, objects, comparison in zip(uids, built, objects_of_sources, self.comparisons, strict=True):
            collection = find_by_uid(bpy.data.collections, uid)
            sentence = describe_comparison(comparison)
            cloud = replace(cloud, notes=[*([sentence] if sentence else []), *cloud.notes])
            clouds.write_notes(collection, cloud.notes)
            scene.collection.children.link(collection)
            store_sources(collection, objects)
            self.built_clouds.append((collection.name, cloud))
            bounces = render_properties.estimate_transparent_bounces(collection.objects)
            render_properties.ensure_transparent_bounces(scene, bounces)
            scene_clouds.append(read_cloud(collection))
        self._hide_rebuilt_clouds(scene_clouds)
        for scene_cloud in scene_clouds:
            if not self.options.keep_original_visible:
                scene_cloud.hide_sources()
                self.linked_sources += scene_cloud.linked_source_names
            elif self.rebuilt_uids:
                scene_cloud.unhide_sources()
            scene_cloud.activate_visible(bpy.context)
        self.seconds["objects"] += time.perf_counter() - started

    def _find_scene(self) -> bpy.types.Scene:
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        if scene is None:
            raise GeometryError("The scene was removed while the cloud was being built; build it again.")
        return scene

    def _hide_rebuilt_clouds(self, scene_clouds: list[SceneCloud]) -> None:
        """Hide the selected clouds that were built again as `scene_clouds`: both stand in the same place."""
        for uid in self.rebuilt_uids:
            collection = find_by_uid(bpy.data.collections, uid)
            earlier = None if collection is None else read_cloud(collection)
            if earlier is not None and earlier.is_editable:
                is_active = bpy.context.view_layer.objects.active in earlier.levels
                earlier.hide_cloud()
                self.hidden_clouds.append(collection.name)
                for cloud in scene_clouds if is_active else ():
                    if not set(earlier.sources).isdisjoint(cloud.sources):
                        cloud.activate(bpy.context)

    def _summary(self) -> str:
        figures = [f'"{name}" ({_describe_levels(cloud)})' for name, cloud in self.built_clouds]
        notes = "".join(f" {note}" for _, cloud in self.built_clouds for note in cloud.notes)
        linked = f" {linked_sources_message(self.linked_sources)}" if self.linked_sources else ""
        hidden = f" Hidden: {', '.join(self.hidden_clouds)}." if self.hidden_clouds else ""
        skipped = f" Skipped: {'; '.join(self.skipped)}." if self.skipped else ""
        read = {(instance.name, id(instance.mesh)): instance for source in self.sources for instance in source.instances}.values()
        rounded = "".join(f" {text}" for item in read if (text := describe_coarseness(item.mesh.vertices, f'"{item.name}"', "it")))
        view = f" {text}" if self.settings.textures and (text := describe_solid_cloud()) else ""
        return f"Built {', '.join(figures)}.{view}{notes}{hidden}{linked}{rounded}{skipped}"


def _describe_levels(cloud: Cloud) -> str:
    """Return the numbers of triangles, also of those in meshes, and of quads of all levels."""
    return "; ".join(describe_counts(level.triangle_count, level.chart_triangle_count, len(level.quads)) for level in cloud.levels)


def describe_counts(triangles: int, mesh_triangles: int, quads: int) -> str:
    """Return the number of triangles of a level, how many of them belong to decimated meshes, and that of its quads, as text."""
    in_meshes = f" ({mesh_triangles:,} in meshes)" if mesh_triangles else ""
    return f"{format_count(triangles, 'triangle')}{in_meshes}, {format_count(quads, 'quad')}"


def prepare_job(
    context: bpy.types.Context,
    objects: Sequence[bpy.types.Object],
    settings: BillboardSettings,
    options: BuildOptions,
    name: str = "",
) -> BillboardJob:
    """Return the job that builds clouds of `objects` in the scene of `context`.

    name: of a cloud of several objects, in place of that which `read_combined` finds.

    Raises:
        GeometryError: no cloud can be built from any of them; the message names each with the reason.
        FileError: an image file of a material is missing.
    """
    sources, skipped = read_sources(context, objects, options.combine_selected)
    if name and len(sources) == 1 and len({instance.object_uid for instance in sources[0].instances}) > 1:
        sources = [replace(sources[0], name=name)]
    if settings.textures:
        for source in sources:
            images.check_images(source)
    source_uids = {instance.object_uid for source in sources for instance in source.instances}
    rebuilt = [
        cloud for cloud in clouds_of_levels(context.scene, objects) if source_uids.issuperset(item.session_uid for item in cloud.sources)
    ]
    rebuilt_uids = [cloud.collection.session_uid for cloud in rebuilt if cloud.sources]
    return BillboardJob(sources, settings, options, context.scene.session_uid, rebuilt_uids, skipped)


def _find_objects(source: meshes.Source) -> list[bpy.types.Object]:
    """Return the objects that `source` was read from, also if they were renamed.

    Raises:
        GeometryError: one was removed.
    """
    found = []
    for uid, name in {instance.object_uid: instance.name for instance in source.instances}.items():
        item = find_by_uid(bpy.data.objects, uid)
        if item is None:
            raise GeometryError(f'The original "{name}" was removed while its cloud was being built; build it again.')
        found.append(item)
    return found


def _progress_range(index: int, count: int) -> tuple[float, float]:
    return index / count, (index + 1) / count
