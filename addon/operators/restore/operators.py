"""Operators of the tool `restore`: restore images, create masks for them, show their outline, and compare results with originals; and what
they read from Blender before they start."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge.blender import redraw_areas
from ...bridge.restore import image_users
from ...bridge.restore.image_pixels import read_format
from ...bridge.restore.image_sources import check_image, find_image, find_obstacle, list_frames, read_tiles
from ...bridge.restore.image_users import WHITE, create_mask, set_brush_color, set_brush_size
from ...bridge.restore.outline import outline
from ...core.errors import ImageError, SettingsError
from ...core.files.file_access import check_unicode
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors, long_work, properties, start_job
from ..error_reports import report_message, reports_errors
from .guides import GuideReader, find_shown_masks
from .job import ImageJob, Map, RestoreJob, SequenceJob

NO_IMAGE = "Open an image in the Image Editor"
BRUSH_FRACTION, MIN_BRUSH_SIZE = 0.04, 8  # the diameter of the brush for masks: of the longer side of the image, and pixels on screen
NO_MAPS = "turn off All Maps of Material, which restores single images and tiles only"


def _image_property(action: str) -> Any:
    """Return a property for the name of an image, for scripts."""
    description = f"Name of the image to {action}; by default the one in the Image Editor"
    return bpy.props.StringProperty(name="Image", description=description, options={"SKIP_SAVE"})


class FARFIELD_PG_restore(bpy.types.PropertyGroup):
    """Settings of the panel *Restore Image*, stored per scene."""

    settings_types = (MaskSettings, RestoreSettings)
    __annotations__ = properties.build_annotations(MaskSettings, set()) | properties.build_annotations(RestoreSettings, set())


class FARFIELD_OT_restore_image(start_job.StartJob, bpy.types.Operator):
    """Fill the missing parts of the image with structure and texture from the rest of it. The result is a new image. It replaces the result
    before, unless that was saved, renamed, painted or used since"""

    bl_idname = "farfield.restore_image"
    bl_label = "Restore Missing Parts of Image"
    bl_options = {"REGISTER", "UNDO"}
    settings_types, panel_property = (MaskSettings, RestoreSettings), "farfield_restore"
    __annotations__ = start_job.setting_properties(*settings_types) | {
        "image": _image_property("restore"),
        "keep_result": bpy.props.BoolProperty(
            name="Keep Result", description="Keep the result before, and this one when the image is restored again", options={"SKIP_SAVE"}
        ),
    }

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be restored now, or an empty string. Where there is no Image Editor, scripts give the name of an image."""
        return long_work.running_job_message() or _missing_image_message(context)

    def prepare(self, context: bpy.types.Context) -> RestoreJob:
        """Read the image and its masks."""
        settings = self.read_settings(context)
        return prepare(context, self.image, settings[MaskSettings], settings[RestoreSettings], replaces_results=not self.keep_result)


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
        side = max(source.size) * image_editors.find_zoom(context.area, source) if image_editors.is_image_editor(context) else 0.0
        if side:  # Without a window, images have no size on screen.
            set_brush_size(context.tool_settings, max(round(BRUSH_FRACTION * side), MIN_BRUSH_SIZE))
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


