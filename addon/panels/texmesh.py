"""Panel *Perceptual Levels* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import bpy

from ..bridge import cameras
from ..bridge.texmesh.level_sets import ERROR, SWITCH_DISTANCE, TRIANGLES, LevelSet, find_level_set, level_sets_in
from ..bridge.units import format_length
from ..core.errors import SettingsError
from ..core.settings import describe
from ..core.texmesh.perception.recorded_answers import estimate_recorded
from ..core.texmesh.settings import InspectionSettings, LevelSettings, ResearchSettings, SceneSettings, TexmeshSettings
from ..operators import job_run, properties
from ..operators.texmesh import estimates, preview
from ..operators.texmesh.answer_files import FARFIELD_OT_texmesh_add_answers, FARFIELD_OT_texmesh_save_answers
from ..operators.texmesh.calibration import (
    FARFIELD_OT_texmesh_calibrate,
    FARFIELD_OT_texmesh_clear_answers,
    FARFIELD_OT_texmesh_use_threshold,
)
from ..operators.texmesh.calibration_run import ANSWERS, stored_answers
from ..operators.texmesh.exports import FARFIELD_OT_texmesh_export
from ..operators.texmesh.operators import (
    FARFIELD_OT_texmesh_analyze,
    FARFIELD_OT_texmesh_crossfade,
    FARFIELD_OT_texmesh_levels,
    FARFIELD_OT_texmesh_remove,
    FARFIELD_OT_texmesh_show,
    FARFIELD_OT_texmesh_show_for_camera,
    disabled_reason,
)
from ..operators.texmesh.overlays import FARFIELD_OT_texmesh_overlay, FARFIELD_OT_texmesh_plot, overlay
from ..operators.texmesh.sources import source_objects
from .sidebar import (
    BLUE,
    YELLOW,
    SettingsPanel,
    SidebarPanel,
    ToolPanel,
    draw_button,
    draw_legend,
    draw_message,
    draw_progress_bar,
    draw_table,
    sub_panels,
)

LEGEND = ((BLUE, "Details, gone at small scales"), (YELLOW, "Remains at the coarsest scale"))
LEVEL_TITLES = ("Level", "Triangles", "From", "Pixels")


class TexmeshSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of perceptual levels."""

    settings, property_name = describe(LevelSettings, SceneSettings, ResearchSettings), "farfield_texmesh"


class FARFIELD_PT_texmesh(TexmeshSettingsPanel, ToolPanel, bpy.types.Panel):
    """The main settings, and the buttons or the progress bar."""

    bl_idname = "FARFIELD_PT_texmesh"
    bl_label = "Perceptual Levels"
    bl_description = "Meshes with fewer triangles for near and middle distances. Farther away, a Billboard Cloud"
    bl_options = {"DEFAULT_CLOSED"}
    page = "texmesh"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings without a group. While a job runs, they are disabled and the progress bar replaces the buttons."""
        layout = self.layout
        self.draw_settings(context)
        if draw_progress_bar(layout):
            return
        reason = disabled_reason(context)
        if reason:
            draw_message(layout, reason, "INFO")
        draw_button(layout, FARFIELD_OT_texmesh_levels, "Make Levels", "MOD_DECIM")
        if not reason:
            draw_estimate(layout, context)


def draw_estimate(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw how long the levels of the selected objects take, if that is known."""
    group = context.scene.farfield_texmesh
    triangles = estimates.count_source_triangles(source_objects(context), context.evaluated_depsgraph_get())
    times = estimates.estimator.estimate(triangles, properties.read(TexmeshSettings, group))
    if times is not None:
        shortest, longest = (job_run.format_duration(float(f"{seconds:.1g}")) for seconds in times)
        duration = job_run.format_duration(times[0]) if times[0] == times[1] else f"{shortest} to {longest}"
        draw_message(layout, f"About {duration}{', without the cloud' if group.billboard_cloud else ''}", "TIME")


