"""Operator of the tool `photos` that refines cameras against the other photographs."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space, read_instances
from ...bridge.objects import find_by_uid
from ...bridge.photos.camera_objects import check_movable, has_own_lens, move_camera
from ...bridge.photos.photo_images import PhotoSource
from ...bridge.photos.scene_cameras import find_background, has_photograph
from ...core.errors import GeometryError, SettingsError
from ...core.files.scratch import Scratch
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count
from ...core.photos.registration.refinement import Refinement, refine
from .. import long_work, start_job
from .registration import IMAGE_PROPERTY
from .sources import NO_CAMERAS, find_cameras, open_photographs, read_photographs, selected_meshes

READING_END = 0.1  # fraction of the progress bar


@dataclass
class RefineJob:
    """Refines cameras.

    Attributes:
        instances: the surfaces.
        sources: all photographs.
        chosen: the indices of those whose cameras are refined.
        has_free_lens: for each of these, whether its lens changes, too.
        targets: session UIDs and names of their camera objects.
        scene: the name of the scene.
    """

    core_fraction = 0.98

    instances: list[SourceInstance]
    sources: list[PhotoSource]
    chosen: list[int]
    has_free_lens: list[bool]
    targets: list[tuple[int, str]]
    scene: str

    def core_steps(self) -> Steps[list[Refinement]]:
        """Read the photographs and refine. Raises GeometryError if no camera could be refined."""
        with Scratch() as scratch:
            photographs = yield from subprogress(read_photographs(self.sources, scratch), 0.0, READING_END)
            mesh = concatenate_in_world_space(self.instances)
            steps = refine(mesh, photographs, self.chosen, scratch, has_free_lens=self.has_free_lens)
            found = yield from subprogress(steps, READING_END, 1.0)
        if all(each.problem for each in found):
            others = f" The {len(found) - 1} others could not be refined either." if len(found) > 1 else ""
            raise GeometryError(found[0].problem + others)
        return found

    def scene_steps(self, core_result: list[Refinement]) -> Steps[str]:
        """Move the camera objects.

        Raises:
            GeometryError: one was removed in the meantime; nothing was changed.
        """
        yield Progress(0.0, "Moving cameras")
        items = [find_by_uid(bpy.data.objects, uid) for uid, _ in self.targets]
        for item, (_, name) in zip(items, self.targets, strict=True):
            if item is None or item.type != "CAMERA":
                raise GeometryError(f'"{name}" was removed while its camera was refined; nothing was changed.')
        for item, index, found in zip(items, self.chosen, core_result, strict=True):
            if not found.problem:
                move_camera(item, self.sources[index].camera, found.camera, bpy.data.scenes[self.scene])
        refined = [each for each in core_result if not each.problem]
        before, after = (float(np.mean([getattr(each, name) for each in refined])) for name in ("before", "after"))
        message = f"Refined {format_count(len(refined), 'camera')}: {before:.2f} pixels off the other photographs before, {after:.2f} now."
        return " ".join([message, *(each.problem for each in core_result if each.problem)])


class FARFIELD_OT_photos_refine(start_job.StartJob, bpy.types.Operator):
    """Move the cameras of photographs so that these show the same on the mesh as the other photographs. Refines the selected cameras, those
    below selected Empties, or otherwise all visible cameras, with the selected or otherwise all visible meshes"""

    bl_idname = "farfield.photos_refine"
    bl_label = "Refine Cameras of Photographs"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (), "farfield_photos"
    __annotations__ = {
        "image": IMAGE_PROPERTY,
        "lens": bpy.props.BoolProperty(
            name="Lens", description="Refine focal length and distortion, too", default=False, options={"SKIP_SAVE"}
        ),
    }

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be refined now, or an empty string."""
        if context.mode != "OBJECT":
            return "Switch to Object Mode"
        return long_work.running_job_message() or ("" if find_cameras(context) else NO_CAMERAS)

    def prepare(self, context: bpy.types.Context) -> RefineJob:
        """Read meshes and cameras."""
        chosen = self._find_chosen(context)
        for item in chosen:
            check_movable(item)
        cameras = [item for item in context.view_layer.objects if has_photograph(item) and (item.visible_get() or item in chosen)]
        meshes = selected_meshes(context) or [item for item in context.visible_objects if item.type == "MESH"]
        instances = read_instances(meshes, context.evaluated_depsgraph_get()) if meshes else []
        if not instances:
            raise GeometryError("There is no visible mesh with faces that the photographs show; select one.")
        return RefineJob(
            instances,
            open_photographs(context, cameras),
            [cameras.index(item) for item in chosen],
            [self.lens and has_own_lens(item) for item in chosen],
            [(item.session_uid, item.name) for item in chosen],
            context.scene.name,
        )

    def _find_chosen(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        """Return the camera objects to refine. Raises SettingsError."""
        if not self.image:
            return find_cameras(context)
        found = [
            item for item in context.view_layer.objects if has_photograph(item) and find_background(item.data).image.name == self.image
        ]
        if not found:
            raise SettingsError(f'No camera has "{self.image}" as background image; press Register first.')
        return found


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_photos_refine,))
