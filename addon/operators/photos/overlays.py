"""Operator of the tool `photos` that draws the mesh into the photographs."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space, read_instances
from ...bridge.photos.photo_images import PhotoSource
from ...bridge.photos.results import create_overlay_image
from ...core.errors import GeometryError
from ...core.jobs.progress import Progress, Steps
from ...core.messages import format_count
from ...core.photos.overlays import draw_overlay
from .. import long_work, start_job
from .sources import disabled_reason, divide_targets, open_photographs

SUFFIX = " Overlay"


@dataclass
class OverlayJob:
    """Draws the `instances` into the photographs `sources`."""

    core_fraction = 0.95

    instances: list[SourceInstance]
    sources: list[PhotoSource]

    def core_steps(self) -> Steps[list[np.ndarray]]:
        """Draw the pictures."""
        mesh, pictures = concatenate_in_world_space(self.instances), []
        for index, source in enumerate(self.sources):
            yield Progress(index / len(self.sources), "Drawing overlays")
            pictures.append(draw_overlay(mesh, source.read()))
        return pictures

    def scene_steps(self, core_result: list[np.ndarray]) -> Steps[str]:
        """Create an image for each photograph, in place of an earlier one."""
        names = []
        for index, (source, picture) in enumerate(zip(self.sources, core_result, strict=True)):
            yield Progress(index / len(self.sources), "Creating images")
            names.append(create_overlay_image(f"{source.camera.name}{SUFFIX}", picture).name)
        return f'Drew {format_count(len(names), "overlay")}; open them in the Image Editor, for example "{names[0]}".'


def prepare(context: bpy.types.Context, sources: list[PhotoSource]) -> OverlayJob:
    """Return the job that draws the selected meshes into the photographs `sources`.

    Raises:
        GeometryError: there is no mesh with faces.
    """
    objects, _ = divide_targets(context)
    instances = read_instances(objects, context.evaluated_depsgraph_get())
    if not instances:
        raise GeometryError(f'"{objects[0].name}" has no faces after its modifiers; select another object.')
    return OverlayJob(instances, sources)


class FARFIELD_OT_photos_draw_overlays(start_job.StartJob, bpy.types.Operator):
    """Draw the selected meshes into a copy of each photograph, to see whether cameras and mesh fit to each other"""

    bl_idname = "farfield.photos_draw_overlays"
    bl_label = "Draw Overlays of Photographs"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (), "farfield_photos"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be drawn now, or an empty string."""
        return long_work.running_job_message() or disabled_reason(context)

    def prepare(self, context: bpy.types.Context) -> OverlayJob:
        """Read meshes and cameras."""
        return prepare(context, open_photographs(context))


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_photos_draw_overlays,))
