"""Panel *Clip-Box Terrain* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import bpy

from ..bridge.clipbox.objects import terrain_of_object
from ..core.clipbox.settings import BOXES, DETAIL, TERRAIN, ClipboxSettings, ConvertSettings
from ..core.settings import describe
from ..operators import long_work, view_following
from ..operators.clipbox.convert_to_mesh import FARFIELD_OT_clipbox_convert_to_mesh
from ..operators.clipbox.operators import (
    FARFIELD_OT_clipbox_create,
    FARFIELD_OT_clipbox_follow_view,
    FARFIELD_OT_clipbox_update,
)
from ..operators.following import disabled_reason
from .sidebar import SettingsSubPanel, SidebarPanel, ToolPanel, draw_button, draw_message, draw_progress_bar, draw_setting, settings_column

SETTINGS = describe(ClipboxSettings)
TERRAINS_OF_SETTING = {item.name: ("spheres",) for item in SETTINGS if item.name.startswith("sphere_")} | {
    "formula": ("formula",),
    "source": ("heights", "volume", "forest"),
    "source_size": ("heights", "volume", "forest"),
    "source_height": ("heights",),
    "source_color": ("heights",),
    "forest_spacing": ("forest",),
    "forest_hills": ("forest",),
}


class FARFIELD_PT_clipbox(ToolPanel, bpy.types.Panel):
    """The buttons or the progress bar."""

    bl_idname = "FARFIELD_PT_clipbox"
    bl_label = "Clip-Box Terrain"
    page = "clipbox"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the buttons. While a job runs, the progress bar replaces them."""
        layout = self.layout
        if draw_progress_bar(layout):
            return
        reason = disabled_reason(context)
        if reason:
            draw_message(layout, reason, "INFO")
        if view_following.current.error:
            draw_message(layout, view_following.current.error, "ERROR")
        draw_button(layout, FARFIELD_OT_clipbox_create, "Create", "WORLD_DATA")
        terrain, is_following = terrain_of_object(context.active_object), view_following.current.terrain is not None
        if terrain is None and not is_following:
            return
        if terrain is not None and terrain.read_only_reason:
            draw_message(layout, terrain.read_only_reason, "INFO")
        column = layout.column(align=True)
        column.operator(FARFIELD_OT_clipbox_update.bl_idname, text="Update", icon="FILE_REFRESH")
        text, icon = ("Stop Following", "CANCEL") if is_following else ("Follow View", "VIEW_PERSPECTIVE")
        column.operator(FARFIELD_OT_clipbox_follow_view.bl_idname, text=text, icon=icon, depress=is_following)
        if terrain is not None:
            column.prop(terrain.root, "farfield_clipbox_follow_camera")


class SubPanel(SettingsSubPanel):
    """A sub-panel of settings."""

    bl_parent_id = "FARFIELD_PT_clipbox"
    settings, property_name = SETTINGS, "farfield_clipbox"

    @staticmethod
    def is_used(name: str, group: bpy.types.PropertyGroup) -> bool:
        """Return whether the setting applies to the selected terrain and boxes."""
        if name == "roughness":
            return group.subdivided_boxes > 0
        return group.terrain in TERRAINS_OF_SETTING.get(name, (group.terrain,))


class FARFIELD_PT_clipbox_terrain(SubPanel, bpy.types.Panel):
    """Shape of the terrain."""

    bl_idname = "FARFIELD_PT_clipbox_terrain"
    bl_label = TERRAIN


class FARFIELD_PT_clipbox_boxes(SubPanel, bpy.types.Panel):
    """Number, size and resolution of the boxes."""

    bl_idname = "FARFIELD_PT_clipbox_boxes"
    bl_label = BOXES
    bl_options = {"DEFAULT_CLOSED"}


class FARFIELD_PT_clipbox_detail(SubPanel, bpy.types.Panel):
    """Subdivision, surface and smoothing."""

    bl_idname = "FARFIELD_PT_clipbox_detail"
    bl_label = DETAIL
    bl_options = {"DEFAULT_CLOSED"}


class FARFIELD_PT_clipbox_convert(SidebarPanel, bpy.types.Panel):
    """Conversion of the active terrain to meshes."""

    bl_idname = "FARFIELD_PT_clipbox_convert"
    bl_label = "Convert to Mesh"
    bl_parent_id = "FARFIELD_PT_clipbox"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is active and no job runs."""
        return long_work.current_run() is None and terrain_of_object(context.active_object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings and the button."""
        group = context.scene.farfield_clipbox_convert
        column = settings_column(self.layout)
        for item in describe(ConvertSettings):
            if item.name != "collider_fraction" or group.collider:
                draw_setting(column, group, item)
        self.layout.operator(FARFIELD_OT_clipbox_convert_to_mesh.bl_idname, text="Convert to Mesh", icon="MESH_DATA")


CLASSES = (
    FARFIELD_PT_clipbox,
    FARFIELD_PT_clipbox_terrain,
    FARFIELD_PT_clipbox_boxes,
    FARFIELD_PT_clipbox_detail,
    FARFIELD_PT_clipbox_convert,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
