"""Panel *Billboard Cloud* in the sidebar tab *Farfield*, with one sub-panel per group of settings."""

import math

import bpy

from ..bridge import cameras
from ..bridge.billboards.clouds import MESH_TRIANGLES
from ..bridge.billboards.scene_clouds import SceneCloud, find_cloud
from ..bridge.geometry.mesh_arrays import count_triangles
from ..core.billboards.settings import BillboardSettings, BuildOptions, CrossfadeSettings
from ..core.geometry.cameras import Camera
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
LEVEL_TITLES = ("Level", "Tris", "in Mesh", "Quads", "MB", "Distance")


class BillboardSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of billboard clouds."""

    settings, property_name = describe(BillboardSettings, BuildOptions), "farfield_billboards"


class FARFIELD_PT_billboards(BillboardSettingsPanel, ToolPanel, bpy.types.Panel):
    """The main settings, the estimate, and the build button or the progress bar."""

    bl_idname = PANEL
    bl_label = "Billboard Cloud"
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
            draw_estimate(self.layout, context, group)
        draw_button(self.layout, FARFIELD_OT_billboards_build, "Build", "MESH_GRID")


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
        draw_levels(self.layout, cloud, camera)
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
    """The cross-fade between levels of all clouds."""

    bl_idname = "FARFIELD_PT_billboards_crossfade"
    bl_label = "Cross-Fade"
    settings, property_name = describe(CrossfadeSettings), "farfield_billboards"
    buttons = ((FARFIELD_OT_billboards_crossfade, "Cross-Fade Levels", "SMOOTHCURVE"),)


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
        draw_table(layout, ESTIMATE_TITLES, rows)
    elif cache.request(key):
        # Placeholders with the height of the coming table, so that the panel does not jump.
        draw_table(layout, ESTIMATE_TITLES, [(str(index), *("..." for _ in ESTIMATE_TITLES[1:])) for index in range(group.levels)])
    else:
        layout.operator(FARFIELD_OT_billboards_estimate.bl_idname, text="Estimate")


def draw_levels(layout: bpy.types.UILayout, cloud: SceneCloud, camera: Camera | None) -> None:
    """Draw triangles, those in decimated meshes, quads and memory of each level of a cloud, its switch distance for `camera`, and notes."""
    layout.label(text=cloud.collection.name, icon="OUTLINER_COLLECTION")
    rows = []
    for index, level in enumerate(cloud.levels):
        distance = "-" if camera is None else format_distance(camera.switch_distance(level["farfield_error"]))
        triangles = count_triangles(level.data)
        in_meshes = level.get(MESH_TRIANGLES)
        counts = f"{triangles:,}", "-" if in_meshes is None else f"{in_meshes:,}", f"{level['farfield_quads']:,}"
        figures = *counts, format_megabytes(cloud.texture_bytes(index))
        rows.append((str(index), *figures, distance))
    draw_table(layout, LEVEL_TITLES, rows)
    for note in cloud.notes:
        draw_message(layout, note, "INFO")


def format_distance(distance: float) -> str:
    """Return a switch distance in scene units as text; for orthographic cameras it is "always" or "never"."""
    return "always" if distance == 0.0 else "never" if math.isinf(distance) else f"{distance:.4g}"


CLASSES = (
    FARFIELD_PT_billboards,
    *sub_panels(BillboardSettingsPanel, PANEL),
    FARFIELD_PT_billboards_levels,
    FARFIELD_PT_billboards_crossfade,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
