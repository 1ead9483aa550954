"""Panel *Clip-Box Terrain* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.terrain_objects import terrain_at
from ..core.clipbox.settings import ClipboxSettings, FreezeSettings
from ..core.settings import describe
from ..operators import clipbox, clipbox_freeze
from .sidebar import SidebarPanel, draw_bar, draw_button, settings_rows

SPHERES = [item.name for item in describe(ClipboxSettings) if item.name.startswith("sphere_")]
ROWS = [item.name for item in describe(ClipboxSettings)]
OF_TERRAIN = dict.fromkeys(SPHERES, ("spheres",)) | {
    "formula": ("formula",),
    "source": ("heights", "volume", "forest"),
    "source_size": ("heights", "volume", "forest"),
    "source_height": ("heights",),
    "source_color": ("heights",),
    "forest_spacing": ("forest",),
    "forest_hills": ("forest",),
}


class FARFIELD_PT_clipbox(SidebarPanel, bpy.types.Panel):
    """Settings, buttons, bar."""

    bl_idname = "FARFIELD_PT_clipbox"
    bl_label = "Clip-Box Terrain"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the rows that count; while a job runs they are grey and the bar takes the buttons' place."""
        layout, group = self.layout, context.scene.farfield_clipbox
        rows = settings_rows(layout)
        for name in ROWS:
            if group.terrain in OF_TERRAIN.get(name, (group.terrain,)) and (name != "roughness" or group.subdivided):
                rows.prop(group, name)
        if draw_bar(layout):
            return
        reason = clipbox.refusal(context)
        if reason:
            layout.label(text=reason, icon="INFO")
        draw_button(layout, clipbox.FARFIELD_OT_clipbox_create, "Create", "WORLD_DATA")
        standing = terrain_at(context.active_object)
        if standing is not None:
            tools = layout.column(align=True)
            tools.operator(clipbox.FARFIELD_OT_clipbox_update.bl_idname, text="Update", icon="FILE_REFRESH")
            tools.operator(clipbox.FARFIELD_OT_clipbox_follow.bl_idname, icon="VIEW_PERSPECTIVE")
            tools.prop(standing.root, "farfield_clipbox_follow")
            draw_freeze(layout, context.scene.farfield_clipbox_freeze)


def draw_freeze(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup) -> None:
    """How to freeze, and the button that does."""
    column = layout.box().column()
    for item in describe(FreezeSettings):
        if item.name != "collider_share" or group.collider:
            column.prop(group, item.name)
    column.operator(clipbox_freeze.FARFIELD_OT_clipbox_freeze.bl_idname, icon="FREEZE")


CLASSES = (FARFIELD_PT_clipbox,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
