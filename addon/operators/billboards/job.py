"""The job of the operator and the script: build billboard clouds of source objects and add them to the scene."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy

from ...bridge import images, meshes
from ...bridge.billboards import capture, clouds, transparent_bounces
from ...bridge.billboards.scene_clouds import read_cloud, store_source_names
from ...core.billboards.build import build_cloud
from ...core.billboards.cloud import Cloud
from ...core.billboards.settings import BillboardSettings
from ...core.errors import GeometryError
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.settings import Settings, setting

CAPTURE_FRACTION = 0.95  # of the progress of the scene steps


@dataclass(frozen=True, kw_only=True)
class BuildOptions(Settings):
    """Options of a build that concern the scene's objects."""

    combine_selected: bool = setting(False, "Build one cloud from all selected objects instead of one per object")
    keep_source_visible: bool = setting(
        False, "Keep the source objects visible after the build. When off, they are hidden in the viewport and in renders"
    )


@dataclass
class BillboardJob:
    """Builds one cloud per source. When the job is done, `built_clouds` holds each cloud with the name of its collection."""

    core_fraction = 0.35  # renders take longer than the search for planes

    sources: list[meshes.Source]
    settings: BillboardSettings
    options: BuildOptions
    scene_name: str
    skipped: list[str]
    built_clouds: list[tuple[str, Cloud]] = field(default_factory=list)
    linked_sources: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def core_steps(self) -> Steps[list[Cloud]]:
        """Find the quads of every source."""
        built = []
        for index, source in enumerate(self.sources):
            steps = build_cloud(source.geometry, self.settings, source.name)
            built.append((yield from subprogress(steps, *_progress_range(index, len(self.sources)))))
        return built

    def scene_steps(self, core_result: list[Cloud]) -> Steps[str]:
        """Capture the textures of every cloud, then create the objects of all clouds at once.

        Raises:
            GeometryError: the objects or materials were removed after the job started.
        """
        try:
            textures = yield from subprogress(self._capture(core_result), 0.0, CAPTURE_FRACTION)
            yield Progress(CAPTURE_FRACTION, "Creating objects")
            self._create_objects(core_result, textures)
        except ReferenceError:
            raise GeometryError("The source or its materials were removed while the cloud was being built; build it again.") from None
        return self._summary()

    def _capture(self, built: list[Cloud]) -> Steps[list]:
        started = time.perf_counter()
        textures = []
        for index, (source, cloud) in enumerate(zip(self.sources, built, strict=True)):
            if self.settings.textures:
                steps = capture.capture_textures(source, cloud, self.settings)
                textures.append((yield from subprogress(steps, *_progress_range(index, len(self.sources)))))
            else:
                textures.append(None)
        self.seconds["capture"] = time.perf_counter() - started
        return textures

    def _create_objects(self, built: list[Cloud], textures: list) -> None:
        started = time.perf_counter()
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")  # undo in Edit Mode covers only the edited mesh, not the objects created here
        scene = bpy.data.scenes[self.scene_name]
        for source, cloud, level_textures in zip(self.sources, built, textures, strict=True):
            collection = clouds.create_cloud(cloud, level_textures, source, scene.collection)
            store_source_names(collection, list(dict.fromkeys(instance.name for instance in source.instances)))
            self.built_clouds.append((collection.name, cloud))
            bounces = transparent_bounces.estimate_transparent_bounces(collection.objects)
            transparent_bounces.ensure_transparent_bounces(scene, bounces)
        if not self.options.keep_source_visible:
            for name, _ in self.built_clouds:
                scene_cloud = read_cloud(bpy.data.collections[name])
                scene_cloud.hide_sources()
                self.linked_sources += scene_cloud.linked_source_names
                scene_cloud.activate_visible(bpy.context)
        self.seconds["objects"] = time.perf_counter() - started

    def _summary(self) -> str:
        figures = [f'"{name}" ({", ".join(str(len(level.quads)) for level in cloud.levels)} quads)' for name, cloud in self.built_clouds]
        linked = f" {linked_sources_message(self.linked_sources)}" if self.linked_sources else ""
        skipped = f" Skipped: {'; '.join(self.skipped)}." if self.skipped else ""
        return f"Built {', '.join(figures)}.{linked}{skipped}"


def prepare_job(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: BillboardSettings, options: BuildOptions
) -> BillboardJob:
    """Return the job that builds clouds of `objects` in the scene of `context`.

    Raises:
        GeometryError: no cloud can be built from any of them; the message names each with the reason.
        FileError: an image file of a material is missing.
    """
    sources, skipped = read_sources(objects, context.evaluated_depsgraph_get(), options.combine_selected)
    if settings.textures:
        for source in sources:
            images.check_images(source)
    return BillboardJob(sources, settings, options, context.scene.name, skipped)


def read_sources(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph, combine: bool
) -> tuple[list[meshes.Source], list[str]]:
    """Read the sources of clouds from `objects`. Returns them and the skipped objects: names with reasons.

    A mesh with only vertices is a point cloud, which is always a source of its own, also with `combine`.

    Raises:
        GeometryError: there is no source.
    """
    candidates = [item for item in objects if clouds.KIND not in item]
    skipped = [f"{item.name} (made by Farfield)" for item in objects if clouds.KIND in item]
    point_clouds = [item for item in candidates if is_point_cloud(item, depsgraph)]
    sources = [meshes.read_point_cloud(item) for item in point_clouds]
    surfaces = [item for item in candidates if item not in point_clouds]
    if surfaces or not sources:
        sources += _read_surface_sources(surfaces, depsgraph, combine, skipped)
    return sources, skipped


def _read_surface_sources(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, combine: bool, skipped: list[str]
) -> list[meshes.Source]:
    """Return one source of all `objects`, or one per object with faces; add the other objects to `skipped`."""
    if not objects:
        raise GeometryError(f"Nothing to build a cloud from: {'; '.join(skipped) or 'no object is selected'}. Select an object with faces.")
    combined = meshes.read_source(objects, depsgraph)
    skipped += combined.skipped
    names = {instance.name for instance in combined.instances}
    if combine or len(names) == 1:
        return [combined]
    return [meshes.read_source([item], depsgraph) for item in objects if item.name in names]


def may_have_surface(item: bpy.types.Object) -> bool:
    """Return whether the type of `item` can have faces or points: a mesh, a curve and the like, or a collection instance."""
    return item.type in meshes.SURFACE_TYPES or (item.type == "EMPTY" and item.instance_type == "COLLECTION")


def is_point_cloud(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Return whether the evaluated `item` is a mesh with only vertices."""
    if item.type != "MESH" or item.mode == "EDIT":
        return False
    mesh = item.evaluated_get(depsgraph).data
    return len(mesh.vertices) > 0 and len(mesh.edges) == 0 and len(mesh.polygons) == 0


def linked_sources_message(names: Sequence[str]) -> str:
    """Return the sentence for source objects whose visibility cannot be changed."""
    return f"Visibility unchanged, linked from a library: {', '.join(dict.fromkeys(names))}."


def _progress_range(index: int, count: int) -> tuple[float, float]:
    return index / count, (index + 1) / count
