"""Menus of presets, one per tool, which the headers of panels open, with a choice by pictures where presets have some."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews

from ..operators import documentation, presets

PICTURE_SIZE = 5.0  # widths of a button, for the chosen picture and all others
pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def picture_of(path: Path) -> Path:
    """Return the path of the picture of a preset, which may not exist."""
    return path.with_suffix(".webp")


class PresetsPanel:
    """Mixin of the menus. tool: whose presets they show."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "HEADER"  # It is shown as a popover only.
    bl_label = "Presets"
    bl_ui_units_x = 12
    tool = ""

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a choice by pictures, the presets of Farfield, those of the user, and a field that saves a new one."""
        layout = self.layout
        layout.operator_context = "EXEC_DEFAULT"
        if hasattr(context.window_manager, picture_property(self.tool)):
            choice = layout.column(align=True)
            choice.enabled = presets.FARFIELD_OT_preset_apply.poll(context)
            choice.template_icon_view(
                context.window_manager, picture_property(self.tool), show_labels=True, scale=PICTURE_SIZE, scale_popup=PICTURE_SIZE
            )
            choice.label(text="Click the picture for all others")
        column = layout.column(align=True)
        draw_preset(column, self.tool, "", "Defaults")
        for name, path in presets.find_presets(self.tool).items():
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
    members = {"__doc__": "Presets of the settings of this tool.", "__module__": __name__, "tool": tool}
    return type(menu_name(tool), (PresetsPanel, bpy.types.Panel), members | {"bl_idname": menu_name(tool)})


def picture_property(tool: str) -> str:
    """Return the name of the property of the window manager with the preset of a tool that was chosen by its picture."""
    return f"farfield_{tool}_picture"


def create_picture_property(tool: str, names: Sequence[str], icons: Sequence[int]) -> Any:
    """Return a property for the presets `names` of a tool with the numbers of their pictures. To choose one applies it."""

    def apply(owner: bpy.types.WindowManager, _context: bpy.types.Context) -> None:
        bpy.ops.farfield.preset_apply("EXEC_DEFAULT", True, tool=tool, name=getattr(owner, picture_property(tool)))

    items = [(name, name, "", icon, index) for index, (name, icon) in enumerate(zip(names, icons, strict=True))]
    return bpy.props.EnumProperty(name="Preset", description="Choose a preset by its picture", items=items, update=apply)


MENUS = tuple(create_menu(tool) for tool in documentation.TOOLS)
register_classes, unregister_classes = bpy.utils.register_classes_factory(MENUS)


def register() -> None:
    """Register the menus, and read the pictures."""
    global pictures
    pictures = bpy.utils.previews.new()
    for tool in documentation.TOOLS:
        paths = [path for path in presets.list_presets(presets.BUILT_IN / tool) if picture_of(path).exists()]
        icons = [pictures.load(str(path), str(picture_of(path)), "IMAGE").icon_id for path in paths]
        if paths:
            setattr(bpy.types.WindowManager, picture_property(tool), create_picture_property(tool, [path.stem for path in paths], icons))
    register_classes()


def unregister() -> None:
    """Undo `register`."""
    global pictures
    unregister_classes()
    for tool in documentation.TOOLS:
        if hasattr(bpy.types.WindowManager, picture_property(tool)):
            delattr(bpy.types.WindowManager, picture_property(tool))
    bpy.utils.previews.remove(pictures)
    pictures = None
