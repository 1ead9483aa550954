"""Panel *Large Terrain* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.bdam.objects import SceneTerrain
from ..core.bdam.settings import BdamSettings, FreezePathSettings, FreezeSettings, GroundSettings, ViewSettings
from ..core.settings import describe
from ..operators.bdam.build import KINDS, FARFIELD_OT_bdam_add_files, FARFIELD_OT_bdam_build, FARFIELD_OT_bdam_remove_file
from ..operators.bdam.freeze import FARFIELD_OT_bdam_freeze, FARFIELD_OT_bdam_freeze_path
from ..operators.bdam.ground import FARFIELD_OT_bdam_drop
from ..operators.bdam.operators import FARFIELD_OT_bdam_load, FARFIELD_OT_bdam_remove
from .sidebar import SettingsPanel, SidebarPanel, TerrainPanel, draw_message, draw_table, format_megabytes, sub_panels

PANEL = "FARFIELD_PT_bdam"
MAX_LISTED = 8  # files of a build
MAX_WARNINGS = 5  # that are drawn


class FARFIELD_PT_bdam(TerrainPanel, bpy.types.Panel):
    """The buttons or the progress bar."""

    bl_idname = PANEL
    bl_label = "Large Terrain"
    bl_description = "For elevation models of any size, as detailed as the view needs them"
    page = "bdam"
    bl_options = {"DEFAULT_CLOSED"}
    terrain_type, start_button = SceneTerrain, (FARFIELD_OT_bdam_load, "Load", "FILE_FOLDER")

    def draw_terrain(self, terrain: SceneTerrain) -> None:
        """Draw the path of the store, the button that removes the terrain, and the tolerance if the triangle budget raised it."""
        self.layout.prop(terrain.root, "farfield_bdam_store_path")
        self.layout.operator(FARFIELD_OT_bdam_remove.bl_idname, text="Remove", icon="TRASH")
        figures = terrain.figures
        if figures is not None and figures.raising_budget:
            draw_message(self.layout, figures.describe_budget(), "INFO")


class BuildSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of builds."""

    settings, property_name = describe(BdamSettings), "farfield_bdam_build"


class FARFIELD_PT_bdam_build(BuildSettingsPanel, bpy.types.Panel):
    """Files and settings of the next build."""

    bl_idname = "FARFIELD_PT_bdam_build"
    bl_label = "Build"
    bl_parent_id = PANEL
    buttons = ((FARFIELD_OT_bdam_build, "Build", "RNDCURVE"),)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the files, the settings and the button."""
        group, layout = context.scene.farfield_bdam_build, self.layout
        for kind, label, _ in KINDS:
            column = layout.column(align=True)
            column.label(text=label)
            for index, file in enumerate(list(group.files(kind))[:MAX_LISTED]):
                row = column.row(align=True)
                row.label(text=bpy.path.basename(file.name), icon="FILE")
                button = row.operator(FARFIELD_OT_bdam_remove_file.bl_idname, text="", icon="X", emboss=False)
                button.kind, button.index = kind, index
            row = column.row(align=True)
            row.operator(FARFIELD_OT_bdam_add_files.bl_idname, text="Add", icon="ADD").kind = kind
            if len(group.files(kind)) > MAX_LISTED:
                column.label(text=f"and {len(group.files(kind)) - MAX_LISTED:,} more files")
                row.operator(FARFIELD_OT_bdam_remove_file.bl_idname, text="", icon="TRASH").kind = kind
        layout.prop(group, "store")
        super().draw(context)


class FARFIELD_PT_bdam_display(SettingsPanel, bpy.types.Panel):
    """How terrains are shown."""

    bl_idname = "FARFIELD_PT_bdam_display"
    bl_label = "Display"
    bl_parent_id = PANEL
    settings, property_name = describe(ViewSettings), "farfield_bdam_view"


class FARFIELD_PT_bdam_ground(SettingsPanel, bpy.types.Panel):
    """Put objects on the ground."""

    bl_idname = "FARFIELD_PT_bdam_ground"
    bl_label = "Drop to Ground"
    bl_parent_id = PANEL
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name = describe(GroundSettings), "farfield_bdam_ground"
    buttons = ((FARFIELD_OT_bdam_drop, "Drop", "TRIA_DOWN_BAR"),)


class FARFIELD_PT_bdam_freeze(SettingsPanel, bpy.types.Panel):
    """Make ordinary meshes."""

    bl_idname = "FARFIELD_PT_bdam_freeze"
    bl_label = "Freeze"
    bl_parent_id = PANEL
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name = describe(FreezeSettings, FreezePathSettings), "farfield_bdam_freeze"
    buttons = ((FARFIELD_OT_bdam_freeze, "Freeze", "FREEZE"), (FARFIELD_OT_bdam_freeze_path, "Freeze Camera Path", "CAMERA_DATA"))


class FARFIELD_PT_bdam_figures(SidebarPanel, bpy.types.Panel):
    """Figures of the active terrain."""

    bl_idname = "FARFIELD_PT_bdam_figures"
    bl_label = "Figures"
    bl_parent_id = PANEL
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a terrain is active that shows something."""
        terrain = SceneTerrain.of_object(context.active_object)
        return terrain is not None and terrain.figures is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what is shown, and what is damaged."""
        terrain = SceneTerrain.of_object(context.active_object)
        figures = terrain.figures
        warnings = terrain.warnings
        if len(warnings) > MAX_WARNINGS:
            warnings = (*warnings[:MAX_WARNINGS], f"{len(warnings) - MAX_WARNINGS:,} more parts are damaged.")
        for sentence in warnings:
            draw_message(self.layout, sentence, "ERROR")
        rows = [
            ("Triangles", f"{figures.triangles:,}"),
            ("Patches", f"{figures.patches:,}"),
            ("Tiles", str(figures.tiles)),
            ("Tolerance", f"{figures.tolerance:.2f} px"),
            ("Memory", f"{format_megabytes(figures.byte_count)} MB"),
        ]
        draw_table(self.layout, ("", "Shown"), rows)


CLASSES = (
    FARFIELD_PT_bdam,
    FARFIELD_PT_bdam_build,
    *sub_panels(BuildSettingsPanel, "FARFIELD_PT_bdam_build"),
    FARFIELD_PT_bdam_display,
    FARFIELD_PT_bdam_ground,
    FARFIELD_PT_bdam_freeze,
    FARFIELD_PT_bdam_figures,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
