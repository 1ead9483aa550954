"""The job of the operator *Merge*: reads photographs, unwraps meshes without a UV map, and writes texture and material."""

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space
from ...bridge.objects import find_by_uid
from ...bridge.photos.material_groups import SUFFIX, MaterialGroups, assign_to_materials, read_material_groups
from ...bridge.photos.photo_images import PhotoSource
from ...bridge.photos.results import assign_texture, create_maps, create_textures
from ...bridge.photos.surfaces import check_separate_uvs, read_surface, select_faces, split_layout, to_projection
from ...core.errors import GeometryError
from ...core.files.scratch import Scratch
from ...core.geometry.cameras import CameraProjection
from ...core.geometry.local_origin import describe_coarseness
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, join_sentences, quote_names
from ...core.photos.merging import merge
from ...core.photos.photo_texture import PhotoTexture
from ...core.photos.settings import PhotosSettings
from ...core.photos.texels.pages import PageLayout, describe_overlaps, find_overlapping, lay_out_pages
from ...core.unwrap.settings import UnwrapSettings
from ...core.unwrap.unwrapping import UnwrapResult
from ..unwrap import job as unwrap_job
from .sources import open_photographs, read_photographs, read_targets

READING_END, UNWRAPPING_END = 0.02, 0.15  # fractions of the progress bar, by the time that they take
DENSITY_RATIO = 5.0**0.5  # from the importance 1 / (<N, V> + 1.5) (Textures Revisited, section 6)
MIN_QUALITY = 0.05

CoreResult = tuple[list[UnwrapResult], PageLayout, PhotoTexture]


@dataclass
class MergeJob:
    """Merges photographs into one texture for all targets, or for each of their materials.

    Attributes:
        targets: session UIDs and names of the objects.
        instances: their surfaces.
        sources: the photographs.
        settings: how they are merged.
        unwrapping: the job that unwraps all targets, None if they have UV maps.
        groups: the materials of all triangles, if each gets its own texture.
        has_maps: whether to create images of confidence, source and holes, too.
        skipped: other objects with the reason.
    """

    core_fraction = 0.95

    targets: list[tuple[int, str]]
    instances: list[SourceInstance]
    sources: list[PhotoSource]
    settings: PhotosSettings
    unwrapping: unwrap_job.UnwrapJob | None
    groups: MaterialGroups | None
    has_maps: bool
    skipped: list[str]

    def core_steps(self) -> Steps[CoreResult]:
        """Read the photographs, unwrap and merge."""
        unwrapped, new_uvs, end = [], {}, READING_END
        with Scratch() as scratch:
            photographs = yield from subprogress(read_photographs(self.sources, scratch), 0.0, READING_END)
            if self.unwrapping is not None:
                unwrapped = yield from subprogress(self.unwrapping.core_steps(), READING_END, UNWRAPPING_END)
                new_uvs = {instance.object_uid: result.corner_uvs for instance, result in zip(self.instances, unwrapped, strict=True)}
                end = UNWRAPPING_END
            surface = read_surface(self.instances, new_uvs)
            layout = lay_out_pages(surface.corner_uvs, None if self.groups is None else self.groups.triangles)
            steps = merge(surface.mesh, layout.corner_uvs, photographs, self.settings, scratch, pages=layout.pages)
            return unwrapped, layout, (yield from subprogress(steps, end, 1.0))

    def scene_steps(self, core_result: CoreResult) -> Steps[str]:
        """Write UV maps, images and materials.

        Raises:
            GeometryError: an object was removed or edited in the meantime; nothing was changed.
        """
        unwrapped, layout, texture = core_result
        coarseness = describe_coarseness(concatenate_in_world_space(self.instances).vertices)
        yield Progress(0.0, "Creating the texture")
        objects = [self._find_target(*target) for target in self.targets]
        if self.unwrapping is not None:
            yield from subprogress(self.unwrapping.scene_steps(unwrapped), 0.0, 0.1)
        name = self.targets[0][1]
        names = [name + SUFFIX] if self.groups is None else self.groups.name_textures(name)
        has_alpha = self.settings.fill == "none"
        images, notes = create_textures(layout, texture, names, has_alpha=has_alpha), ""
        if self.groups is None:
            assign_texture(objects, images[0], names[0], has_alpha=has_alpha)
        else:
            failed = assign_to_materials(objects, {self.groups.uids[group]: images[group] for group in images}, has_alpha=has_alpha)
            without_uvs = [name or "faces without a material" for group, name in enumerate(self.groups.names) if group not in images]
            notes = _explain_materials(failed, without_uvs)
        if self.has_maps:
            yield Progress(0.6, "Creating the maps")
            create_maps(layout, texture, names, len(self.sources))
        return join_sentences([self._summarize([image.name for image in images.values()], texture) + notes, coarseness])

    def _find_target(self, uid: int, name: str) -> bpy.types.Object:
        item = find_by_uid(bpy.data.objects, uid)
        if item is None or item.type != "MESH":
            raise GeometryError(f'"{name}" was removed while its texture was computed; nothing was changed.')
        return item

    def _summarize(self, images: list[str], texture: PhotoTexture) -> str:
        surface = np.count_nonzero(texture.holes | (texture.source >= 0))
        message = (
            f"Merged {format_count(len(self.sources), 'photograph')} into {quote_names(images)}; "
            f"{np.count_nonzero(texture.holes) / max(surface, 1):.1%} of the surface is in none."
        )
        if texture.hole_counts is not None:
            message += f" Restored {texture.hole_counts.restored:,} of {format_count(texture.hole_counts.found, 'hole')}."
        names = [source.camera.name for index, source in enumerate(self.sources) if not (texture.source == index).any()]
        if names:
            message += f" Not used: {', '.join(names)}."
        return message + (f" Skipped: {'; '.join(self.skipped)}." if self.skipped else "")


