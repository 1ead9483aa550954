"""Operators of the tool `restore`: restore images, create masks for them, show their outline, and compare results with originals."""

from typing import Any

import bpy
import numpy as np

from ...bridge.blender import redraw_areas
from ...bridge.restore import image_users
from ...bridge.restore.image_users import WHITE, create_mask, set_brush_color
from ...bridge.restore.outline import outline
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors, long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from .guides import find_shown_masks
from .job import RestoreJob
from .prepare import edited_image, find_target, prepare, require_image

NO_IMAGE = "Open an image in the Image Editor"


def _image_property(action: str) -> Any:
    """Return a property for the name of an image, for scripts."""
    description = f"Name of the image to {action}; by default the one in the Image Editor"
    return bpy.props.StringProperty(name="Image", description=description, options={"SKIP_SAVE"})


class FARFIELD_PG_restore(bpy.types.PropertyGroup):
    """Settings of the panel *Restore Image*, stored per scene."""

    __annotations__ = properties.build_annotations(MaskSettings, set()) | properties.build_annotations(RestoreSettings, set())


class FARFIELD_OT_restore_image(start_job.StartJob, bpy.types.Operator):
    """Fill the missing parts of the image with structure and texture from the rest of it. The result is a new image"""

    bl_idname = "farfield.restore_image"
    bl_label = "Restore Missing Parts of Image"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (MaskSettings, RestoreSettings), "farfield_restore"
    __annotations__ = start_job.setting_properties(*settings_types) | {"image": _image_property("restore")}

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be restored now, or an empty string. Where there is no Image Editor, scripts give the name of an image."""
        return long_work.running_job_message() or _missing_image_message(context)

    def prepare(self, context: bpy.types.Context) -> RestoreJob:
        """Read the image and its masks."""
        settings = self.read_settings(context)
        return prepare(context, self.image, settings[MaskSettings], settings[RestoreSettings])


class FARFIELD_OT_restore_mask(bpy.types.Operator):
    """Create a black image with the size of the image, use it as mask, and open it for painting. Paint white where pixels are missing"""

    bl_idname = "farfield.restore_mask"
    bl_label = "Create Mask for Restoration"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {"image": _image_property("mask")}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there is an image."""
        return long_work.poll_with_reason(cls, _missing_image_message(context))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Create the mask, and show it in Paint mode."""
        source = require_image(context, self.image)
        mask = create_mask(source)
        group = context.scene.farfield_restore
        group.mask, group.mask_image = "image", mask.name
        set_brush_color(context.tool_settings, WHITE)
        image_editors.show_image(image_editors.remember_editor(context), mask, "PAINT")
        report_message(self, f'Created "{mask.name}"; paint white where pixels are missing.')
        return {"FINISHED"}


class FARFIELD_OT_restore_outline(bpy.types.Operator):
    """Draw the outline of the missing pixels over the image, and the image over a mask that is being painted"""

    bl_idname = "farfield.restore_outline"
    bl_label = "Show Outline of Missing Pixels"
    bl_options = {"REGISTER"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show or hide the outline."""
        outline.is_hidden = not outline.is_hidden
        redraw_areas("IMAGE_EDITOR")
        return {"FINISHED"}


class FARFIELD_OT_restore_compare(bpy.types.Operator):
    """Switch the Image Editor between the image before and after restoration"""

    bl_idname = "farfield.restore_compare"
    bl_label = "Compare Image Before and After Restoration"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the image was restored or is the result of a restoration."""
        reason = "" if image_editors.is_image_editor(context) else "Only available in an Image Editor"
        return long_work.poll_with_reason(cls, reason or ("" if counterpart(context) else "Restore the image first"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show the other one of original and result."""
        image_editors.show_image(image_editors.remember_editor(context), counterpart(context))
        return {"FINISHED"}


def counterpart(context: bpy.types.Context) -> bpy.types.Image | None:
    """Return the original of the image in the editor, or the newest image that was restored from it; None if there is neither."""
    shown = edited_image(context)
    if shown is None:
        return None
    return image_users.find_restored(shown) or image_users.read_image_property(shown, image_users.ORIGINAL_PROPERTY)


def _missing_image_message(context: bpy.types.Context) -> str:
    return NO_IMAGE if image_editors.is_image_editor(context) and image_editors.shown_image(context) is None else ""


def _find_masks(image: bpy.types.Image, scene: bpy.types.Scene) -> dict[int, np.ndarray]:
    settings = properties.read(MaskSettings, scene.farfield_restore)
    return find_shown_masks(image, settings) if find_target(image, settings) == image else {}


CLASSES = (
    FARFIELD_PG_restore,
    FARFIELD_OT_restore_image,
    FARFIELD_OT_restore_mask,
    FARFIELD_OT_restore_outline,
    FARFIELD_OT_restore_compare,
)
register_settings, unregister_settings = properties.scene_settings_factory("farfield_restore", FARFIELD_PG_restore, CLASSES)


def register() -> None:
    """Register the classes, add the settings to scenes, and draw the outline."""
    register_settings()
    outline.start(_find_masks)


def unregister() -> None:
    """Stop drawing the outline, remove the settings from scenes and unregister the classes."""
    outline.stop()
    unregister_settings()
