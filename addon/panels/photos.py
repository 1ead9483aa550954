"""Panel *Photo Texture* in the sidebar tab *Farfield*."""

import bpy

from ..bridge.photos.photo_images import is_missing
from ..bridge.photos.scene_cameras import find_background
from ..core.photos.settings import PhotosSettings
from ..core.settings import describe
from ..core.text import format_count
from ..operators.photos.import_cameras import FARFIELD_OT_photos_import_cameras
from ..operators.photos.operators import FARFIELD_OT_photos_merge
from ..operators.photos.overlays import FARFIELD_OT_photos_draw_overlays
from ..operators.photos.sources import disabled_reason, find_cameras
from .sidebar import ToolPanel, draw_button, draw_message, draw_progress_bar, draw_setting, settings_column

SETTINGS = describe(PhotosSettings)
ONLY_FOR_BEST = {"leveling"}  # settings without effect in other methods


class FARFIELD_PT_photos(ToolPanel, bpy.types.Panel):
    """The photographs, the settings, and the Merge button or the progress bar."""

    bl_idname = "FARFIELD_PT_photos"
    bl_label = "Photo Texture"
    page = "photos"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the steps in the order of work. While a job runs they are disabled and the progress bar replaces the button."""
        layout, group = self.layout, context.scene.farfield_photos
        column = settings_column(layout)
        column.operator(FARFIELD_OT_photos_import_cameras.bl_idname, text="Import Cameras", icon="CAMERA_DATA")
        images = [find_background(item.data).image for item in find_cameras(context)]
        draw_photographs(column, len(images), sum(is_missing(image) for image in images))
        column.operator(FARFIELD_OT_photos_draw_overlays.bl_idname, text="Draw Overlays", icon="OVERLAY")
        for setting in SETTINGS:
            item = column.column()
            item.active = setting.name not in ONLY_FOR_BEST or group.method == "best"
            draw_setting(item, group, setting)
        column.prop(group, "maps")
        if draw_progress_bar(layout):
            return
        reason = disabled_reason(context)
        if reason:
            draw_message(layout, reason, "INFO")
        draw_button(layout, FARFIELD_OT_photos_merge, "Merge", "TEXTURE")


def draw_photographs(layout: bpy.types.UILayout, count: int, missing: int) -> None:
    """Draw how many photographs will be merged, and how many files of them are missing."""
    if count:
        text = format_count(count, "photograph")
        layout.label(text=f"{text}, {missing} missing" if missing else text, icon="ERROR" if missing else "IMAGE_DATA")


CLASSES = (FARFIELD_PT_photos,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
