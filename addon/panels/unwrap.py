"""Panel *View-Dependent Unwrap* in the sidebar tab *Farfield*."""

import bpy

from ..bridge import uv_maps, uv_overlay
from ..core.settings import describe
from ..core.unwrap.settings import UnwrapSettings
from ..operators.unwrap import (
    FARFIELD_OT_unwrap,
    FARFIELD_OT_unwrap_direction,
    FARFIELD_OT_unwrap_overlay,
    FARFIELD_OT_unwrap_picture,
    is_unwrapped,
    refusal,
)
from .sidebar import SidebarPanel, draw_bar, draw_button, settings_rows

ROWS = [item.name for item in describe(UnwrapSettings)]
OF_IMPORTANCE = {"direction": ("direction", "look"), "group": ("group",)}  # rows of some kinds of importance alone
FIGURES = (
    ("Stretch L2", "l2", "{:.3f}"),
    ("95 % below", "p95", "{:.2f}"),
    ("Largest", "linf", "{:.2f}"),
    ("Flips", "flips", "{:.0f}"),
    ("Overlaps", "overlaps", "{:.0f}"),
    ("Least shape", "min_shape", "{:.3f}"),
    ("Filled", "fill", "{:.0%}"),
    ("Density ratio", "density_ratio", "{:.2f}"),
)


class FARFIELD_PT_unwrap(SidebarPanel, bpy.types.Panel):
    """Settings, button, bar, figures."""

    bl_idname = "FARFIELD_PT_unwrap"
    bl_label = "View-Dependent Unwrap"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the rows that count; while a job runs they are grey and the bar takes the button's place."""
        layout, group = self.layout, context.scene.farfield_unwrap
        rows = settings_rows(layout)
        for name in ROWS:
            if group.importance in OF_IMPORTANCE.get(name, (group.importance,)) and (name != "density_ratio" or group.importance != "even"):
                draw_row(rows, context, group, name)
        if draw_bar(layout):
            return
        reason = refusal(context)
        if reason:
            layout.label(text=reason, icon="INFO")
        draw_button(layout, FARFIELD_OT_unwrap, "Unwrap", "UV")
        if is_unwrapped(context.active_object):
            draw_figures(layout, uv_maps.figures_of(context.active_object.data))
            tools = layout.row(align=True)
            tools.operator(FARFIELD_OT_unwrap_overlay.bl_idname, icon="OVERLAY", depress=uv_overlay.shown())
            tools.operator(FARFIELD_OT_unwrap_picture.bl_idname, text="", icon="IMAGE_DATA")


def draw_row(layout: bpy.types.UILayout, context: bpy.types.Context, group: bpy.types.PropertyGroup, name: str) -> None:
    """One setting; the vertex group is chosen from those of the active object, the direction may be taken from the view."""
    if name == "group" and context.active_object is not None and context.active_object.type == "MESH":
        layout.prop_search(group, name, context.active_object, "vertex_groups")
        return
    layout.prop(group, name)
    if name == "direction":
        layout.operator(FARFIELD_OT_unwrap_direction.bl_idname, icon="VIEW3D")


def draw_figures(layout: bpy.types.UILayout, figures: dict[str, float]) -> None:
    """What the UV map is worth."""
    columns = layout.box().row()
    names, values = columns.column(align=True), columns.column(align=True)
    values.alignment = "RIGHT"
    for title, key, shape in FIGURES:
        if figures.get(key, 0.0) or key != "density_ratio":
            names.label(text=title)
            values.label(text=shape.format(figures.get(key, 0.0)))


CLASSES = (FARFIELD_PT_unwrap,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
