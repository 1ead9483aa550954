"""Pictures of UV maps, coloured by stretch, as files."""

from pathlib import Path

import bpy
import numpy as np

from ..core.errors import FileError, GeometryError
from ..core.unwrap.stretch_colors import stretch_picture
from .images import data_image
from .uv_maps import stretched_map


def save(item: bpy.types.Object, path: Path, side: int) -> None:
    """Write a PNG of `side` pixels of the active UV map of an object's mesh.

    Raises:
        GeometryError: when the mesh has not been unwrapped, or is being edited. FileError: when the file cannot be written.
    """
    found = stretched_map(item.data)
    if found is None:
        raise GeometryError(f'"{item.name}" has not been unwrapped, or is in Edit Mode; unwrap it, and go to Object Mode.')
    drawn = stretch_picture(found.uvs[found.loops], found.stretches, side)
    image = data_image("stretch", np.dstack([drawn, np.ones((side, side), np.float32)]), is_data=False)
    try:
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
    except RuntimeError:  # what Blender raises
        raise FileError(f'Cannot write "{path}"; choose another folder.') from None
    finally:
        bpy.data.images.remove(image)
