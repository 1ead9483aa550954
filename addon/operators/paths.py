"""Paths that users enter."""

from pathlib import Path

import bpy

from ..core.errors import FileError

BLEND_PREFIX = "//"  # of paths relative to the .blend file


def absolute_path(path: str) -> Path:
    """Return an absolute path. Raises FileError if it is relative to a .blend file that was never saved."""
    if path.startswith(BLEND_PREFIX):
        if not bpy.data.filepath:
            raise FileError(f'The path "{path}" is relative to a file that was never saved; save the file or choose the path again.')
        path = bpy.path.abspath(path)
    return Path(path).absolute()
