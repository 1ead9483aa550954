"""Panel *Photo Texture* in the sidebar tab *Farfield*, and *Register Photograph* in that of the Image Editor."""

import bpy
import numpy as np

from ..bridge.photos.coverage_overlay import overlay as coverage_overlay
from ..bridge.photos.pair_markers import ARROW_SCALE
from ..bridge.photos.photo_images import is_missing
from ..bridge.photos.point_pairs import PROPERTY, read_pairs
from ..bridge.photos.scene_cameras import find_background
from ..core.messages import format_count
from ..core.photos.registration.registration import MIN_PAIRS, MIN_PAIRS_WITH_LENS
from ..core.photos.settings import PhotosSettings
from ..core.settings import describe
from ..operators import image_editors
from ..operators.photos.import_cameras import FARFIELD_OT_photos_import_cameras
from ..operators.photos.operators import FARFIELD_OT_photos_merge
from ..operators.photos.previews import FARFIELD_OT_photos_draw_overlays, FARFIELD_OT_photos_show_coverage
from ..operators.photos.refinement import FARFIELD_OT_photos_refine
from ..operators.photos.registration import (
    FARFIELD_OT_photos_add_pairs,
    FARFIELD_OT_photos_register,
    FARFIELD_OT_photos_remove_pair,
    describe_next_step,
    find_image_problem,
    find_running,
)
from ..operators.photos.sources import disabled_reason, find_cameras
from .sidebar import (
    BLUE,
    GREEN,
    RED,
    SettingsPanel,
    ToolPanel,
    draw_button,
    draw_legend,
    draw_message,
    draw_progress_bar,
    settings_column,
    sub_panels,
)

PANEL = "FARFIELD_PT_photos"
LEGEND = ((GREEN, "In one photograph"), (BLUE, "Only in several together"), (RED, "Partly in no photograph"))


class PhotosSettingsPanel(SettingsPanel):
    """Mixin of the panels that show settings of photo textures."""

    settings, property_name = describe(PhotosSettings), "farfield_photos"


class FARFIELD_PT_photos(PhotosSettingsPanel, ToolPanel, bpy.types.Panel):
    """The photographs, the settings, and the Merge button or the progress bar."""

    bl_idname = PANEL
    bl_label = "Photo Texture"
    bl_description = "For scanned meshes: one texture from photographs with known cameras"
    page = "photos"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the steps in the order of work. While a job runs they are disabled and the progress bar replaces the button."""
        layout = self.layout
        column = settings_column(layout)
        column.operator(FARFIELD_OT_photos_import_cameras.bl_idname, text="Import Cameras", icon="CAMERA_DATA")
        images = [find_background(item.data).image for item in find_cameras(context)]
        draw_photographs(column, len(images), sum(is_missing(image) for image in images))
        column.operator(FARFIELD_OT_photos_draw_overlays.bl_idname, text="Draw Overlays", icon="OVERLAY")
        is_shown = coverage_overlay.is_shown
        column.operator(FARFIELD_OT_photos_show_coverage.bl_idname, text="Show Coverage", icon="SHADING_SOLID", depress=is_shown)
        if is_shown:
            draw_legend(column, LEGEND)
        column.operator(FARFIELD_OT_photos_refine.bl_idname, text="Refine Cameras", icon="CON_CAMERASOLVER")
        self.draw_settings(context)
        settings_column(layout).prop(context.scene.farfield_photos, "maps")
        if not draw_progress_bar(layout, disabled_reason(context)):
            draw_button(layout, FARFIELD_OT_photos_merge, "Merge", "TEXTURE")


def draw_photographs(layout: bpy.types.UILayout, count: int, missing: int) -> None:
    """Draw how many photographs will be merged, and how many files of them are missing."""
    if count:
        text = format_count(count, "photograph")
        layout.label(text=f"{text}, {missing} missing" if missing else text, icon="ERROR" if missing else "IMAGE_DATA")


class FARFIELD_PT_photos_registration(ToolPanel, bpy.types.Panel):
    """The pairs of points, the lens, and the buttons."""

    bl_idname = "FARFIELD_PT_photos_registration"
    bl_label = "Register Photograph"
    bl_space_type = "IMAGE_EDITOR"
    bl_options = {"DEFAULT_CLOSED"}
    page, has_presets = "photos", False

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the steps in the order of work."""
        layout = self.layout
        reason = find_image_problem(context)
        if reason:
            draw_message(layout, reason, "INFO")
            return
        image = image_editors.shown_image(context)
        group = getattr(image, PROPERTY)
        column = settings_column(layout)
        running = find_running(context)
        column.operator(FARFIELD_OT_photos_add_pairs.bl_idname, text="Add Pairs", icon="CURSOR", depress=running is not None)
        obstacle = FARFIELD_OT_photos_add_pairs.disabled_reason(context)
        if obstacle:
            draw_message(column, obstacle, "INFO")
        elif running is not None and running.properties.image == image.name:
            draw_message(column, f"{describe_next_step(image)}. Enter: Finish, Esc: Cancel", "INFO")
        draw_pairs(layout, group)
        settings_column(layout).prop(group, "lens_camera")
        needed = MIN_PAIRS if group.lens_camera is None else MIN_PAIRS_WITH_LENS
        count = len(read_pairs(image)[0])
        if count < needed:
            draw_message(layout, f"{count} of {needed} pairs", "INFO")
        register_button = layout.row()
        register_button.enabled = count >= needed
        register_button.operator(FARFIELD_OT_photos_register.bl_idname, text="Register", icon="CON_CAMERASOLVER")
        refine_button = layout.operator(FARFIELD_OT_photos_refine.bl_idname, text="Refine", icon="CON_CAMERASOLVER")
        refine_button.image, refine_button.lens = image.name, group.lens_camera is None


def draw_pairs(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup) -> None:
    """Draw a row for each pair with its residual and a button that removes it."""
    if not len(group.pairs):
        return
    column = layout.column(align=True)
    for index, pair in enumerate(group.pairs):
        row = column.row(align=True)
        if not (pair.has_point and pair.has_position):
            text, icon = "click on the mesh" if pair.has_position else "click in the photograph", "BLANK1"
        elif group.is_registered:
            text = f"{np.linalg.norm(pair.residual):.2f} pixels"
            icon = "ERROR" if pair.is_wrong else "CHECKMARK"
        else:
            text, icon = "complete", "BLANK1"
        row.label(text=f"{index + 1}: {text}", icon=icon)
        row.operator(FARFIELD_OT_photos_remove_pair.bl_idname, text="", icon="X", emboss=False).index = index
    if group.is_registered:
        column.label(text=f"Arrows: errors x {ARROW_SCALE:g}")


CLASSES = (FARFIELD_PT_photos, *sub_panels(PhotosSettingsPanel, PANEL), FARFIELD_PT_photos_registration)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
