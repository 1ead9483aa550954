"""UDIM images in Blender: tiles are written to files, opened as one tiled image, and packed."""

from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError
from ...core.files.filenames import safe_filename
from .images import save_image

EXTENSIONS = {False: "png", True: "exr"}  # lossless, by whether the pixels are floats
FILE_FORMATS = {False: "PNG", True: "OPEN_EXR"}


def load_image(path: Path) -> bpy.types.Image:
    """Return a new image that shows a file. Raises FileError."""
    try:
        return bpy.data.images.load(str(path))
    except RuntimeError as error:  # raised by Blender
        raise FileError(f'"{path}" cannot be loaded; check that the file is a complete image.') from error


def save_pixels(pixels: np.ndarray, path: Path, *, is_float: bool) -> None:
    """Write stored values (H, W, 4) to a PNG or, with `is_float`, an OpenEXR file, without loss. Raises FileError."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("frame", width, height, alpha=True, float_buffer=is_float, is_data=True)
    try:
        # Blender writes the values of data as they are; those of colors pass through the color space and back.
        image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
        image.update()
        image.file_format = FILE_FORMATS[is_float]
        save_image(image, path)
    finally:
        bpy.data.images.remove(image)


def open_tiles(name: str, paths: Mapping[int, Path], color_space: str, alpha_mode: str) -> bpy.types.Image:
    """Return a new tiled image of files by the numbers of their tiles, which are part of their names. `pack_tiles` loads them."""
    first = min(paths)
    image = load_image(paths[first])
    image.name = name
    image.colorspace_settings.name = color_space
    image.alpha_mode = alpha_mode
    image.source = "TILED"
    image.filepath_raw = str(paths[first].with_name(paths[first].name.replace(str(first), "<UDIM>")))
    image.tiles[0].number = first
    present = {tile.number for tile in image.tiles}
    for number in sorted(set(paths) - present):
        image.tiles.new(number)
    return image


def pack_tiles(image: bpy.types.Image, extension: str) -> None:
    """Load the files of a tiled image and pack them."""
    image.reload()
    image.pack()
    image.filepath_raw = f"//{safe_filename(image.name)}.<UDIM>.{extension}"  # where Unpack writes to
