"""Panel *Distance-Ready*, the first in the sidebar tab *Farfield*: the heaviest objects, and levels by distance for the scene."""

import bpy

from ..bridge import cameras
from ..bridge.distance.chains import Chain, read_chains
from ..bridge.distance.placing import has_levels, shows_levels
from ..core.distance.settings import DistanceSettings
from ..core.json_values import parse_json
from ..core.messages import format_count
from ..core.settings import describe
from ..operators.distance.operators import (
    FARFIELD_OT_distance_analyze,
    FARFIELD_OT_distance_build,
    FARFIELD_OT_distance_remove,
    FARFIELD_OT_distance_show_original,
    disabled_reason,
)
from .sidebar import SettingsPanel, SidebarPanel, ToolPanel, draw_button, draw_message, draw_progress_bar, draw_table

PLAN_TITLES = ("Object", "Triangles", "Nearest")
LEVEL_TITLES = ("Level", "Triangles", "From")
MAX_ROWS = 8


class FARFIELD_PT_distance(SettingsPanel, ToolPanel, bpy.types.Panel):
    """The settings, and the buttons or the progress bar."""

    bl_idname = "FARFIELD_PT_distance"
    bl_label = "Distance-Ready"
    page = "distance"
    settings, property_name = describe(DistanceSettings), "farfield_distance"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, the table of the latest analysis and the buttons. While a job runs, the progress bar replaces the buttons."""
        layout = self.layout
        self.draw_settings(context)
        if draw_progress_bar(layout, disabled_reason(context)):
            return
        if cameras.read_scene_camera(context.scene) is None:
            draw_message(layout, "Add a camera: levels depend on its distance", "INFO")
        layout.operator(FARFIELD_OT_distance_analyze.bl_idname, text="What Is Heavy?", icon="VIEWZOOM")
        draw_plans(layout, context.scene.farfield_distance.analysis)
        draw_button(layout, FARFIELD_OT_distance_build, "Make Distance-Ready", "MOD_DECIM")
        if has_levels(context.scene):
            column = layout.column(align=True)
            is_original = not shows_levels(context.scene.objects)
            column.operator(FARFIELD_OT_distance_show_original.bl_idname, text="Show Originals", icon="MESH_DATA", depress=is_original)
            column.operator(FARFIELD_OT_distance_remove.bl_idname, text="Remove", icon="X")


class FARFIELD_PT_distance_levels(SidebarPanel, bpy.types.Panel):
    """The levels of each object."""

    bl_idname = "FARFIELD_PT_distance_levels"
    bl_parent_id = "FARFIELD_PT_distance"
    bl_label = "Levels by Distance"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether an object of the scene shows levels."""
        return has_levels(context.scene)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a table per object."""
        for chain in read_chains()[:MAX_ROWS]:
            self.layout.label(text=chain.name, icon="MOD_DECIM")
            draw_chain(self.layout, chain, context.scene)


def draw_plans(layout: bpy.types.UILayout, analysis: str) -> None:
    """Draw the table of an analysis, heaviest objects first."""
    plans = parse_json(analysis) if analysis else []
    rows = []
    for plan in plans[:MAX_ROWS]:
        name = f"{plan['places']:,} x {plan['name']}" if plan["places"] > 1 else plan["name"]
        rows.append((name, f"{plan['triangles']:,}", f"{plan['nearest']:,.1f}"))
    if rows:
        draw_table(layout, PLAN_TITLES, rows)
        count = sum(plan["outcome"] != "stays" for plan in plans)
        layout.label(text=f"{count:,} of {format_count(len(plans), 'object')} would get levels")
    if len(plans) > MAX_ROWS:
        layout.label(text=f"and {len(plans) - MAX_ROWS:,} more")


def draw_chain(layout: bpy.types.UILayout, chain: Chain, scene: bpy.types.Scene) -> None:
    """Draw the triangles of each level, and the distance from the active camera from which it shows at scale 1."""
    camera = cameras.read_scene_camera(scene)
    rows = []
    for number, (count, size) in enumerate(zip(chain.triangles, chain.pixel_sizes, strict=True)):
        distance = "" if camera is None else f"{camera.switch_distance(size):.3g}"
        rows.append((f"L{number}", f"{count:,}", distance))
    draw_table(layout, LEVEL_TITLES, rows)


CLASSES = (FARFIELD_PT_distance, FARFIELD_PT_distance_levels)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
