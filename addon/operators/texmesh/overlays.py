"""Operators that show the features of meshes: as colors in 3D Viewports, and as a plot in an image."""

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ...bridge.imaging.images import create_image
from ...bridge.overlays.line_chart import draw_line_chart
from ...bridge.texmesh.level_sets import ERROR, FIGURES, SWITCH_DISTANCE, LevelSet, find_level_set
from ...bridge.texmesh.scale_attributes import SCALE_ATTRIBUTE, ScaleOverlay, read_scales
from ...core.errors import SettingsError
from ...core.texmesh.figures import read_figures, step_function
from ...core.texmesh.scale_space.features import SCALES
from ...core.texmesh.settings import InspectionSettings
from .. import image_editors, long_work, properties
from ..error_reports import report_message, reports_errors

NO_SCALES = "Analyze a mesh first"
overlay = ScaleOverlay(lambda: bpy.context.scene.farfield_texmesh_inspection.lowest_scale)
Lines = Mapping[str, Sequence[tuple[float, float]]]


class FARFIELD_PG_texmesh_inspection(bpy.types.PropertyGroup):
    """Settings of the panel *Inspect*, stored per scene."""

    __annotations__ = properties.build_annotations(InspectionSettings, set())


class FARFIELD_OT_texmesh_overlay(bpy.types.Operator):
    """Color vertices by the last scale at which they are features: blue for details, yellow for what remains at the coarsest scale"""

    bl_idname = "farfield.texmesh_overlay"
    bl_label = "Show Features by Scale"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the overlay is shown, or a mesh of the scene has been analyzed."""
        has_scales = overlay.is_shown or any(_has_scales(item) for item in context.scene.objects)
        return long_work.poll_with_reason(cls, "" if has_scales else NO_SCALES)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show or hide the overlay."""
        if overlay.is_shown:
            overlay.hide()
        else:
            overlay.show()
        return {"FINISHED"}


class FARFIELD_OT_texmesh_plot(bpy.types.Operator):
    """Draw how many features the active object has at each scale, and where its levels switch, as an image for the Image Editor"""

    bl_idname = "farfield.texmesh_plot"
    bl_label = "Plot Features and Levels"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the active object has levels or has been analyzed."""
        item = context.active_object
        has_figures = item is not None and (_has_scales(item) or find_level_set(context.scene, item) is not None)
        return long_work.poll_with_reason(cls, "" if has_figures else "Select an object with levels, or analyze it")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Create the image, in place of an earlier one, and show it in open Image Editors that show none."""
        item = context.active_object
        levels = find_level_set(context.scene, item)
        if levels is not None and FIGURES in levels.collection:
            name, charts = levels.source_name, _level_charts(levels)
        elif _has_scales(item):
            name, charts = item.name, _feature_charts(item)
        else:
            raise SettingsError(f'The levels of "{item.name}" have no figures; make them again.')
        sheet = np.concatenate([draw_line_chart(*chart) for chart in reversed(charts)])  # row 0 at the bottom
        image = _replace_image(f"{name} Scale Plot", np.dstack([sheet, np.ones(sheet.shape[:2])]))
        _show_in_editors(context, image)
        report_message(self, f'Created the image "{image.name}"; open it in an Image Editor.')
        return {"FINISHED"}


def _has_scales(item: bpy.types.Object) -> bool:
    return item.type == "MESH" and SCALE_ATTRIBUTE in item.data.attributes


def _level_charts(levels: LevelSet) -> list[tuple[str, str, Lines]]:
    """Return titles, labels and lines of three charts: counts of features, Figure 10, and Figure 11 of the paper."""
    figures = read_figures(levels.collection[FIGURES])
    name = levels.source_name
    ratios = [level[SWITCH_DISTANCE] / level[ERROR] for level in levels.levels if level[ERROR] and SWITCH_DISTANCE in level]
    unit, factor = ("distance", ratios[0]) if ratios and ratios[0] > 0.0 else ("pixel size", 1.0)
    corners = [(math.log10(size * factor), index) for size, index in step_function(figures.candidate_sizes.tolist()) if size > 0.0]
    shown = {
        float(np.argmin(np.abs(figures.candidate_triangles - count))): float(level[ERROR]) * factor
        for count, level in zip(figures.level_triangles[1:], levels.levels[1:], strict=False)
        if level[ERROR]
    }
    chosen = [(math.log10(distance), index) for index, distance in shown.items()]
    return [
        _count_chart(name, figures.features),
        (f"{name}: range of filtered values", "scale", {"largest minus smallest": list(enumerate(figures.ranges.tolist()))}),
        (f"{name}: coarsest level by {unit}", f"log10 {unit}", {"all that were tried": corners, "levels": sorted(chosen)}),
    ]


def _feature_charts(item: bpy.types.Object) -> list[tuple[str, str, Lines]]:
    scales = read_scales(item.data)
    if scales is None:
        raise SettingsError(f'The scales of "{item.name}" cannot be read; leave Edit Mode, or analyze it again.')
    counts = np.bincount(np.clip(scales, 0, SCALES - 1), minlength=SCALES)[::-1].cumsum()[::-1]
    return [_count_chart(item.name, counts)]


def _count_chart(name: str, counts: np.ndarray) -> tuple[str, str, Lines]:
    points = [(scale, math.log10(count)) for scale, count in enumerate(counts.tolist()) if count > 0]
    return f"{name}: log10 of features", "scale", {"features at this or a later scale": points}


def _replace_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Create an image; what uses an earlier one of this name shows the new one."""
    earlier = bpy.data.images.get(name)
    image = create_image(name, pixels, is_data=False)
    replaces = earlier is not None and earlier.library is None
    image_editors.remember_former(image, earlier if replaces else None)
    if replaces:
        earlier.user_remap(image)
        bpy.data.images.remove(earlier)
        image.name = name
    return image


def _show_in_editors(context: bpy.types.Context, image: bpy.types.Image) -> None:
    windows = [] if bpy.app.background else context.window_manager.windows
    for area in [area for window in windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]:
        if area.spaces.active.image is None:
            area.spaces.active.image = image
        area.tag_redraw()


CLASSES = (FARFIELD_PG_texmesh_inspection, FARFIELD_OT_texmesh_overlay, FARFIELD_OT_texmesh_plot)
register, unregister_settings = properties.scene_settings_factory("farfield_texmesh_inspection", FARFIELD_PG_texmesh_inspection, CLASSES)


def unregister() -> None:
    """Hide the overlay, remove the settings from scenes and unregister the classes."""
    overlay.hide()
    unregister_settings()
