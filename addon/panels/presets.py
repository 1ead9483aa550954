"""Menus of presets, one per tool, which the headers of panels open, with the pictures of those presets that have one."""

from pathlib import Path

import bpy
import bpy.utils.previews

from ..operators import documentation, presets

COLUMNS = 3  # pictures side by side
PICTURE_SIZE = 4.0  # widths of a button
WIDTHS = {True: 19, False: 12}  # for menus with pictures, and without
pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def picture_of(path: Path) -> Path:
    """Return the path of the picture of a preset, which may not exist."""
    return path.with_suffix(".webp")


class PresetsPanel:
    """Mixin of the menus. tool: whose presets they show."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "HEADER"  # It is shown as a popover only.
    bl_label = "Presets"
    tool = ""

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the presets of Farfield, those of the user, and a field that saves a new one."""
        layout = self.layout
        layout.operator_context = "EXEC_DEFAULT"
        found = presets.find_presets(self.tool)
        with_pictures = {name: path for name, path in found.items() if str(path) in pictures}
        grid = layout.grid_flow(row_major=True, columns=COLUMNS, even_columns=True)
        for name, path in with_pictures.items():
            cell = grid.column(align=True)
            cell.template_icon(icon_value=pictures[str(path)].icon_id, scale=PICTURE_SIZE)
            draw_preset(cell, self.tool, name)
        column = layout.column(align=True)
        draw_preset(column, self.tool, "", "Defaults")
        for name, path in found.items():
            if name not in with_pictures:
                row = column.row(align=True)
                draw_preset(row, self.tool, name)
                if path.parent != presets.BUILT_IN / self.tool:
                    row.operator_context = "INVOKE_DEFAULT"
                    remove = row.operator(presets.FARFIELD_OT_preset_remove.bl_idname, text="", icon="REMOVE")
                    remove.tool, remove.name = self.tool, name
        row = layout.row(align=True)
        row.prop(context.window_manager, "preset_name", text="")
        save = row.operator(presets.FARFIELD_OT_preset_save.bl_idname, text="", icon="ADD")
        save.tool, save.name = self.tool, context.window_manager.preset_name


def draw_preset(layout: bpy.types.UILayout, tool: str, name: str, label: str = "") -> None:
    """Draw the button of a preset."""
    button = layout.operator(presets.FARFIELD_OT_preset_apply.bl_idname, text=label or name, translate=False)
    button.tool, button.name = tool, name


def menu_name(tool: str) -> str:
    """Return the identifier of the menu of a tool."""
    return f"FARFIELD_PT_{tool}_presets"


def create_menu(tool: str) -> type[bpy.types.Panel]:
    """Return the class of the menu of a tool."""
    has_pictures = any(picture_of(path).exists() for path in presets.list_presets(presets.BUILT_IN / tool))
    members = {"__doc__": "Presets of the settings of this tool.", "__module__": __name__, "tool": tool}
    members |= {"bl_idname": menu_name(tool), "bl_ui_units_x": WIDTHS[has_pictures]}
    return type(menu_name(tool), (PresetsPanel, bpy.types.Panel), members)


MENUS = tuple(create_menu(tool) for tool in documentation.TOOLS)
register_classes, unregister_classes = bpy.utils.register_classes_factory(MENUS)


def register() -> None:
    """Register the menus, and read the pictures."""
    global pictures
    pictures = bpy.utils.previews.new()
    for tool in documentation.TOOLS:
        for path in presets.list_presets(presets.BUILT_IN / tool):
            if picture_of(path).exists():
                pictures.load(str(path), str(picture_of(path)), "IMAGE")
    register_classes()


def unregister() -> None:
    """Undo `register`."""
    global pictures
    unregister_classes()
    bpy.utils.previews.remove(pictures)
    pictures = None
