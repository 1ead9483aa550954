"""Panel *Distance-Ready*, the first in the sidebar tab *Farfield*: the heaviest objects, and levels by distance for the scene."""

import bpy

from ..bridge import cameras
from ..bridge.distance.chains import Chain, read_chains
from ..bridge.distance.frame_renders import LEVELS, ORIGINALS
from ..bridge.distance.placing import has_levels, max_errors, shows_levels
from ..core.distance.settings import DistanceSettings
from ..core.json_values import parse_json
from ..core.messages import format_bytes, format_count
from ..core.settings import describe
from ..operators import long_work
from ..operators.distance.analysis import OUTCOMES
from ..operators.distance.operators import (
    FARFIELD_OT_distance_analyze,
    FARFIELD_OT_distance_build,
    FARFIELD_OT_distance_measure,
    FARFIELD_OT_distance_remove,
    FARFIELD_OT_distance_show_original,
    disabled_reason,
)
from ..operators.distance.viewport import FARFIELD_OT_distance_follow_view
from ..operators.distance.viewport import current as following
from .sidebar import (
    SettingsPanel,
    SidebarPanel,
    ToolPanel,
    draw_button,
    draw_message,
    draw_progress_bar,
    draw_table,
    settings_column,
    sub_panels,
)

LEVEL_TITLES = ("Level", "Triangles", "From")
FIGURE_TITLES = ("Per Frame", "Originals", "Levels")
MAX_ROWS = 8
PLAN_ICONS = {"build": "MOD_DECIM", "ready": "CHECKMARK", "stays": "MESH_DATA", "original": "MESH_DATA"}
NAME_PART, TRIANGLES_PART = 0.52, 0.55  # Of a row, and of the rest of it.


class DistanceSettingsPanel(SettingsPanel):
    """Mixin of the panels with settings."""

    settings, property_name = describe(DistanceSettings), "farfield_distance"


class FARFIELD_UL_distance_plans(bpy.types.UIList):
    """The objects of the latest analysis, heaviest first, with their triangles at all places and their largest extent in an image."""

    bl_idname = "FARFIELD_UL_distance_plans"

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: bpy.types.PropertyGroup,
        item: bpy.types.PropertyGroup,
        icon: int,
        active_data: bpy.types.PropertyGroup,
        active_property: str,
    ) -> None:
        """Draw one row."""
        row = layout.split(factor=NAME_PART)
        row.active = item.current_outcome in ("build", "ready")
        row.label(text=item.name, icon=PLAN_ICONS[item.current_outcome])
        figures = row.split(factor=TRIANGLES_PART)
        figures.alignment = "RIGHT"
        figures.label(text=shorten_number(item.places * item.triangles))
        figures.label(text=f"{item.pixels:.0f}")


class FARFIELD_PT_distance(DistanceSettingsPanel, ToolPanel, bpy.types.Panel):
    """The settings, and the buttons or the progress bar."""

    bl_idname = "FARFIELD_PT_distance"
    bl_label = "Distance-Ready"
    page = "distance"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, the list of the latest analysis and the buttons. While a job runs, the progress bar replaces the large button
        and the others are disabled: without them, the sidebar would scroll."""
        self.draw_settings(context)
        layout, group = self.layout.column(), context.scene.farfield_distance
        layout.enabled = long_work.current_run() is None
        if cameras.read_scene_camera(context.scene) is None:
            draw_message(layout, "Add a camera: levels depend on its distance", "INFO")
        layout.operator(FARFIELD_OT_distance_analyze.bl_idname, text="What Is Heavy?", icon="VIEWZOOM")
        draw_plans(layout, group)
        if not draw_progress_bar(self.layout, disabled_reason(context)):
            draw_button(layout, FARFIELD_OT_distance_build, "Make Distance-Ready", "MOD_DECIM")
        if has_levels(context.scene):
            draw_figures(self.layout, group.figures)
            column = self.layout.column(align=True)
            column.enabled = layout.enabled
            column.operator(FARFIELD_OT_distance_measure.bl_idname, text="Measure", icon="TIME")
            row = column.row(align=True)
            row.operator(
                FARFIELD_OT_distance_follow_view.bl_idname, text="Follow View", icon="VIEW_PERSPECTIVE", depress=following.is_running
            )
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
        errors = max_errors(context.scene)
        for chain in [chain for chain in read_chains() if chain.collections[0] in errors][:MAX_ROWS]:
            self.layout.label(text=chain.name, icon="MOD_DECIM")
            draw_chain(self.layout, chain, context.scene, errors[chain.collections[0]])


def draw_plans(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup) -> None:
    """Draw the list of an analysis, and the choices for its active row."""
    if not group.plans:
        return
    titles = layout.split(factor=NAME_PART)
    titles.label(text="Object")
    figures = titles.split(factor=TRIANGLES_PART)
    figures.alignment = "RIGHT"
    figures.label(text="Triangles")
    figures.label(text="Pixels")
    layout.template_list(FARFIELD_UL_distance_plans.bl_idname, "", group, "plans", group, "active_plan", rows=4, maxrows=MAX_ROWS)
    if group.active_plan < len(group.plans):
        plan = group.plans[group.active_plan]
        column = settings_column(layout)
        row = column.row()
        row.enabled = False
        row.prop(plan, "nearest")
        images = f"{plan.image_megabytes:,.3g} MB of images" if plan.image_megabytes else "no images"
        draw_message(column, f"{format_count(plan.places, 'place')}, {images}. {OUTCOMES[plan.current_outcome]}", "INFO")
        column.prop(plan, "method")
        if plan.method != "original":
            column.prop(plan, "error_factor")


def draw_figures(layout: bpy.types.UILayout, figures: str) -> None:
    """Draw what the latest measurement has found."""
    if not figures:
        return
    values = parse_json(figures)
    before, after = values[ORIGINALS], values[LEVELS]
    rows = [("Seconds", f"{before['seconds']:,.1f}", f"{after['seconds']:,.1f}")]
    if before["memory"]:
        rows.append(("Memory", format_bytes(before["memory"]), format_bytes(after["memory"])))
    draw_table(layout, FIGURE_TITLES, [*rows, ("FLIP", "0", f"{values['flip']:.3f}")])


def shorten_number(count: int) -> str:
    """Return a number with three significant digits, such as "45.2 M"."""
    for unit, size in (("B", 1e9), ("M", 1e6), ("k", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}" if count < 999.5 * size else f"{count / size:,.0f} {unit}"
    return f"{count:,}"


def draw_chain(layout: bpy.types.UILayout, chain: Chain, scene: bpy.types.Scene, max_error: float) -> None:
    """Draw the triangles of each level, and the distance from the active camera from which it shows at scale 1."""
    camera = cameras.read_scene_camera(scene)
    rows = []
    for number, (count, size) in enumerate(zip(chain.triangles, chain.pixel_sizes, strict=True)):
        distance = "" if camera is None else f"{camera.switch_distance(size / max_error):,.4g}"
        rows.append((f"L{number}", f"{count:,}", distance))
    draw_table(layout, LEVEL_TITLES, rows)


CLASSES = (
    FARFIELD_UL_distance_plans,
    FARFIELD_PT_distance,
    *sub_panels(DistanceSettingsPanel, "FARFIELD_PT_distance"),
    FARFIELD_PT_distance_levels,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