class FARFIELD_OT_restore_variant(bpy.types.Operator):
    """Show the previous or the next result of the image. After the last one, restore the image again with the next seed"""

    bl_idname = "farfield.restore_variant"
    bl_label = "Show Another Result of Restoration"
    bl_options = {"REGISTER"}
    __annotations__ = {
        "direction": bpy.props.EnumProperty(
            name="Direction",
            description="Which result to show",
            items=(("previous", "Previous", "The result before"), ("next", "Next", "The result after, or a new one with the next seed")),
            default="next",
        )
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether an Image Editor shows a result and no job runs."""
        reason = long_work.running_job_message() or ("" if list_variants(context)[0] else "Show a result of Restore first")
        return long_work.poll_with_reason(cls, reason)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Show another result."""
        variants, index = list_variants(context)
        index += 1 if self.direction == "next" else -1
        if index < len(variants):
            image_editors.show_image(image_editors.remember_editor(context), variants[max(index, 0)])
            return {"FINISHED"}
        context.scene.farfield_restore.seed += 1
        original = image_users.read_image_property(variants[-1], image_users.ORIGINAL_PROPERTY)
        return bpy.ops.farfield.restore_image(
            "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT", image=original.name, keep_result=True
        )


def list_variants(context: bpy.types.Context) -> tuple[list[bpy.types.Image], int]:
    """Return the results of the original of the image in the editor, and which of them is shown; none if it is not a result."""
    shown = image_editors.shown_image(context) if image_editors.is_image_editor(context) else None
    original = image_users.read_image_property(shown, image_users.ORIGINAL_PROPERTY)
    if original is None:
        return [], 0
    variants = image_users.list_restored(original)
    return variants, variants.index(shown)


def edited_image(context: bpy.types.Context) -> bpy.types.Image | None:
    """Return the image in the Image Editor, or the one that a shown mask belongs to; None if the editor is empty or there is none."""
    shown = image_editors.shown_image(context)
    return image_users.read_image_property(shown, image_users.MASKED_PROPERTY) or shown


def find_target(image: bpy.types.Image, masks: bpy.types.PropertyGroup | MaskSettings) -> bpy.types.Image:
    """Return the image that is restored while an editor shows `image`: for a result, its original, so that it can be restored again with
    other settings, unless a mask was made for the result or has nothing to do with the original."""
    original = image_users.read_image_property(image, image_users.ORIGINAL_PROPERTY)
    if original is None:
        return image
    mask = bpy.data.images.get(masks.mask_image)
    belongs_to_original = image_users.read_image_property(mask, image_users.MASKED_PROPERTY) == original
    return original if masks.mask != "image" or belongs_to_original else image


def require_image(context: bpy.types.Context, name: str, masks: MaskSettings | None = None) -> bpy.types.Image:
    """Return the image with the given name, otherwise the one in the Image Editor, or with `masks` what is restored while it is shown. Its
    pixels can be read. Raises ImageError if there is no image, or it cannot be used, and FileError if its file cannot be read."""
    image = find_image(name, "Image") if name else edited_image(context)
    if image is None:
        raise ImageError("There is no image to restore; open one in an Image Editor, or give its name.")
    if masks is not None and not name:
        image = find_target(image, masks)
    check_image(image)
    return image


def prepare(context: bpy.types.Context, name: str, masks: MaskSettings, settings: RestoreSettings, *, replaces_results: bool) -> RestoreJob:
    """Read the image and its masks. Of a sequence, only the list of its frames is read. replaces_results: see `RestoreJob`.

    Raises:
        ImageError: the image or a mask cannot be used.
        FileError: a file cannot be read.
        SettingsError: the image is a sequence, and there is no output folder or all maps of the material are to be restored.
    """
    image = require_image(context, name, masks)
    if image.source == "SEQUENCE" and masks.all_maps_of_material:
        raise SettingsError(f'"{image.name}" is an image sequence; {NO_MAPS}.', ("all_maps_of_material",))
    guides = GuideReader(masks, image)
    others = {other: find_obstacle(image, other) for other in image_users.list_maps(image)} if masks.all_maps_of_material else {}
    images = [image, *(other for other, obstacle in others.items() if not obstacle)]
    maps = [Map(each.name, each.session_uid, image_users.is_normal_map(each) or (masks.normal_map and each == image)) for each in images]
    common = (maps, settings, masks, image_editors.remember_editor(context), replaces_results and image.source != "SEQUENCE")
    if image.source == "SEQUENCE":
        return SequenceJob(*common, frames=list_frames(image), guides=guides, folder=_output_folder(image, masks))
    tiles = [read_tiles(each) for each in images]
    found = {number: guides.read(number, stored.shape, f"Tile {number}" if number else "") for number, stored in tiles[0].items()}
    return ImageJob(
        *common,
        tiles=tiles,
        formats=[read_format(each) for each in images],
        guides={number: item for number, item in found.items() if item},
        left_out={other.name: obstacle for other, obstacle in others.items() if obstacle},
    )


def _output_folder(image: bpy.types.Image, masks: MaskSettings) -> Path:
    if not masks.output_folder:
        raise SettingsError(f'"{image.name}" is an image sequence; choose an Output Folder for its restored frames.', ("output_folder",))
    folder = Path(bpy.path.abspath(masks.output_folder))
    if not folder.is_absolute():
        raise SettingsError("Output Folder is relative to the .blend file, which has not been saved; save it or choose another folder.")
    check_unicode(folder)
    return folder


def find_problem(image: bpy.types.Image, group: bpy.types.PropertyGroup) -> str:
    """Return why `image` cannot be restored with the panel's settings in `group`, or an empty string. Reads no pixels and no files."""
    if image.source in {"MOVIE", "VIEWER"} or image.type == "MULTILAYER":
        return "Only single images, tiled images and image sequences can be restored"
    if image.source == "SEQUENCE" and group.all_maps_of_material:
        return f"For an image sequence, {NO_MAPS}"
    if image.source == "SEQUENCE" and not group.output_folder:
        return "Choose an output folder for the frames"
    if group.mask != "image":
        return ""
    if not group.mask_image:
        return "Choose or create a mask image"
    mask = bpy.data.images.get(group.mask_image)
    if mask is None:
        return f'There is no image "{group.mask_image}"; choose or create a mask image'
    if "SEQUENCE" not in {image.source, mask.source} and tuple(mask.size) != tuple(image.size):
        return f"The mask has {mask.size[0]} x {mask.size[1]} pixels, but the image has {image.size[0]} x {image.size[1]}"
    return ""


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
    FARFIELD_OT_restore_variant,
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