def prepare(context: bpy.types.Context, settings: PhotosSettings, *, has_maps: bool) -> MergeJob:
    """Return the job that merges the photographs of the cameras into a texture for the selected meshes.

    Raises:
        GeometryError: no mesh can be textured, only some have a UV map, or UV maps overlap.
        SettingsError: there are no cameras, or one cannot be used.
        FileError, ImageError: a photograph cannot be used.
    """
    objects, instances, skipped = read_targets(context)
    sources = open_photographs(context)
    missing = [instance for instance in instances if not instance.mesh.uv_map]
    groups = read_material_groups(objects, instances) if settings.materials == "keep" else None
    unwrapping = None
    if missing:
        if len(missing) < len(instances):
            other = next(instance for instance in instances if instance.mesh.uv_map)
            raise GeometryError(
                f'"{missing[0].name}" has no UV map, but "{other.name}" has one, and they get one texture; unwrap "{missing[0].name}" '
                "into a free part of it, or select one object at a time."
            )
        unwrapping = _prepare_unwrapping(context, objects, instances, sources)
    else:
        layout = lay_out_pages(read_surface(instances).corner_uvs, None if groups is None else groups.triangles)
        check_separate_uvs(instances, layout)
        _check_overlaps(objects, instances, layout)
    targets = [(item.session_uid, item.name) for item in objects]
    return MergeJob(targets, instances, sources, settings, unwrapping, groups, has_maps, skipped)


def _explain_materials(replaced: list[str], unchanged: list[str]) -> str:
    """Return sentences that name the materials which could not be copied, and those whose faces cover no texel."""
    message = f" Replaced, because they have no Principled BSDF: {', '.join(replaced)}." if replaced else ""
    return message + (f" Unchanged, because their UV map covers no pixel: {', '.join(unchanged)}." if unchanged else "")


def _check_overlaps(objects: list[bpy.types.Object], instances: list[SourceInstance], layout: PageLayout) -> None:
    """Check that each UV map has texels of its own for all faces. Raises GeometryError; the overlapping faces are selected then."""
    for instance, corner_uvs, pages in split_layout(instances, layout):
        is_overlapping = find_overlapping(corner_uvs, pages)
        if not is_overlapping.any():
            continue
        data = next(item.data for item in objects if item.session_uid == instance.object_uid)
        polygons = instance.mesh.polygons[is_overlapping]
        has_same_faces = len(data.polygons) > int(instance.mesh.polygons.max())
        if has_same_faces:
            select_faces(data, np.unique(polygons))
        advice = " They are selected in Edit Mode." if has_same_faces else ""
        count = int(np.count_nonzero(is_overlapping))
        raise GeometryError(f'The UV map of "{instance.name}" overlaps itself: {describe_overlaps(count)}{advice}')


def _prepare_unwrapping(
    context: bpy.types.Context, objects: list[bpy.types.Object], instances: list[SourceInstance], sources: list[PhotoSource]
) -> unwrap_job.UnwrapJob:
    """Return the job that unwraps `objects` with more texels where the photographs show more. Raises GeometryError."""
    job = unwrap_job.prepare(context, objects, UnwrapSettings(min_quality=MIN_QUALITY, combine_selected=True))
    faces = [target.loops for target in job.targets]
    same = len(faces) == len(instances) and all(
        np.array_equal(loops, instance.mesh.loops) for loops, instance in zip(faces, instances, strict=True)
    )
    if not same:
        reason = f" {job.skipped[0]}." if job.skipped else ""
        raise GeometryError(
            f'"{instances[0].name}" cannot be unwrapped together with its modifiers, instances or linked duplicates;{reason} '
            "apply them, or unwrap it first."
        )
    cameras = _project(instances, sources)
    settings = replace(job.settings, importance="cameras", density_ratio=DENSITY_RATIO) if cameras else job.settings
    return replace(job, cameras=cameras, occluders=instances, settings=settings)


def _project(instances: list[SourceInstance], sources: list[PhotoSource]) -> list[CameraProjection]:
    vertices = concatenate_in_world_space(instances).vertices
    projections = (to_projection(source.camera, vertices) for source in sources)
    return [projection for projection in projections if projection is not None]
