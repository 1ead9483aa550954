"""Panel *View-Dependent Unwrap* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.unwrap import uv_maps
from ..bridge.unwrap.stretch_display import overlay
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
from .sidebar import SettingsPanel, ToolPanel, draw_button, draw_progress_bar

METRICS = (
    ("UV Islands", "islands", "{:,.0f}"),
    ("Stacked Islands", "stacked", "{:,.0f}"),
    ("UDIM Tiles", "tiles", "{:.0f}"),
    ("Stretch L2", "l2", "{:.3f}"),
    ("95th Percentile", "p95", "{:.2f}"),
    ("Max Compression", "linf", "{:.2f}"),
    ("Max Expansion", "max_expansion", "{:.2f}"),
    ("Symmetric Dirichlet", "symmetric_dirichlet", "{:.2f}"),
    ("Anisotropy, 99th Percentile", "anisotropy_p99", "{:.2f}"),
    ("Anisotropic Area", "anisotropic_fraction", "{:.1%}"),
    ("Needles", "needles", "{:.1%}"),
    ("Flips", "flips", "{:.0f}"),
    ("Overlaps", "overlaps", "{:.0f}"),
    ("Min Quality", "min_quality", "{:.3f}"),
    ("Pack Fill", "fill", "{:.0%}"),
    ("Texel Density", "texel_density", "{:.4g} px/m"),
    ("Density Ratio", "density_ratio", "{:.2f}"),
)


ONLY_IF_SET = {"stacked", "tiles", "density_ratio"}  # Metrics that are not drawn where they are 0 or 1.


class FARFIELD_PT_unwrap(SettingsPanel, ToolPanel, bpy.types.Panel):
    """Settings, the Unwrap button, and the metrics of the active object's UV map."""

    bl_idname = "FARFIELD_PT_unwrap"
    bl_label = "View-Dependent Unwrap"
    page = "unwrap"
    bl_options = {"DEFAULT_CLOSED"}
    settings, property_name = describe(UnwrapSettings), "farfield_unwrap"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings that count. While a job runs they are disabled and the progress bar replaces the button."""
        layout = self.layout
        self.draw_settings(context)
        if draw_progress_bar(layout, disabled_reason(context)):
            return
        draw_button(layout, FARFIELD_OT_unwrap, "Unwrap", "UV")
        if is_unwrapped(context.active_object):
            draw_metrics(layout, uv_maps.read_metrics(context.active_object.data), uv_maps.read_texel_densities(context.active_object.data))
            row = layout.row(align=True)
            row.operator(FARFIELD_OT_unwrap_overlay.bl_idname, text="Show Stretch", icon="OVERLAY", depress=overlay.is_shown)
            row.operator(FARFIELD_OT_unwrap_stretch_image.bl_idname, text="", icon="IMAGE_DATA")

    def draw_setting(self, layout: bpy.types.UILayout, context: bpy.types.Context, item: Description) -> None:
        """Draw one setting: a search field for the vertex group, and a button below the direction that sets it from the view."""
        if item.name == "vertex_group" and context.active_object is not None and context.active_object.type == "MESH":
            layout.prop_search(context.scene.farfield_unwrap, item.name, context.active_object, "vertex_groups")
            return
        super().draw_setting(layout, context, item)
        if item.name == "direction":
            layout.operator(FARFIELD_OT_unwrap_direction.bl_idname, text="From View", icon="VIEW3D")
        if item.name == "texel_density":
            layout.operator(FARFIELD_OT_unwrap_texel_density.bl_idname, text="From Active UV Map", icon="EYEDROPPER")


def draw_metrics(layout: bpy.types.UILayout, metrics: dict[str, float], texel_densities: dict[str, float]) -> None:
    """Draw the metrics of a UV map, and the texel density of each; some only where there is something to tell."""
    columns = layout.box().row()
    labels, values = columns.column(align=True), columns.column(align=True)
    values.alignment = "RIGHT"
    for label, key, number_format in METRICS:
        if metrics.get(key, 0.0) not in (0.0, 1.0) or key not in ONLY_IF_SET:
            labels.label(text=label)
            values.label(text=number_format.format(metrics.get(key, 0.0)))
    for name, density in texel_densities.items() if len(texel_densities) > 1 else ():
        labels.label(text=name, icon="UV")
        values.label(text=f"{density:.4g} px/m")


CLASSES = (FARFIELD_PT_unwrap,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
