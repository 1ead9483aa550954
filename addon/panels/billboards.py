"""Panel *Billboard Cloud* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import math

import bpy

from ..bridge import cameras
from ..bridge.billboards.scene_clouds import SceneCloud, clouds_in, find_cloud
from ..bridge.geometry.mesh_arrays import count_triangles
from ..bridge.units import format_length
from ..core.billboards.settings import BillboardSettings, BuildOptions, CrossfadeSettings
from ..core.geometry.cameras import Camera
from ..core.messages import format_count
from ..core.settings import describe
from ..operators import properties
from ..operators.billboards.estimates import cache, estimate_key
from ..operators.billboards.operators import (
    FARFIELD_OT_billboards_build,
    FARFIELD_OT_billboards_crossfade,
    FARFIELD_OT_billboards_estimate,
    FARFIELD_OT_billboards_show,
    FARFIELD_OT_billboards_show_level,
    disabled_reason,
)
from ..operators.billboards.sources import describe_selection
from .results import draw_details
from .sidebar import (
    SettingsPanel,
    SidebarPanel,
    ToolPanel,
    draw_button,
    draw_message,
    draw_progress_bar,
    draw_table,
    format_megabytes,
    sub_panels,
)

PANEL = "FARFIELD_PT_billboards"
ESTIMATE_TITLES = ("Estimate", "Tris", "in Mesh", "Quads", "MB")
LEVEL_TITLES = ("Level", "Tris", "Quads", "MB", "From")


class BillboardSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of billboard clouds."""

    settings, property_name = describe(BillboardSettings, BuildOptions), "farfield_billboards"


class FARFIELD_PT_billboards(BillboardSettingsPanel, ToolPanel, bpy.types.Panel):
    """The main settings, the estimate, and the build button or the progress bar."""

    bl_idname = PANEL
    bl_label = "Billboard Cloud"
    bl_description = "Textured quads for what is far away, above all trees and crowds. Before that, Perceptual Levels"
    bl_options = {"DEFAULT_CLOSED"}
    page = "billboards"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings without a group. While a job runs, they are disabled and the progress bar replaces the button."""
        self.draw_settings(context)
        reason = disabled_reason(context)
        if draw_progress_bar(self.layout, reason):
            return
        if not reason:
            group = context.scene.farfield_billboards
            selection = describe_selection(context, group.combine_selected)
            if selection:
                draw_message(self.layout, selection, "OUTLINER_COLLECTION" if group.combine_selected else "OBJECT_DATA")
        draw_button(self.layout, FARFIELD_OT_billboards_build, "Build", "MESH_GRID")
        if not reason:  # Below the button, which an estimate would move.
            draw_estimate(self.layout, context, context.scene.farfield_billboards)


class CloudPanel(SidebarPanel):
    """A sub-panel for the cloud of the active object."""

    bl_parent_id = PANEL

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object belongs to a cloud."""
        return find_cloud(context.scene, context.active_object) is not None


class FARFIELD_PT_billboards_levels(CloudPanel, bpy.types.Panel):
    """The levels of the active cloud, and buttons that change its visibility."""

    bl_idname = "FARFIELD_PT_billboards_levels"
    bl_label = "Levels of Detail"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row per level and the visibility buttons."""
        cloud, camera = find_cloud(context.scene, context.active_object), cameras.read_scene_camera(context.scene)
        draw_levels(self.layout, cloud, camera, context.scene)
        if camera is None:
            self.layout.label(text="The scene has no active camera", icon="INFO")
        buttons = self.layout.column(align=True)
        if cloud.shows_sources:
            show = buttons.operator(FARFIELD_OT_billboards_show.bl_idname, text="Show Cloud", icon="MESH_GRID")
            show.show = "CLOUD"
        else:
            show = buttons.operator(FARFIELD_OT_billboards_show.bl_idname, text="Show Original", icon="MESH_DATA")
            show.show = "SOURCE"
        buttons.operator(FARFIELD_OT_billboards_show_level.bl_idname, text="Show Level for Camera", icon="VIEW_CAMERA")


class FARFIELD_PT_billboards_crossfade(CloudPanel, SettingsPanel, bpy.types.Panel):
    """The cross-fade between levels of the active cloud, or of all clouds."""

    bl_idname = "FARFIELD_PT_billboards_crossfade"
    bl_label = "Cross-Fade"
    settings, property_name = describe(CrossfadeSettings), "farfield_billboards"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings, and a toggle for the clouds of selected objects and one for all."""
        self.draw_settings(context)
        row, identifier = self.layout.row(align=True), FARFIELD_OT_billboards_crossfade.bl_idname
        fades = find_cloud(context.scene, context.active_object).has_crossfade
        all_fade = all(cloud.has_crossfade for cloud in clouds_in(context.scene))
        own = row.operator(identifier, text="Cross-Fade", icon="SMOOTHCURVE", depress=fades)
        own.enable, own.selected = not fades, True
        row.operator(identifier, text="All Clouds", depress=all_fade).enable = not all_fade


def draw_estimate(layout: bpy.types.UILayout, context: bpy.types.Context, group: bpy.types.PropertyGroup) -> None:
    """Draw the estimate, or a button that computes it if that takes longer than a redraw should."""
    key = estimate_key(context, properties.read(BillboardSettings, group))
    result = cache.find(key)
    if result is not None and result.error_message:
        draw_message(layout, result.error_message, "ERROR")
    elif result is not None:
        rows = [
            (str(index), f"{level.triangles:,}", f"{level.mesh_triangles:,}", f"{level.quads:,}", format_megabytes(level.bytes))
            for index, level in enumerate(result.levels)
        ]
        rows += [("",) * len(ESTIMATE_TITLES)] * (group.levels - len(rows))  # Other levels would cost too much; the height stays.
        draw_table(layout, ESTIMATE_TITLES, rows)
    elif cache.request(key):
        # Placeholders with the height of the coming table, so that the panel does not jump.
        draw_table(layout, ESTIMATE_TITLES, [(str(index), *("..." for _ in ESTIMATE_TITLES[1:])) for index in range(group.levels)])
    else:
        layout.operator(FARFIELD_OT_billboards_estimate.bl_idname, text="Estimate")


def draw_levels(layout: bpy.types.UILayout, cloud: SceneCloud, camera: Camera | None, scene: bpy.types.Scene) -> None:
    """Draw triangles, quads and memory of each level of a cloud, its switch distance for `camera` in units of `scene`, and its notes."""
    layout.label(text=cloud.collection.name, icon="OUTLINER_COLLECTION")
    rows = []
    for index, level in enumerate(cloud.levels):
        distance = "-" if camera is None else format_distance(scene, camera.switch_distance(level["farfield_error"]))
        counts = f"{count_triangles(level.data):,}", f"{level['farfield_quads']:,}"
        rows.append((str(index), *counts, format_megabytes(cloud.texture_bytes(index)), distance))
    draw_table(layout, LEVEL_TITLES, rows)
    if cloud.notes:
        draw_details(layout, cloud.notes, f"Details ({format_count(len(cloud.notes), 'note')})")


def format_distance(scene: bpy.types.Scene, distance: float) -> str:
    """Return a switch distance as text in the units of `scene`; for orthographic cameras it is "always" or "never"."""
    return "always" if distance == 0.0 else "never" if math.isinf(distance) else format_length(scene, distance)


CLASSES = (
    FARFIELD_PT_billboards,
    *sub_panels(BillboardSettingsPanel, PANEL),
    FARFIELD_PT_billboards_levels,
    FARFIELD_PT_billboards_crossfade,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
