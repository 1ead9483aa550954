"""Panel *Clip-Box Terrain* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import bpy

from ..bridge.clipbox.objects import SceneTerrain
from ..core.clipbox.settings import EDITS, TERRAIN, ClipboxSettings, ConvertSettings, GroundSettings
from ..core.settings import describe
from ..operators import long_work
from ..operators.clipbox import live_update
from ..operators.clipbox.convert_to_mesh import FARFIELD_OT_clipbox_convert_to_mesh
from ..operators.clipbox.edits import MODES, FARFIELD_OT_clipbox_edit
from ..operators.clipbox.ground import FARFIELD_OT_clipbox_drop
from ..operators.clipbox.operators import FARFIELD_OT_clipbox_create
from .sidebar import SettingsPanel, TerrainPanel, draw_message, sub_panels

PANEL = "FARFIELD_PT_clipbox"


class FARFIELD_PT_clipbox(TerrainPanel, bpy.types.Panel):
    """The buttons or the progress bar."""

    bl_idname = PANEL
    bl_label = "Clip-Box Terrain"
    bl_description = "For landscapes without end, with caves and overhangs, from noise, formulas and files"
    page = "clipbox"
    bl_options = {"DEFAULT_CLOSED"}
    terrain_type, start_button = SceneTerrain, (FARFIELD_OT_clipbox_create, "Create", "WORLD_DATA")

    def draw_terrain(self, _terrain: SceneTerrain) -> None:
        """Draw the button that updates the terrain live, and why that failed."""
        is_live = live_update.current.terrain is not None
        self.layout.operator(
            live_update.FARFIELD_OT_clipbox_live_update.bl_idname, text="Live Update", icon="FILE_REFRESH", depress=is_live
        )
        if live_update.current.error:
            draw_message(self.layout, live_update.current.error, "ERROR")


class ClipboxSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of terrains."""

    settings, property_name = describe(ClipboxSettings), "farfield_clipbox"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, and the buttons that edit terrains."""
        if self.group_name == EDITS:
            self.layout.label(text="Selected objects:")
            row = self.layout.row(align=True)
            for mode, label, _ in MODES:
                row.operator(FARFIELD_OT_clipbox_edit.bl_idname, text=label).mode = mode
        super().draw(context)


class FARFIELD_PT_clipbox_ground(SettingsPanel, bpy.types.Panel):
    """Put objects on the ground."""

    bl_idname = "FARFIELD_PT_clipbox_ground"
    bl_label = "Drop to Ground"
    bl_parent_id = PANEL
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name = describe(GroundSettings), "farfield_clipbox_ground"
    buttons = ((FARFIELD_OT_clipbox_drop, "Drop", "TRIA_DOWN_BAR"),)


class FARFIELD_PT_clipbox_convert(SettingsPanel, bpy.types.Panel):
    """Conversion of the active terrain to meshes."""

    bl_idname = "FARFIELD_PT_clipbox_convert"
    bl_label = "Convert to Mesh"
    bl_parent_id = PANEL
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name = describe(ConvertSettings), "farfield_clipbox_convert"
    buttons = ((FARFIELD_OT_clipbox_convert_to_mesh, "Convert to Mesh", "MESH_DATA"),)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is active and no job runs."""
        return long_work.current_run() is None and SceneTerrain.of_object(context.active_object) is not None


CLASSES = (
    FARFIELD_PT_clipbox,
    *sub_panels(ClipboxSettingsPanel, PANEL, open_groups=(TERRAIN,)),
    FARFIELD_PT_clipbox_ground,
    FARFIELD_PT_clipbox_convert,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
