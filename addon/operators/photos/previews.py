"""Operators of the tool `photos` that show how cameras and mesh fit to each other before anything is merged: colors of the faces that
photographs show, and the mesh drawn into the photographs."""

from contextlib import ExitStack
from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space, read_instances
from ...bridge.photos.coverage_overlay import overlay
from ...bridge.photos.photo_images import PhotoSource
from ...bridge.photos.results import create_overlay_image, replace_overlay_image
from ...core.errors import GeometryError
from ...core.geometry.mesh import TriangleMesh
from ...core.jobs.progress import Progress, Steps
from ...core.messages import format_count
from ...core.photos.previews import INTERPOLATED, PHOTOGRAPHED, UNBOUND, classify_triangles, draw_overlay, measure_classes
from .. import long_work, start_job
from ..error_reports import reports_errors
from .sources import disabled_reason, find_cameras, open_photographs, read_targets

SUFFIX = " Overlay"


@dataclass
class CoverageJob:
    """Finds out which triangles of `mesh`, that of all `instances` in world space, the photographs `sources` show.

    cameras: session UIDs of the camera objects.
    """

    core_fraction = 0.98

    instances: list[SourceInstance]
    mesh: TriangleMesh
    sources: list[PhotoSource]
    cameras: list[int]

    def core_steps(self) -> Steps[np.ndarray]:
        """Look at the surface from each camera. Returns the classes (T,) of the triangles."""
        return classify_triangles(self.mesh, (source.read() for source in self.sources), len(self.sources))

    def scene_steps(self, core_result: np.ndarray) -> Steps[str]:
        """Show the overlay. Raises GeometryError if a mesh was changed or removed in the meantime."""
        yield Progress(0.0, "Drawing faces")
        objects = {item.session_uid: item for item in bpy.context.view_layer.objects}
        uids = dict.fromkeys(instance.object_uid for instance in self.instances)
        instances = read_instances([objects[uid] for uid in uids if uid in objects], bpy.context.evaluated_depsgraph_get())
        mesh = concatenate_in_world_space(instances) if instances else None
        is_same = mesh and np.array_equal(mesh.vertices, self.mesh.vertices) and np.array_equal(mesh.triangles, self.mesh.triangles)
        if not is_same:
            raise GeometryError("The mesh was changed while its coverage was computed; show the coverage again.")
        overlay.show_classes(self.instances, self.mesh, core_result, self.cameras)
        fractions = measure_classes(self.mesh, core_result)
        return (
            f"{fractions[PHOTOGRAPHED]:.0%} of the surface is shown, {fractions[INTERPOLATED]:.0%} lies between photographs, "
            f"{fractions[UNBOUND]:.0%} has corners that no photograph shows."
        )


class FARFIELD_OT_photos_show_coverage(start_job.StartJob, bpy.types.Operator):
    """Color the faces of the selected meshes in 3D Viewports: green where one photograph shows all corners of a triangle, blue where
    several photographs show them, red where a corner is in none. Press again to hide the colors"""

    bl_idname = "farfield.photos_show_coverage"
    bl_label = "Show Photo Coverage"
    bl_options = {"REGISTER"}
    settings_types, panel_property = (), "farfield_photos"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be shown or hidden now, or an empty string."""
        return "" if overlay.is_shown else long_work.running_job_message() or disabled_reason(context)

    def prepare(self, context: bpy.types.Context) -> CoverageJob:
        """Read meshes and cameras."""
        _, instances, _ = read_targets(context)
        cameras = [item.session_uid for item in find_cameras(context)]
        return CoverageJob(instances, concatenate_in_world_space(instances), open_photographs(context), cameras)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show the overlay when it has been computed, or hide it."""
        return _hide() if overlay.is_shown else super().execute(context)

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Compute the overlay in the background, or hide it."""
        return _hide() if overlay.is_shown else super().invoke(context, event)


def _hide() -> set[str]:
    overlay.hide()
    return {"FINISHED"}


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
        """Create an image for each photograph, all of them or none, in place of earlier ones."""
        names, images = [f"{source.camera.name}{SUFFIX}" for source in self.sources], []
        with ExitStack() as undo:
            for index, (name, picture) in enumerate(zip(names, core_result, strict=True)):
                yield Progress(index / len(names), "Creating images")
                images.append(create_overlay_image(name, picture))
                undo.callback(bpy.data.images.remove, images[-1])
            undo.pop_all()
        for name, image in zip(names, images, strict=True):
            replace_overlay_image(name, image)
        return f'Drew {format_count(len(images), "overlay")}; open them in the Image Editor, for example "{images[0].name}".'


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
        _, instances, _ = read_targets(context)
        return OverlayJob(instances, open_photographs(context))


register, unregister_classes = bpy.utils.register_classes_factory((FARFIELD_OT_photos_show_coverage, FARFIELD_OT_photos_draw_overlays))


def unregister() -> None:
    """Hide the overlay and unregister the operators."""
    overlay.hide()
    unregister_classes()
