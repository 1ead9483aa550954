"""What a restoration reads from Blender before it starts."""

from pathlib import Path

import bpy

from ...bridge.restore import image_users
from ...bridge.restore.image_pixels import read_format
from ...bridge.restore.image_sources import check_image, find_image, list_frames, read_tiles
from ...core.errors import ImageError, SettingsError
from ...core.files.file_access import check_unicode
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors
from .guides import GuideReader
from .job import ImageJob, RestoreJob, SequenceJob


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
    pixels can be read.

    Raises:
        ImageError: there is no image, or it cannot be used.
        FileError: its file cannot be read.
    """
    image = find_image(name, "Image") if name else edited_image(context)
    if image is None:
        raise ImageError("There is no image to restore; open one in an Image Editor, or give its name.")
    if masks is not None and not name:
        image = find_target(image, masks)
    check_image(image)
    return image


def prepare(context: bpy.types.Context, name: str, masks: MaskSettings, settings: RestoreSettings) -> RestoreJob:
    """Read the image and its masks. Of a sequence, only the list of its frames is read.

    Raises:
        ImageError: the image or a mask cannot be used.
        FileError: a file cannot be read.
        SettingsError: the image is a sequence and there is no output folder.
    """
    image = require_image(context, name, masks)
    guides = GuideReader(masks, image)
    is_normal_map = masks.normal_map or image_users.is_normal_map(image)
    common = (image.name, image.session_uid, settings, masks, is_normal_map, image_editors.remember_editor(context))
    if image.source == "SEQUENCE":
        return SequenceJob(*common, frames=list_frames(image), guides=guides, folder=_output_folder(image, masks))
    tiles = read_tiles(image)
    found = {number: guides.read(number, stored.shape, f"Tile {number}" if number else "") for number, stored in tiles.items()}
    return ImageJob(*common, tiles=tiles, guides={number: item for number, item in found.items() if item}, pixel_format=read_format(image))


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
