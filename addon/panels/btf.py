"""Panel *Relightable Textures* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import bpy

from ..bridge.billboards.scene_clouds import SceneCloud
from ..bridge.btf.materials.emission_material import SUNS
from ..core.btf.settings import BtfSettings
from ..core.settings import describe
from ..operators import job_run, long_work, properties
from ..operators.btf import estimates
from ..operators.btf.exports import FARFIELD_OT_btf_export
from ..operators.btf.operators import (
    FARFIELD_OT_btf_bake,
    FARFIELD_OT_btf_link_suns,
    FARFIELD_OT_btf_restore_pbr,
    active_cloud,
    disabled_reason,
    is_baked,
    shows_linked_suns,
    sun_pointer_name,
)
from .sidebar import (
    SettingsPanel,
    SidebarPanel,
    ToolPanel,
    draw_button,
    draw_message,
    draw_progress_bar,
    format_megabytes,
    settings_column,
    sub_panels,
)

PANEL = "FARFIELD_PT_btf"


class BtfSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of a bake."""

    settings, property_name = describe(BtfSettings), "farfield_btf"


class FARFIELD_PT_btf(BtfSettingsPanel, ToolPanel, bpy.types.Panel):
    """The model, the estimate, and the bake button or the progress bar."""

    bl_idname = PANEL
    bl_label = "Relightable Textures"
    bl_description = "For billboard clouds: sharp silhouettes from all views, which all lights reach"
    page = "btf"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the model, the estimate and the button. While a job runs, the progress bar replaces them."""
        self.draw_settings(context)
        settings = properties.read(BtfSettings, context.scene.farfield_btf)
        reason = disabled_reason(context) or estimates.settings_error(settings)
        if draw_progress_bar(self.layout, reason):
            return
        finished_count = 0
        if not reason:
            cloud = active_cloud(context)
            finished_count = estimates.count_finished_views(cloud, settings)
            draw_estimate(self.layout, cloud, settings, finished_count)
        draw_button(self.layout, FARFIELD_OT_btf_bake, "Resume" if finished_count else "Bake", "LIGHT_SUN")


class FARFIELD_PT_btf_lighting(SidebarPanel, bpy.types.Panel):
    """Sun lights of a relightable cloud, and what else can be done with it."""

    bl_idname = "FARFIELD_PT_btf_lighting"
    bl_label = "Lighting"
    bl_parent_id = PANEL

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active cloud has relightable textures and no job runs."""
        return long_work.current_run() is None and is_baked(active_cloud(context))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the Sun lights, the ambient color, and the buttons."""
        group, column = context.scene.farfield_btf, settings_column(self.layout)
        if shows_linked_suns(active_cloud(context)):
            for index in range(SUNS):
                column.prop(group, sun_pointer_name(index))
            column.prop(group, "ambient")
            column.operator(FARFIELD_OT_btf_link_suns.bl_idname, text="Link Sun Lights")
        else:
            draw_message(column, "Lit by all lights of the scene", "LIGHT")
        column.operator(FARFIELD_OT_btf_restore_pbr.bl_idname)
        column.operator(FARFIELD_OT_btf_export.bl_idname, text="Export", icon="EXPORT")


def draw_estimate(layout: bpy.types.UILayout, cloud: SceneCloud, settings: BtfSettings, finished_count: int) -> None:
    """Draw the estimated cost of a bake, and how many of its views are finished."""
    estimate = estimates.cache.estimate(cloud, settings)
    view_count = settings.view_count * len(cloud.levels)
    raw, compressed = format_megabytes(estimate.raw_bytes), format_megabytes(estimate.final_bytes)
    column = layout.box().column(align=True)
    column.label(text=f"Silhouettes from {settings.view_count:,} views", icon="HIDE_OFF")
    column.label(text=f"{estimate.renders:,} renders, about {job_run.format_duration(estimate.seconds)}", icon="RENDER_STILL")
    column.label(text=f"{raw} MB uncompressed", icon="BLANK1")
    column.label(text=f"{compressed} MB compressed", icon="FILE_IMAGE")
    if finished_count:
        column.label(text=f"{finished_count} of {view_count} views finished", icon="CHECKMARK")


CLASSES = (FARFIELD_PT_btf, *sub_panels(BtfSettingsPanel, PANEL), FARFIELD_PT_btf_lighting)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
