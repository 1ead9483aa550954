"""The job behind the button and the script: sources in, billboard clouds in the scene out."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy

from ..bridge import capture, clouds, images, meshes
from ..core.billboards.build import build
from ..core.billboards.cloud import Cloud
from ..core.billboards.settings import BillboardSettings
from ..core.errors import GeometryError
from ..core.progress import Progress, Steps, scaled
from ..core.settings import Settings, setting
from .billboards_clouds import remember_sources

RENDERS = 0.95  # of the half that uses Blender


@dataclass(frozen=True, kw_only=True)
class BuildOptions(Settings):
    """What a user can choose about the objects, not about the clouds."""

    together: bool = setting(False, "Make one cloud of all selected objects instead of one each")
    hide_source_from_render: bool = setting(False, "Disable the source objects in renders once their clouds stand")


@dataclass
class BillboardJob:
    """Builds one cloud for each source; `made` holds them, each with the name of its collection, once the job is done."""

    core_share = 0.35  # renders take longer than the search for planes

    sources: list[meshes.Source]
    settings: BillboardSettings
    options: BuildOptions
    scene_name: str
    skipped: list[str]
    made: list[tuple[str, Cloud]] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def core_steps(self) -> Steps[list[Cloud]]:
        """Find the quads of every source."""
        built = []
        for index, source in enumerate(self.sources):
            steps = build(source.geometry, self.settings, source.name)
            built.append((yield from scaled(steps, *_span(index, len(self.sources)))))
        return built

    def scene_steps(self, core_result: list[Cloud]) -> Steps[str]:
        """Capture the textures of every cloud, then make all clouds at once.

        Raises:
            GeometryError: when the objects or materials have gone since the job began.
        """
        try:
            textures = yield from scaled(self._capture(core_result), 0.0, RENDERS)
            yield Progress(RENDERS, "Making objects")
            self._make(core_result, textures)
        except ReferenceError:
            raise GeometryError("The source or its materials were removed while the cloud was being built; build it again.") from None
        return self._sentence()

    def _capture(self, built: list[Cloud]) -> Steps[list]:
        started = time.perf_counter()
        textures = []
        for index, (source, cloud) in enumerate(zip(self.sources, built, strict=True)):
            if self.settings.textures:
                steps = capture.capture(source, cloud, self.settings)
                textures.append((yield from scaled(steps, *_span(index, len(self.sources)))))
            else:
                textures.append(None)
        self.seconds["capture"] = time.perf_counter() - started
        return textures

    def _make(self, built: list[Cloud], textures: list) -> None:
        started = time.perf_counter()
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")  # undo in Edit Mode knows the edited mesh only, not the objects made here
        scene = bpy.data.scenes[self.scene_name]
        for source, cloud, level_textures in zip(self.sources, built, textures, strict=True):
            collection = clouds.make_cloud(cloud, level_textures, source, scene.collection)
            names = list(dict.fromkeys(part.name for part in source.parts))
            remember_sources(collection, names)
            self.made.append((collection.name, cloud))
            clouds.allow_transparent_bounces(scene, clouds.needed_transparent_bounces(collection.objects))
            if self.options.hide_source_from_render:
                for name in names:
                    bpy.data.objects[name].hide_render = True
        self.seconds["objects"] = time.perf_counter() - started

    def _sentence(self) -> str:
        figures = [f'"{name}" ({", ".join(str(len(level.quads)) for level in cloud.levels)} quads)' for name, cloud in self.made]
        skipped = f" Skipped: {'; '.join(self.skipped)}." if self.skipped else ""
        return f"Made {', '.join(figures)}.{skipped}"


def prepare(
    context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: BillboardSettings, options: BuildOptions
) -> BillboardJob:
    """The job that builds clouds of `objects` in the scene of `context`.

    Raises:
        GeometryError: when none of them can be built from; its sentence names each and why.
        FileError: when a material needs an image file that is missing.
    """
    sources, skipped = take_sources(objects, context.evaluated_depsgraph_get(), options.together)
    if settings.textures:
        for source in sources:
            images.check_images(source)
    return BillboardJob(sources, settings, options, context.scene.name, skipped)


def take_sources(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph, together: bool
) -> tuple[list[meshes.Source], list[str]]:
    """The sources of clouds among `objects`, and what is skipped: names with reasons.

    A mesh of vertices alone is a point cloud and gets a source of its own, `together` or not.

    Raises:
        GeometryError: when there is none.
    """
    chosen = [item for item in objects if clouds.KIND not in item]
    skipped = [f"{item.name} (made by Farfield)" for item in objects if clouds.KIND in item]
    points = [item for item in chosen if is_point_cloud(item, depsgraph)]
    sources = [meshes.take_points(item) for item in points]
    solid = [item for item in chosen if item not in points]
    if solid or not sources:
        sources += _solid_sources(solid, depsgraph, together, skipped)
    return sources, skipped


def _solid_sources(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, together: bool, skipped: list[str]
) -> list[meshes.Source]:
    """One source of all `objects` or one of each that has faces; the others are added to `skipped`."""
    if not objects:
        raise GeometryError(f"Nothing to build a cloud from: {'; '.join(skipped) or 'no object is selected'}. Select an object with faces.")
    whole = meshes.take(objects, depsgraph)
    skipped += whole.skipped
    names = {part.name for part in whole.parts}
    if together or len(names) == 1:
        return [whole]
    return [meshes.take([item], depsgraph) for item in objects if item.name in names]


def may_have_surface(item: bpy.types.Object) -> bool:
    """Whether `item` is of a kind that can have faces or points: a mesh, a curve and the like, or an instance of a collection."""
    return item.type in meshes.SURFACE_TYPES or (item.type == "EMPTY" and item.instance_type == "COLLECTION")


def is_point_cloud(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether `item` is a mesh of vertices alone, once its modifiers have worked."""
    if item.type != "MESH" or item.mode == "EDIT":
        return False
    mesh = item.evaluated_get(depsgraph).data
    return len(mesh.vertices) > 0 and len(mesh.edges) == 0 and len(mesh.polygons) == 0


def _span(index: int, count: int) -> tuple[float, float]:
    return index / count, (index + 1) / count
