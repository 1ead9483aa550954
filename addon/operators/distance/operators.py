"""Operators of the tool `distance`: analyze a scene, make it ready for any distance, show the originals, remove the levels."""

import bpy

from ...bridge.distance.assets import visible_objects
from ...bridge.distance.placing import clean_up, detach, find_hosts, has_levels, show_levels, shows_levels, with_placements
from ...core.distance.settings import DistanceSettings
from ...core.messages import format_count, join_sentences, list_first
from .. import long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from ..results import show_result
from .analysis import FARFIELD_PG_distance_plan, analyze, describe_weight, store_plans
from .job import DistanceJob, prepare
from .measuring import MeasureJob
from .measuring import prepare as prepare_measurement


class FARFIELD_PG_distance(bpy.types.PropertyGroup):
    """Settings of the panel *Distance-Ready*, stored per scene, and the list of the latest analysis."""

    settings_types = (DistanceSettings,)
    __annotations__ = {
        **properties.build_annotations(DistanceSettings, set()),
        "plans": bpy.props.CollectionProperty(type=FARFIELD_PG_distance_plan),
        "active_plan": bpy.props.IntProperty(),
        "figures": bpy.props.StringProperty(options={"HIDDEN"}),
    }


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why nothing can be made ready now, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    if not context.scene.is_editable:
        return "The scene is linked from a library"
    return long_work.running_job_message() or ("" if context.scene.objects else "The scene is empty")


def chosen_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects that may have a surface, or all visible ones of the scene."""
    return visible_objects(context.scene, context.view_layer, context.selected_objects)


class FARFIELD_OT_distance_build(start_job.StartJob, bpy.types.Operator):
    """Make levels of detail of the selected objects, or of all visible ones, and show at each place the one that its distance to the active
    camera requires. The objects stay as they are; Remove takes the levels away again"""

    bl_idname = "farfield.distance_build"
    bl_label = "Make Distance-Ready"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (DistanceSettings,), "farfield_distance"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> DistanceJob:
        """Choose the objects."""
        return prepare(context.scene, chosen_objects(context), self.read_settings(context)[DistanceSettings])


class FARFIELD_OT_distance_analyze(bpy.types.Operator):
    """List the selected objects, or all visible ones, by their triangles at all places, with their distances to the active camera"""

    bl_idname = "farfield.distance_analyze"
    bl_label = "Analyze What Is Heavy"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene can be analyzed."""
        return long_work.poll_with_reason(cls, disabled_reason(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Analyze the scene and store the table for the panel."""
        group = context.scene.farfield_distance
        settings = properties.read(DistanceSettings, group)
        plans, skipped = analyze(context.scene, context.view_layer, chosen_objects(context), settings)
        store_plans(group.plans, plans)
        group.active_plan = 0
        triangles, places = sum(plan.total for plan in plans), sum(plan.places for plan in plans)
        left_out = f"Skipped: {list_first(skipped)}." if skipped else ""
        counts = f"{format_count(len(plans), 'object')} at {format_count(places, 'place')}"
        unique = f"{sum(plan.triangles for plan in plans):,} without repetitions"
        figures = f"{format_count(triangles, 'triangle')} in {counts}, {unique}."
        report_message(self, join_sentences([figures, describe_weight(plans), left_out]))
        return {"FINISHED"}


def levels_reason(context: bpy.types.Context) -> str:
    """Return that the scene has no levels, or an empty string."""
    return "" if has_levels(context.scene) else "No object shows levels by distance"


class LevelsOperator:
    """Mixin of operators that need levels in the scene."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene has levels that can be changed."""
        return long_work.poll_with_reason(cls, disabled_reason(context) or levels_reason(context))


class FARFIELD_OT_distance_measure(long_work.LongWork, bpy.types.Operator):
    """Render up to three frames with the originals and with levels by distance, with at most 32 samples, and compare time, memory and the
    images. A copy of the scene is rendered in the background; Esc cancels"""

    bl_idname = "farfield.distance_measure"
    bl_label = "Measure Levels by Distance"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the scene can be rendered with levels."""
        camera = "" if context.scene.camera is not None else "Add a camera"
        return long_work.poll_with_reason(cls, disabled_reason(context) or levels_reason(context) or camera)

    def prepare(self, context: bpy.types.Context) -> MeasureJob:
        """Copy the scene."""
        return prepare_measurement(context.scene)


class FARFIELD_OT_distance_show_original(LevelsOperator, bpy.types.Operator):
    """Show the originals of all objects of the scene in viewports and renders, or their levels by distance again"""

    bl_idname = "farfield.distance_show_original"
    bl_label = "Show Originals or Levels by Distance"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show the others."""
        show_levels(context.scene, not shows_levels(context.scene.objects))
        return {"FINISHED"}


class FARFIELD_OT_distance_remove(LevelsOperator, bpy.types.Operator):
    """Remove the levels of the selected objects, or of all objects of the scene if none of the selected ones has any"""

    bl_idname = "farfield.distance_remove"
    bl_label = "Remove Levels by Distance"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the levels."""
        scene = context.scene
        selected = with_placements(scene, context.selected_objects)
        hosts = find_hosts(selected) or find_hosts(scene.objects)
        show_levels(scene, True)
        count = len(hosts)
        detach(hosts)
        clean_up(scene)
        scene.farfield_distance.figures = ""
        show_result(self, scene, f"Objects that no longer show levels by distance: {count:,}.")
        return {"FINISHED"}


register, unregister = properties.scene_settings_factory(
    "farfield_distance",
    FARFIELD_PG_distance,
    (
        FARFIELD_PG_distance_plan,
        FARFIELD_PG_distance,
        FARFIELD_OT_distance_build,
        FARFIELD_OT_distance_analyze,
        FARFIELD_OT_distance_measure,
        FARFIELD_OT_distance_show_original,
        FARFIELD_OT_distance_remove,
    ),
)
