"""Readers of terrain files that need Blender: images and OpenVDB volumes. Paths that a user has typed."""

from pathlib import Path

import bpy

from ...core.clipbox.files import readers
from ...core.clipbox.files.file_data import HeightMap
from ...core.clipbox.files.readers import BLEND_PREFIX, Readers
from ..imaging.height_images import read_gray_image
from .openvdb_files import read_vdb

IMAGE_EXTENSIONS = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".webp", ".bmp")
VOLUME_EXTENSION = ".vdb"


def read_image(path: Path) -> HeightMap:
    """Read an image as heights; see `read_gray_image`. Call it on Blender's main thread. Raises FileError."""
    return HeightMap(read_gray_image(path))


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
