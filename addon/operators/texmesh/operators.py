"""Operators of the tool `texmesh`: analyze meshes, make levels, show one of them, cross-fade, and show the original again."""

from collections.abc import Callable
from functools import partial

import bpy

from ...bridge import cameras
from ...bridge.texmesh.level_sets import LevelSet, level_sets_in, remove_level_set, set_hidden
from ...core.messages import format_count
from ...core.texmesh.settings import AnalysisSettings, SceneSettings, TexmeshSettings
from .. import long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from ..results import show_result
from ..view_following import viewport_address
from . import preview
from .job import AnalysisJob, LevelsJob, prepare_analysis, prepare_levels
from .sources import refusal, source_objects

NO_LEVELS = "Select a level of detail, or the object that levels were made from"


class FARFIELD_PG_texmesh(bpy.types.PropertyGroup):
    """Settings of the panel *Perceptual Levels*, stored per scene."""

    settings_types = (TexmeshSettings, SceneSettings)
    __annotations__ = properties.build_annotations(TexmeshSettings, set()) | properties.build_annotations(SceneSettings, set())


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why the selected objects cannot be worked on now, or an empty string."""
    if long_work.running_job_message():
        return long_work.running_job_message()
    if not context.scene.is_editable:
        return "The scene is linked from a library"
    objects = source_objects(context)
    if not objects:
        return "Select a mesh with a texture"
    reasons = [refusal(item, context.view_layer) for item in objects]
    return reasons[0][:1].upper() + reasons[0][1:] if all(reasons) else ""


class FARFIELD_OT_texmesh_analyze(start_job.StartJob, bpy.types.Operator):
    """Find the features of the selected objects at 21 scales, and store the last scale of each vertex as an attribute"""

    bl_idname = "farfield.texmesh_analyze"
    bl_label = "Analyze Features in Scale Space"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (AnalysisSettings,), "farfield_texmesh"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> AnalysisJob:
        """Read the selected objects."""
        return prepare_analysis(context, source_objects(context), self.read_settings(context)[AnalysisSettings])


class FARFIELD_OT_texmesh_levels(start_job.StartJob, bpy.types.Operator):
    """Make levels of detail of the selected objects that look the same as the original from their distance"""

    bl_idname = "farfield.texmesh_levels"
    bl_label = "Make Perceptual Levels"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (TexmeshSettings, SceneSettings), "farfield_texmesh"
    disabled_reason = staticmethod(disabled_reason)
    __annotations__ = start_job.setting_properties(*settings_types)

    def prepare(self, context: bpy.types.Context) -> LevelsJob:
        """Read the selected objects."""
        settings = self.read_settings(context)
        return prepare_levels(context, source_objects(context), settings[TexmeshSettings], settings[SceneSettings])

    def prepare_follow_up(self, context: bpy.types.Context) -> Callable[[], None]:
        """Return what lets one level show in all views if they cross-fade."""
        if not self.read_settings(context)[SceneSettings].cross_fade:
            return super().prepare_follow_up(context)
        return partial(preview.start_for_crossfades, viewport_address(context))


class LevelsOperator:
    """Mixin of operators that change the visibility of the levels of selected objects."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether selected objects have levels that can be changed."""
        found = selected_level_sets(context)
        reason = "" if found else NO_LEVELS
        if found and not any(levels.is_editable for levels in found):
            reason = "The levels are linked from another file; make them local first"
        return long_work.poll_with_reason(cls, reason)


