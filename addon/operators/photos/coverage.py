"""Operator of the tool `photos` that colors the faces that photographs show."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space, read_instances
from ...bridge.photos.coverage_overlay import overlay
from ...bridge.photos.photo_images import PhotoSource
from ...core.errors import GeometryError
from ...core.geometry.mesh import TriangleMesh
from ...core.jobs.progress import Progress, Steps
from ...core.photos.coverage import classify_triangles, measure_classes
from ...core.photos.stages import INTERPOLATED, PHOTOGRAPHED, UNBOUND
from .. import long_work, start_job
from ..error_reports import reports_errors
from .sources import disabled_reason, divide_targets, find_cameras, open_photographs


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
        """Show the overlay.

        Raises:
            GeometryError: a mesh was changed or removed in the meantime.
        """
        yield Progress(0.0, "Drawing faces")
        uids = {instance.object_uid for instance in self.instances}
        objects = [item for item in bpy.context.view_layer.objects if item.session_uid in uids]
        instances = read_instances(objects, bpy.context.evaluated_depsgraph_get())
        if not instances or not _is_same(concatenate_in_world_space(instances), self.mesh):
            raise GeometryError("The mesh was changed while its coverage was computed; show the coverage again.")
        overlay.show_classes(self.instances, self.mesh, core_result, self.cameras)
        return describe_coverage(measure_classes(self.mesh, core_result))


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
        targets, _ = divide_targets(context)
        objects = [item for item in context.view_layer.objects if item in targets]  # in the order in which they are read again
        instances = read_instances(objects, context.evaluated_depsgraph_get())
        if not instances:
            raise GeometryError(f'"{objects[0].name}" has no faces after its modifiers; select another object.')
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


def describe_coverage(fractions: dict[int, float]) -> str:
    """Return a message about the fractions of the area by class."""
    return (
        f"{fractions[PHOTOGRAPHED]:.0%} of the surface is shown, {fractions[INTERPOLATED]:.0%} lies between photographs, "
        f"{fractions[UNBOUND]:.0%} has corners that no photograph shows."
    )


def _hide() -> set[str]:
    overlay.hide()
    return {"FINISHED"}


def _is_same(first: TriangleMesh, second: TriangleMesh) -> bool:
    return np.array_equal(first.vertices, second.vertices) and np.array_equal(first.triangles, second.triangles)


def unregister() -> None:
    """Hide the overlay and unregister the operator."""
    overlay.hide()
    unregister_class()


register, unregister_class = bpy.utils.register_classes_factory((FARFIELD_OT_photos_show_coverage,))
