"""Readers of terrain files that need Blender: images and OpenVDB volumes. Paths that a user has typed."""

from dataclasses import replace
from pathlib import Path

import bpy

from ...core.clipbox.engine import TerrainEngine
from ...core.clipbox.files import readers
from ...core.clipbox.files.file_data import HeightMap
from ...core.clipbox.files.readers import BLEND_PREFIX, Readers
from ...core.clipbox.settings import ClipboxSettings
from ...core.clipbox.terrains.edits import NO_EDITS, Edits
from ...core.heights.readers import IMAGE_EXTENSIONS
from ..imaging.images import read_gray_image
from .openvdb_files import read_vdb

VOLUME_EXTENSION = ".vdb"


def read_image(path: Path) -> HeightMap:
    """Read an image as heights; see `read_gray_image`. Call it on Blender's main thread. Raises FileError."""
    return readers.read_heights(path, read_gray_image)


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


def create_engine(
    settings: ClipboxSettings, closed: bool = False, library: bpy.types.Library | None = None, edits: Edits = NO_EDITS
) -> TerrainEngine:
    """Create an engine for a new terrain; `closed` adds walls at the boundary of the outermost box.

    library: the file that the settings are linked from, None for this file.

    Raises:
        SettingsError, FileError: the formula or the source file cannot be read.
    """
    return TerrainEngine(resolve_paths(settings, library), READERS, closed, edits)


def resolve_paths(settings: ClipboxSettings, library: bpy.types.Library | None = None) -> ClipboxSettings:
    """Return settings whose source path does not depend on the .blend file ("//") or on the current folder."""
    return replace(settings, source=absolute_path(settings.source, library)) if settings.source else settings
