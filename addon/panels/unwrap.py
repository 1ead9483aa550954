"""Panels *Unwrap* in the sidebar tab *Farfield* of the 3D Viewport and the UV Editor, and entries of the menus *UV*."""

from collections.abc import Callable, Sequence
from typing import ClassVar

import bpy

from ..bridge.unwrap import uv_maps
from ..bridge.unwrap.stretch_display import overlay
from ..core.messages import format_number
from ..core.settings import Description, describe
from ..core.unwrap.settings import UnwrapSettings
from ..operators.unwrap.operators import (
    FARFIELD_OT_unwrap,
    FARFIELD_OT_unwrap_direction,
    FARFIELD_OT_unwrap_overlay,
    FARFIELD_OT_unwrap_stretch_image,
    FARFIELD_OT_unwrap_texel_density,
    disabled_reason,
    is_unwrapped,
)
from .sidebar import BLUE, RED, WHITE, SettingsPanel, SidebarPanel, ToolPanel, draw_button, draw_legend, draw_progress_bar, sub_panels


def format_density(density: float) -> str:
    """Return a texel density with its unit."""
    return f"{format_number(density)} px/m"


SUMMARY = (
    ("UV Islands", "islands", "{:,.0f}".format),
    ("Stacked Islands", "stacked", "{:,.0f}".format),
    ("UDIM Tiles", "tiles", "{:.0f}".format),
    ("Pack Fill", "fill", "{:.0%}".format),
    ("Texel Density", "texel_density", format_density),
    ("Flips", "flips", "{:.0f}".format),
    ("Overlaps", "overlaps", "{:.0f}".format),
)
METRICS = (
    ("Stretch L2", "l2", "{:.3f}".format),
    ("95th Percentile", "p95", "{:.2f}".format),
    ("Max Compression", "linf", "{:.2f}".format),
    ("Max Expansion", "max_expansion", "{:.2f}".format),
    ("Symmetric Dirichlet", "symmetric_dirichlet", "{:.2f}".format),
    ("Anisotropy, 99th Percentile", "anisotropy_p99", "{:.2f}".format),
    ("Anisotropic Area", "anisotropic_fraction", "{:.1%}".format),
    ("Needles", "needles", "{:.1%}".format),
    ("Min Quality", "min_quality", "{:.3f}".format),
    ("Density Ratio", "density_ratio", "{:.2f}".format),
)
LEGEND = ((RED, "Too small in the map: blurred"), (WHITE, "No stretch"), (BLUE, "Too large in the map: smeared"))
ONLY_IF_SET = {"stacked", "tiles", "density_ratio"}  # Metrics that are not drawn where they are 0 or 1.
PANEL, EDITOR_PANEL = "FARFIELD_PT_unwrap", "FARFIELD_PT_unwrap_uv_editor"


class UnwrapSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of an unwrap."""

    settings, property_name = describe(UnwrapSettings), "farfield_unwrap"

    def draw_setting(self, layout: bpy.types.UILayout, context: bpy.types.Context, item: Description) -> None:
        """Draw one setting: a search field for the vertex group, and buttons that read the direction or the texel density."""
        if item.name == "vertex_group" and context.active_object is not None and context.active_object.type == "MESH":
            layout.prop_search(context.scene.farfield_unwrap, item.name, context.active_object, "vertex_groups")
            return
        fits = item.name == "texel_density" and context.scene.farfield_unwrap.texel_density == 0.0
        row = layout.row()
        row.active = not fits
        super().draw_setting(row, context, item)
        if fits:
            layout.label(text="0: islands fill the texture", icon="FULLSCREEN_ENTER")
        if item.name == "direction" and self.bl_space_type == "VIEW_3D":
            layout.operator(FARFIELD_OT_unwrap_direction.bl_idname, text="From View", icon="VIEW3D")
        if item.name == "texel_density":
            layout.operator(FARFIELD_OT_unwrap_texel_density.bl_idname, text="From Active UV Map", icon="EYEDROPPER")


class UnwrapPanel(UnwrapSettingsPanel, ToolPanel):
    """Mixin of the panels in the 3D Viewport and the UV Editor: settings, the Unwrap button, and a summary of the active object's map."""

    bl_label = "Unwrap"
    bl_description = "UV maps with little stretch, evenly or with more texels where they are seen"
    page = "unwrap"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings that count. While a job runs they are disabled and the progress bar replaces the button."""
        layout = self.layout
        self.draw_settings(context)
        if draw_progress_bar(layout, disabled_reason(context)):
            return
        draw_button(layout, FARFIELD_OT_unwrap, "Unwrap", "UV")
        if is_unwrapped(context.active_object):
            mesh = context.active_object.data
            draw_metrics(layout, SUMMARY, uv_maps.read_metrics(mesh), uv_maps.read_texel_densities(mesh))
            row = layout.row(align=True)
            row.operator(FARFIELD_OT_unwrap_overlay.bl_idname, text="Show Stretch", icon="OVERLAY", depress=overlay.is_shown)
            row.operator(FARFIELD_OT_unwrap_stretch_image.bl_idname, text="", icon="IMAGE_DATA")
            if overlay.is_shown:
                draw_legend(layout, LEGEND)


class MetricsPanel(SidebarPanel):
    """Mixin of the sub-panels with all metrics."""

    bl_label = "Distortion"
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has been unwrapped."""
        return is_unwrapped(context.active_object)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the metrics of the active object's UV map."""
        draw_metrics(self.layout, METRICS, uv_maps.read_metrics(context.active_object.data))


class FARFIELD_PT_unwrap(UnwrapPanel, bpy.types.Panel):
    """The panel in the 3D Viewport."""

    bl_idname = PANEL
    bl_options = {"DEFAULT_CLOSED"}


class FARFIELD_PT_unwrap_metrics(MetricsPanel, bpy.types.Panel):
    """The metrics in the 3D Viewport."""

    bl_idname = f"{PANEL}_metrics"
    bl_parent_id = PANEL


class EditorSettingsPanel(UnwrapSettingsPanel):
    """Mixin of the panels of settings in the UV Editor."""

    bl_space_type = "IMAGE_EDITOR"


class FARFIELD_PT_unwrap_uv_editor(EditorSettingsPanel, UnwrapPanel, bpy.types.Panel):
    """The panel in the UV Editor."""

    bl_idname = EDITOR_PANEL

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the Image Editor is a UV Editor."""
        return context.area is not None and context.area.ui_type == "UV"


class FARFIELD_PT_unwrap_uv_editor_metrics(MetricsPanel, bpy.types.Panel):
    """The metrics in the UV Editor."""

    bl_idname = f"{EDITOR_PANEL}_metrics"
    bl_parent_id = EDITOR_PANEL
    bl_space_type = "IMAGE_EDITOR"


def draw_metrics(
    layout: bpy.types.UILayout,
    rows: Sequence[tuple[str, str, Callable[[float], str]]],
    metrics: dict[str, float],
    texel_densities: dict[str, float] | None = None,
) -> None:
    """Draw metrics of a UV map, some only where there is something to tell, and the texel density of each where there are several.

    rows: label and name of each metric, and the function that makes text of it.
    """
    columns = layout.box().row()
    labels, values = columns.column(align=True), columns.column(align=True)
    values.alignment = "RIGHT"
    for label, key, to_text in rows:
        if metrics.get(key, 0.0) not in (0.0, 1.0) or key not in ONLY_IF_SET:
            labels.label(text=label)
            values.label(text=to_text(metrics.get(key, 0.0)))
    for name, density in (texel_densities or {}).items() if len(texel_densities or {}) > 1 else ():
        labels.label(text=name, icon="GROUP_UVS")
        values.label(text=format_density(density))


CLASSES = (
    FARFIELD_PT_unwrap,
    *sub_panels(UnwrapSettingsPanel, PANEL),
    FARFIELD_PT_unwrap_metrics,
    FARFIELD_PT_unwrap_uv_editor,
    *sub_panels(EditorSettingsPanel, EDITOR_PANEL),
    FARFIELD_PT_unwrap_uv_editor_metrics,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
