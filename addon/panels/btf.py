"""Panel *Relightable Textures* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.btf_materials import SUNS
from ..core.btf.settings import BtfSettings
from ..core.settings import describe
from ..operators import btf, btf_exports, long_work
from .billboards import SidebarPanel
from .progress import draw_progress

ROWS = [item.name for item in describe(BtfSettings) if item.name != "seed"]
OF_CODEC = {"components": "pca", "clusters": "lpca", "cluster_components": "lpca", "blend_texels": "lpca"}  # rows of one codec alone


class FARFIELD_PT_btf(SidebarPanel, bpy.types.Panel):
    """Settings, number of renders, button, bar; then the lamps."""

    bl_idname = "FARFIELD_PT_btf"
    bl_label = "Relightable Textures"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw all rows; while a job runs they are grey and the bar takes the button's place."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        group = context.scene.farfield_btf
        run = long_work.current()
        rows = layout.column()
        rows.enabled = run is None
        for name in ROWS:
            if OF_CODEC.get(name, group.codec) == group.codec:
                rows.prop(group, name)
        if run is not None:
            draw_progress(layout, run)
            return
        cloud, reason = btf.chosen(context), btf.refusal(context)
        if reason:
            layout.label(text=reason, icon="INFO")
        else:
            renders = group.views * (group.lights + 1) * len(cloud.levels)
            layout.label(text=f"{renders:,} renders for {len(cloud.levels)} levels", icon="RENDER_STILL")
        row = layout.row()
        row.scale_y = 1.4
        row.operator(btf.FARFIELD_OT_btf_bake.bl_idname, text="Bake", icon="LIGHT_SUN")
        if btf.is_baked(cloud):
            lamps = layout.column()
            for number in range(SUNS):
                lamps.prop(group, btf.sun_pointer(number))
            lamps.prop(group, "ambient")
            lamps.operator(btf.FARFIELD_OT_btf_light.bl_idname)
            lamps.operator(btf.FARFIELD_OT_btf_plain.bl_idname)
            lamps.operator(btf_exports.FARFIELD_OT_btf_export.bl_idname, icon="EXPORT")


CLASSES = (FARFIELD_PT_btf,)


def register() -> None:
    """Register the panel."""
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    """The reverse."""
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
