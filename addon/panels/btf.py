"""Panel *Relightable Textures* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.btf_materials import SUNS
from ..core.btf.settings import BtfSettings
from ..core.settings import describe
from ..operators import btf, btf_estimates, btf_exports, long_work, properties
from ..operators.billboards_clouds import StandingCloud
from .sidebar import SidebarPanel, draw_bar, draw_button, megabytes, settings_rows

ROWS = [item.name for item in describe(BtfSettings) if item.name != "seed"]
OF_CODEC = {"components": "pca", "clusters": "lpca", "cluster_components": "lpca", "blend_texels": "lpca"}  # rows of one codec alone


class FARFIELD_PT_btf(SidebarPanel, bpy.types.Panel):
    """Settings, number of renders, button, bar; then the lamps."""

    bl_idname = "FARFIELD_PT_btf"
    bl_label = "Relightable Textures"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw all rows; while a job runs they are grey and the bar takes the button's place."""
        layout, group = self.layout, context.scene.farfield_btf
        rows = settings_rows(layout)
        for name in ROWS:
            if OF_CODEC.get(name, group.codec) == group.codec:
                rows.prop(group, name)
        if draw_bar(layout):
            return
        cloud, reason, done = btf.chosen(context), btf.refusal(context), 0
        settings = properties.read(BtfSettings, group)
        reason = reason or btf_estimates.check(settings)
        if reason:
            layout.label(text=reason, icon="INFO")
        else:
            done = btf_estimates.views_done(cloud, settings)
            draw_estimate(layout, cloud, settings, done)
        draw_button(layout, btf.FARFIELD_OT_btf_bake, "Resume" if done else "Bake", "LIGHT_SUN")
        if btf.is_baked(cloud):
            lamps = layout.column()
            for number in range(SUNS):
                lamps.prop(group, btf.sun_pointer(number))
            lamps.prop(group, "ambient")
            lamps.operator(btf.FARFIELD_OT_btf_light.bl_idname)
            lamps.operator(btf.FARFIELD_OT_btf_plain.bl_idname)
            lamps.operator(btf_exports.FARFIELD_OT_btf_export.bl_idname, icon="EXPORT")


def draw_estimate(layout: bpy.types.UILayout, cloud: StandingCloud, settings: BtfSettings, done: int) -> None:
    """What a bake will take, and how many of its views stand already."""
    figures = btf_estimates.estimated(cloud, settings)
    every = settings.views * len(cloud.levels)
    column = layout.box().column(align=True)
    column.label(text=f"{figures.renders:,} renders, about {long_work.duration(figures.seconds)}", icon="RENDER_STILL")
    column.label(text=f"{megabytes(figures.raw_bytes)} MB raw, {megabytes(figures.final_bytes)} MB in the end", icon="FILE_IMAGE")
    if done:
        column.label(text=f"{done} of {every} views stand", icon="CHECKMARK")


CLASSES = (FARFIELD_PT_btf,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