class FARFIELD_OT_texmesh_show(LevelsOperator, bpy.types.Operator):
    """Show one level of the selected objects at any distance"""

    bl_idname = "farfield.texmesh_show"
    bl_label = "Show Perceptual Level"

    level: bpy.props.IntProperty(
        name="Level",
        description="Level to show, 0 for the finest. -1 for the original object",
        default=0,
        min=-1,
        max=99,
        options={"SKIP_SAVE"},
    )

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show the level, or the coarsest one if there are fewer."""
        editable = editable_level_sets(context)
        preview.current.follows_all = False
        for levels in editable:
            is_original = self.level < 0
            if is_original:
                levels.remove_crossfade()
                for item in levels.levels:
                    set_hidden(item, True)
            else:
                levels.show(min(self.level, len(levels.levels) - 1))
            levels.hide_source(not is_original)
            activate_visible(context, levels)
        shown = "the original" if self.level < 0 else f"level {self.level}"
        report_message(self, f"Showing {shown} of {format_count(len(editable), 'object')}.")
        return {"FINISHED"}


class FARFIELD_OT_texmesh_crossfade(LevelsOperator, bpy.types.Operator):
    """Cross-fade the levels of the selected objects for the active camera, also in renders without Farfield, or end it"""

    bl_idname = "farfield.texmesh_crossfade"
    bl_label = "Cross-Fade Perceptual Levels"
    __annotations__ = {
        "enable": bpy.props.BoolProperty(
            name="Enable", description="Cross-fade. When off, show one level for the active camera", default=True, options={"SKIP_SAVE"}
        ),
        "all_objects": bpy.props.BoolProperty(
            name="All", description="The levels of all objects of the scene, instead of selected ones", options={"SKIP_SAVE"}
        ),
    }

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Add a cross-fade, and let one level show in all views."""
        result = self.execute(context)
        if context.window is not None and self.enable:
            preview.start_for_crossfades(viewport_address(context))
        return result

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add a cross-fade to all levels, or remove it."""
        settings = properties.read(SceneSettings, context.scene.farfield_texmesh)
        found = level_sets_in(context.scene) if self.all_objects else selected_level_sets(context)
        editable = [levels for levels in found if levels.is_editable and (self.enable or levels.has_crossfade)]
        camera = cameras.read_scene_camera(context.scene)
        for levels in editable:
            if self.enable:
                levels.add_crossfade(context.scene, settings.fade_range)
            else:
                levels.show(0 if camera is None else levels.choose_level(camera))
            levels.hide_source(True)
            activate_visible(context, levels)
        what = "Cross-fading the levels" if self.enable else "Showing one level"
        report_message(self, f"{what} of {format_count(len(editable), 'object')}.")
        return {"FINISHED"}


class FARFIELD_OT_texmesh_show_for_camera(LevelsOperator, bpy.types.Operator):
    """Show the level of the selected objects that the distance of the active camera calls for"""

    bl_idname = "farfield.texmesh_show_for_camera"
    bl_label = "Show Perceptual Level for Camera"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show the level."""
        camera = cameras.read_scene_camera(context.scene)
        if camera is None:
            report_message(self, "The scene has no active camera; add one.", "ERROR")
            return {"CANCELLED"}
        numbers = []
        preview.current.follows_all = False
        for levels in editable_level_sets(context):
            numbers.append(levels.choose_level(camera))
            levels.show(numbers[-1])
            activate_visible(context, levels)
        report_message(self, f"Showing level {', '.join(map(str, numbers))}.")
        return {"FINISHED"}


class FARFIELD_OT_texmesh_remove(LevelsOperator, bpy.types.Operator):
    """Remove the levels of the selected objects, and show the originals"""

    bl_idname = "farfield.texmesh_remove"
    bl_label = "Remove Perceptual Levels"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the levels."""
        editable = editable_level_sets(context)
        for levels in editable:
            source = levels.source
            remove_level_set(levels)
            if source is not None and source.is_editable:
                set_hidden(source, False)
                context.view_layer.update()
                if source.name in context.view_layer.objects and source.visible_get():
                    context.view_layer.objects.active = source
                    source.select_set(True)
        show_result(self, context.scene, f"Removed the levels of {format_count(len(editable), 'object')}.")
        return {"FINISHED"}


def selected_level_sets(context: bpy.types.Context) -> list[LevelSet]:
    """Return the level sets of the selected objects, or of the active one, each once, with all those of the same objects."""
    wanted = {*context.selected_objects, context.active_object} - {None}
    found = level_sets_in(context.scene)
    wanted |= {levels.source for levels in found if wanted & set(levels.levels)} - {None}
    return [levels for levels in found if wanted & {*levels.levels, levels.source}]


def editable_level_sets(context: bpy.types.Context) -> list[LevelSet]:
    """Return those of `selected_level_sets` that can be changed."""
    return [levels for levels in selected_level_sets(context) if levels.is_editable]


def activate_visible(context: bpy.types.Context, levels: LevelSet) -> None:
    """Keep `levels` selected, with a visible one of them if the others are hidden now, and active if it was: the panel depends on it."""
    context.view_layer.update()
    candidates = [item for item in (*levels.levels, levels.source) if item is not None and item.name in context.view_layer.objects]
    active = context.view_layer.objects.active
    visible = [item for item in candidates if item.visible_get()]
    if not visible:
        return
    if not any(item.select_get() for item in visible):
        visible[0].select_set(True)
    if active is None or (active in candidates and active not in visible):
        context.view_layer.objects.active = visible[0]
        visible[0].select_set(True)


register, unregister = properties.scene_settings_factory(
    "farfield_texmesh",
    FARFIELD_PG_texmesh,
    (
        FARFIELD_PG_texmesh,
        FARFIELD_OT_texmesh_analyze,
        FARFIELD_OT_texmesh_levels,
        FARFIELD_OT_texmesh_show,
        FARFIELD_OT_texmesh_crossfade,
        FARFIELD_OT_texmesh_show_for_camera,
        FARFIELD_OT_texmesh_remove,
    ),
)
