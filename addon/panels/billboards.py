"""Panel *Billboard Cloud* in the sidebar tab *Farfield*."""

import math

import bpy

from ..bridge import cameras
from ..core.billboards.settings import BillboardSettings
from ..core.cameras import Camera
from ..core.settings import describe
from ..operators import billboards_estimates, long_work, properties
from ..operators.billboards import (
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_fade,
    FARFIELD_OT_billboards_show_level,
    refusal,
)
from ..operators.billboards_clouds import StandingCloud, cloud_for
from ..operators.billboards_job import BuildOptions
from .progress import draw_progress

MAIN_ROWS = ("method", "error", "levels", "texel_error", "textures")
OTHER_ROWS = [item.name for item in describe(BillboardSettings) if item.name not in MAIN_ROWS]
OPTION_ROWS = [item.name for item in describe(BuildOptions)]


class SidebarPanel:
    """Where Farfield's panels stand."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Farfield"


class FARFIELD_PT_billboards(SidebarPanel, bpy.types.Panel):
    """Settings, estimate, button, bar."""

    bl_idname = "FARFIELD_PT_billboards"
    bl_label = "Billboard Cloud"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw all rows; while a job runs they are grey and the bar takes the button's place."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        group = context.scene.farfield_billboards
        run = long_work.current()
        rows = layout.column()
        rows.enabled = run is None
        for name in MAIN_ROWS:
            row = rows.row()
            row.active = name != "error" or not (group.quads or group.texture_mb)  # a budget takes the error's place
            row.prop(group, name)
        if run is not None:
            draw_progress(layout, run)
            return
        reason = refusal(context)
        if reason:
            layout.label(text=reason, icon="INFO")
        else:
            draw_estimate(layout, context, group)
        row = layout.row()
        row.scale_y = 1.4
        row.operator(FARFIELD_OT_billboards_build.bl_idname, text="Build", icon="MESH_GRID")


class FARFIELD_PT_billboards_more(SidebarPanel, bpy.types.Panel):
    """Settings that most clouds do not need changed."""

    bl_idname = "FARFIELD_PT_billboards_more"
    bl_parent_id = "FARFIELD_PT_billboards"
    bl_label = "More"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the remaining settings."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.enabled = long_work.current() is None
        group = context.scene.farfield_billboards
        for name in OTHER_ROWS + OPTION_ROWS:
            layout.prop(group, name)


class FARFIELD_PT_billboards_figures(SidebarPanel, bpy.types.Panel):
    """The cloud of the active object in figures."""

    bl_idname = "FARFIELD_PT_billboards_figures"
    bl_parent_id = "FARFIELD_PT_billboards"
    bl_label = "Levels"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether the active object has a cloud or is one."""
        return cloud_for(context.scene, context.active_object) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row a level and the button that shows the right one."""
        camera = cameras.scene_camera(context.scene)
        draw_figures(self.layout, cloud_for(context.scene, context.active_object), camera)
        if camera is None:
            self.layout.label(text="The scene has no camera", icon="INFO")
        self.layout.operator(FARFIELD_OT_billboards_show_level.bl_idname, icon="VIEW_CAMERA")
        fade = self.layout.column(align=True)
        fade.operator(FARFIELD_OT_billboards_fade.bl_idname, icon="SMOOTHCURVE")
        fade.prop(context.scene.farfield_billboards, "fade_range", text="Range")


def draw_estimate(layout: bpy.types.UILayout, context: bpy.types.Context, group: bpy.types.PropertyGroup) -> None:
    """The figures to expect, or a button that works them out when that takes longer than a redraw should."""
    asked = billboards_estimates.question(context, properties.read(BillboardSettings, group))
    answer = billboards_estimates.known(asked)
    if answer is not None and answer.reason:
        layout.label(text=answer.reason, icon="ERROR")
    elif answer is not None:
        figures = [(f"{level.quads:,}", f"{level.texels:,}", megabytes(level.bytes)) for level in answer.levels]
        draw_table(layout, ("Estimate", "Quads", "Texels", "MB"), figures)
    elif billboards_estimates.ask_later(asked):
        draw_table(layout, ("Estimate", "Quads", "Texels", "MB"), [("...",) * 3] * group.levels)  # as tall as the figures will be
    else:
        layout.operator(FARFIELD_OT_billboards_estimate.bl_idname)


def draw_figures(layout: bpy.types.UILayout, cloud: StandingCloud, camera: Camera | None) -> None:
    """What each level of a standing cloud takes, and from which distance on `camera` cannot tell it from the original."""
    layout.label(text=cloud.collection.name, icon="OUTLINER_COLLECTION")
    rows = []
    for index, level in enumerate(cloud.levels):
        distance = "-" if camera is None else distance_text(camera.switch_distance(level["farfield_error"]))
        figures = f"{level['farfield_quads']:,}", f"{level['farfield_texels']:,}", megabytes(cloud.texture_bytes(index))
        rows.append((*figures, distance))
    draw_table(layout, ("Level", "Quads", "Texels", "MB", "From"), rows)


def distance_text(distance: float) -> str:
    """A switch distance in scene units; orthographic cameras know no distance."""
    return "always" if distance == 0.0 else "never" if math.isinf(distance) else f"{distance:.4g}"


def draw_table(layout: bpy.types.UILayout, head: tuple[str, ...], levels: list[tuple[str, ...]]) -> None:
    """One row a level with its number before it; figures stand below each other, to the right."""
    columns = layout.box().row()
    for place, title in enumerate(head):
        column = columns.column(align=True)
        column.alignment = "LEFT" if place == 0 else "RIGHT"
        column.label(text=title)
        for number, figures in enumerate(levels):
            column.label(text=str(number) if place == 0 else figures[place - 1])


def megabytes(count: float) -> str:
    """Bytes as megabytes, with two significant digits below ten."""
    return f"{count / 1e6:.2g}" if count < 1e7 else f"{count / 1e6:,.0f}"


CLASSES = (FARFIELD_PT_billboards, FARFIELD_PT_billboards_more, FARFIELD_PT_billboards_figures)


def register() -> None:
    """Register the panels, parents first."""
    for each in CLASSES:
        bpy.utils.register_class(each)


def unregister() -> None:
    """The reverse."""
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
