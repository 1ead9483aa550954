"""Panel *Billboard Cloud* in the sidebar tab *Farfield*."""

import math

import bpy

from ..bridge import cameras
from ..core.billboards.settings import BillboardSettings
from ..core.cameras import Camera
from ..core.settings import describe
from ..operators import billboards_estimates, properties
from ..operators.billboards import (
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_fade,
    FARFIELD_OT_billboards_show_level,
    refusal,
)
from ..operators.billboards_clouds import StandingCloud, cloud_for
from ..operators.billboards_job import BuildOptions
from .sidebar import SidebarPanel, draw_bar, draw_button, draw_table, megabytes, settings_rows

MAIN_ROWS = ("method", "error", "levels", "texel_error", "textures")
OTHER_ROWS = [item.name for item in describe(BillboardSettings) if item.name not in MAIN_ROWS]
OPTION_ROWS = [item.name for item in describe(BuildOptions)]


class FARFIELD_PT_billboards(SidebarPanel, bpy.types.Panel):
    """Settings, estimate, button, bar."""

    bl_idname = "FARFIELD_PT_billboards"
    bl_label = "Billboard Cloud"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw all rows; while a job runs they are grey and the bar takes the button's place."""
        layout, group = self.layout, context.scene.farfield_billboards
        rows = settings_rows(layout)
        for name in MAIN_ROWS:
            row = rows.row()
            row.active = name != "error" or not (group.quads or group.texture_mb)  # a budget takes the error's place
            row.prop(group, name)
        if draw_bar(layout):
            return
        reason = refusal(context)
        if reason:
            layout.label(text=reason, icon="INFO")
        else:
            draw_estimate(layout, context, group)
        draw_button(layout, FARFIELD_OT_billboards_build, "Build", "MESH_GRID")


class FARFIELD_PT_billboards_more(SidebarPanel, bpy.types.Panel):
    """Settings that most clouds do not need changed."""

    bl_idname = "FARFIELD_PT_billboards_more"
    bl_parent_id = "FARFIELD_PT_billboards"
    bl_label = "More"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the remaining settings."""
        rows = settings_rows(self.layout)
        for name in OTHER_ROWS + OPTION_ROWS:
            rows.prop(context.scene.farfield_billboards, name)


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
        levels = enumerate(answer.levels)
        rows = [(str(number), f"{level.quads:,}", f"{level.texels:,}", megabytes(level.bytes)) for number, level in levels]
        draw_table(layout, ("Estimate", "Quads", "Texels", "MB"), rows)
    elif billboards_estimates.ask_later(asked):
        draw_table(
            layout, ("Estimate", "Quads", "Texels", "MB"), [(str(number), "...", "...", "...") for number in range(group.levels)]
        )  # as tall as the figures will be
    else:
        layout.operator(FARFIELD_OT_billboards_estimate.bl_idname)


def draw_figures(layout: bpy.types.UILayout, cloud: StandingCloud, camera: Camera | None) -> None:
    """What each level of a standing cloud takes, and from which distance on `camera` cannot tell it from the original."""
    layout.label(text=cloud.collection.name, icon="OUTLINER_COLLECTION")
    rows = []
    for index, level in enumerate(cloud.levels):
        distance = "-" if camera is None else distance_text(camera.switch_distance(level["farfield_error"]))
        figures = f"{level['farfield_quads']:,}", f"{level['farfield_texels']:,}", megabytes(cloud.texture_bytes(index))
        rows.append((str(index), *figures, distance))
    draw_table(layout, ("Level", "Quads", "Texels", "MB", "From"), rows)


def distance_text(distance: float) -> str:
    """A switch distance in scene units; orthographic cameras know no distance."""
    return "always" if distance == 0.0 else "never" if math.isinf(distance) else f"{distance:.4g}"


CLASSES = (FARFIELD_PT_billboards, FARFIELD_PT_billboards_more, FARFIELD_PT_billboards_figures)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