class FARFIELD_PT_texmesh_levels(SidebarPanel, bpy.types.Panel):
    """The levels of the active object, and buttons that change what is shown."""

    bl_idname = "FARFIELD_PT_texmesh_levels"
    bl_parent_id = "FARFIELD_PT_texmesh"
    bl_label = "Levels of Detail"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has levels."""
        return find_level_set(context.scene, context.active_object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row per level and the buttons."""
        levels = find_level_set(context.scene, context.active_object)
        self.layout.label(text=levels.collection.name, icon="OUTLINER_COLLECTION")
        draw_levels(self.layout, levels, context.scene)
        row = self.layout.row(align=True)
        for number in range(len(levels.levels)):
            row.operator(FARFIELD_OT_texmesh_show.bl_idname, text=f"L{number}").level = number
        buttons = self.layout.column(align=True)
        is_followed = preview.current.follows(levels)
        buttons.operator(preview.FARFIELD_OT_texmesh_preview.bl_idname, text="Preview", icon="VIEW_PERSPECTIVE", depress=is_followed)
        buttons.operator(FARFIELD_OT_texmesh_show.bl_idname, text="Show Original", icon="MESH_DATA").level = -1
        fades, identifier = levels.has_crossfade, FARFIELD_OT_texmesh_crossfade.bl_idname
        all_fade = all(each.has_crossfade for each in level_sets_in(context.scene))
        row = buttons.row(align=True)
        row.operator(identifier, text="Cross-Fade", icon="MOD_OPACITY", depress=fades).enable = not fades
        every = row.operator(identifier, text="All Objects", depress=all_fade)
        every.enable, every.all_objects = not all_fade, True
        for_camera = buttons.row(align=True)
        for_camera.enabled = cameras.read_scene_camera(context.scene) is not None
        for_camera.operator(FARFIELD_OT_texmesh_show_for_camera.bl_idname, text="Show for Camera", icon="CAMERA_DATA")
        buttons.operator(FARFIELD_OT_texmesh_export.bl_idname, text="Export", icon="EXPORT")
        buttons.operator(FARFIELD_OT_texmesh_remove.bl_idname, text="Remove Levels", icon="X")


def draw_levels(layout: bpy.types.UILayout, levels: LevelSet, scene: bpy.types.Scene) -> None:
    """Draw a table with the triangles, the distance and the size on screen from which each level shows."""
    side = max(levels.levels[0].dimensions) or 1.0
    rows = []
    for number, level in enumerate(levels.levels):
        error = float(level[ERROR])
        distance, pixels = float(level.get(SWITCH_DISTANCE, 0.0)) if error else 0.0, side / error if error else 0.0
        count = int(level.get(TRIANGLES, len(level.data.polygons)))
        rows.append((f"L{number}", f"{count:,}", format_length(scene, distance), f"{pixels:.0f}" if error else "all"))
    draw_table(layout, LEVEL_TITLES, rows)


class FARFIELD_PT_texmesh_inspect(SettingsPanel, bpy.types.Panel):
    """What helps to judge features and levels."""

    bl_idname = "FARFIELD_PT_texmesh_inspect"
    bl_parent_id = "FARFIELD_PT_texmesh"
    bl_label = "Inspect"
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name, group_name = describe(InspectionSettings), "farfield_texmesh_inspection", "Inspect"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings and the buttons."""
        self.draw_settings(context)
        buttons = self.layout.column(align=True)
        buttons.operator(FARFIELD_OT_texmesh_analyze.bl_idname, text="Analyze", icon="VIEWZOOM")
        buttons.operator(FARFIELD_OT_texmesh_overlay.bl_idname, text="Features by Scale", icon="OVERLAY", depress=overlay.is_shown)
        if overlay.is_shown:
            draw_legend(buttons, LEGEND)
        buttons.operator(FARFIELD_OT_texmesh_plot.bl_idname, text="Plot", icon="IMAGE_DATA")
        flickers = preview.current.flickers
        buttons.operator(preview.FARFIELD_OT_texmesh_flicker.bl_idname, text="Flicker", icon="UV_SYNC_SELECT", depress=flickers)
        number = preview.selected_number(context)
        if number is not None:
            self.layout.label(text=f"Level {number} is shown", icon="HIDE_OFF")


class FARFIELD_PT_texmesh_calibration(SidebarPanel, bpy.types.Panel):
    """The experiment that measures which differences a user notices."""

    bl_idname = "FARFIELD_PT_texmesh_calibration"
    bl_parent_id = "FARFIELD_PT_texmesh"
    bl_label = "Calibration"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the buttons, and the threshold that the answers give."""
        draw_button(self.layout, FARFIELD_OT_texmesh_calibrate, "Calibrate", "RESTRICT_VIEW_OFF")
        row = self.layout.row(align=True)
        row.operator(FARFIELD_OT_texmesh_add_answers.bl_idname, text="Add Answers", icon="IMPORT")
        row.operator(FARFIELD_OT_texmesh_save_answers.bl_idname, text="Save Answers", icon="EXPORT")
        if context.scene.get(ANSWERS) is None:
            return
        try:
            threshold = estimate_recorded(stored_answers(context.scene))
        except SettingsError as error:
            draw_message(self.layout, str(error), "INFO")
        else:
            interval = f"{threshold.low:.3g} to {threshold.high:.3g}"
            draw_message(self.layout, f"Threshold {threshold.value:.3g} ({interval}) from {threshold.answers} answers", "CHECKMARK")
            self.layout.operator(FARFIELD_OT_texmesh_use_threshold.bl_idname, text="Use Answers")
        self.layout.operator(FARFIELD_OT_texmesh_clear_answers.bl_idname, text="Clear Answers")


CLASSES = (
    FARFIELD_PT_texmesh,
    FARFIELD_PT_texmesh_levels,
    *sub_panels(TexmeshSettingsPanel, FARFIELD_PT_texmesh.bl_idname),
    FARFIELD_PT_texmesh_inspect,
    FARFIELD_PT_texmesh_calibration,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
