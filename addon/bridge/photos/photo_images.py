"""Photographs from the background images of cameras."""

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError, ImageError
from ...core.files.file_access import check_readable
from ...core.geometry.lenses import PhotoCamera
from ...core.imaging.colors import encode_signed_srgb
from ...core.photos.photographs.photograph import Photograph
from ..blender import import_blender_module
from ..imaging.color_spaces import convert_to_linear
from ..imaging.image_files import EXTENSIONS
from ..imaging.images import find_path, read_pixels
from ..restore.image_pixels import read_format, to_display
from ..restore.image_sources import check_image
from .photo_files import read_photograph_file

MIN_ALPHA = 0.5  # Pixels with less are not usable.
BYTE_COLOR_SPACE = "sRGB"  # which Blender gives to files with integers
FLOAT_COLOR_SPACES = {"Linear Rec.709", "Linear"}  # and to files with floats


@dataclass(frozen=True)
class PhotoSource:
    """A photograph that may not have been read yet. Holds no pointers into Blender, so that any thread can read it.

    source: the file, or the photograph. flip_x, flip_y: whether the camera shows its mirror image.
    """

    camera: PhotoCamera
    source: Path | Photograph
    flip_x: bool
    flip_y: bool

    def read(self) -> Photograph:
        """Return the photograph. Raises FileError if its file cannot be read, and ImageError if its size is not that of the camera."""
        photograph = self.source if isinstance(self.source, Photograph) else read_photograph_file(self.camera, self.source)
        step = np.s_[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]
        mask = None if photograph.mask is None else np.ascontiguousarray(photograph.mask[step])
        return replace(photograph, pixels=np.ascontiguousarray(photograph.pixels[step]), mask=mask)


def open_background(camera: PhotoCamera, background: bpy.types.CameraBackgroundImage) -> PhotoSource:
    """Return the photograph of a background image. Files that Blender shows as they are will be read later, all others are read now. Raises
    FileError if the file is missing or cannot be read, and ImageError if it is not a single image, or its size is not that of the
    camera."""
    image = background.image
    if image.source not in {"FILE", "GENERATED"}:
        raise ImageError(f'The background image "{image.name}" is not a single image; open each photograph as an image of its own.')
    if image.source == "FILE" and not image.packed_files and not image.has_data:
        check_readable(Path(find_path(image)))
    source = Path(find_path(image)) if _shows_file(image) else _read_image(camera, image)
    return PhotoSource(camera, source, background.use_flip_x, background.use_flip_y)


def is_missing(image: bpy.types.Image) -> bool:
    """Return whether the file of a background image does not exist."""
    needs_file = image.source == "FILE" and not image.packed_files and not image.has_data
    return needs_file and not os.path.isfile(find_path(image))  # noqa: PTH113 - Path.is_file raises for forbidden folders and long names


def _shows_file(image: bpy.types.Image) -> bool:
    """Return whether the pixels of `image` are those of its file, in the colors that its format has by default."""
    path = Path(find_path(image))
    if image.source != "FILE" or image.packed_files or image.is_dirty or image.alpha_mode == "NONE" or not _has_file_reader():
        return False
    spaces = FLOAT_COLOR_SPACES if path.suffix.lower() == ".exr" else {BYTE_COLOR_SPACE}
    return path.suffix.lower() in EXTENSIONS and image.colorspace_settings.name in spaces and not is_missing(image)


@cache
def _has_file_reader() -> bool:
    """Return whether files can be read without Blender's image data: builds of Linux distributions may lack the module."""
    try:
        import_blender_module("OpenImageIO", "Reading photographs", "use another Blender")
    except FileError:
        return False
    return True


def _read_image(camera: PhotoCamera, image: bpy.types.Image) -> Photograph:
    """Return the photograph that `image` shows. Its pixels are freed if they were not loaded before."""
    was_loaded = image.has_data
    check_image(image)
    stored, pixel_format = read_pixels(image), read_format(image)
    color_space = image.colorspace_settings.name
    if not was_loaded:
        image.buffers_free()
    colors, mask = to_display(stored, pixel_format)[..., :3], stored[..., 3] >= MIN_ALPHA
    if pixel_format.is_float or pixel_format.is_data or color_space == BYTE_COLOR_SPACE:
        pixels = colors if pixel_format.is_float else np.rint(255.0 * colors).astype(np.uint8)
    else:
        pixels = encode_signed_srgb(convert_to_linear(colors, color_space))
    photograph = Photograph(camera, np.ascontiguousarray(pixels), None if mask.all() else mask)
    photograph.check()
    return photograph
