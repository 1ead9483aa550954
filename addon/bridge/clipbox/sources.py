"""Readers of terrain files that need Blender: images and OpenVDB volumes. Paths that a user has typed."""

from pathlib import Path

import bpy
import numpy as np

from ...core.clipbox.files import readers
from ...core.clipbox.files.file_data import HeightMap
from ...core.clipbox.files.readers import BLEND_PREFIX, Readers
from ...core.errors import FileError
from ...core.files.height_maps import check_size
from .openvdb_files import read_vdb

IMAGE_EXTENSIONS = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".webp", ".bmp")
VOLUME_EXTENSION = ".vdb"


def read_image(path: Path) -> HeightMap:
    """Read the mean of the first three channels as stored, without color management. Call it on Blender's main thread.

    Raises:
        FileError: Blender cannot read it.
    """
    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise FileError(f'"{path}" cannot be read: {str(error).strip().rstrip(".")}.') from error
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"  # other modes lose colors under zero alpha
        (width, height), channels = image.size, image.channels
        if width * height * channels == 0:
            raise FileError(f'"{path}" cannot be read as an image; Blender finds no pixels in it.')
        check_size(path, width * height * channels, 4)
        pixels = np.empty(width * height * channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    pixels = pixels.reshape(height, width, channels)
    return HeightMap(pixels[..., 0].copy() if channels < 3 else pixels[..., :3].mean(axis=2))


def absolute_path(path: str, library: bpy.types.Library | None = None) -> str:
    """Return a path that a user has typed as an absolute path. One relative to a .blend file ("//") that was never saved stays as it is.

    library: the file that the path is linked from, None for this file.
    """
    if path.startswith(BLEND_PREFIX):
        if library is None and not bpy.data.filepath:
            return path
        path = bpy.path.abspath(path, library=library)
    return str(Path(path).absolute())


READERS: Readers = {**readers.READERS, **dict.fromkeys(IMAGE_EXTENSIONS, read_image), VOLUME_EXTENSION: read_vdb}
