"""Images of UV maps colored by stretch, as files."""

from pathlib import Path

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.files.file_access import check_writable
from ...core.unwrap.stretch_colors import draw_stretch_image
from ..imaging.images import create_image, save_image
from .uv_maps import read_uv_stretch


def save_stretch_image(item: bpy.types.Object, path: Path, resolution: int) -> None:
    """Write a PNG of the active UV map of an object's mesh, with `resolution` pixels per side.

    Raises:
        GeometryError: the mesh has not been unwrapped, or is in Edit Mode.
        FileError: the file cannot be written.
    """
    uv_stretch = read_uv_stretch(item.data)
    if uv_stretch is None:
        raise GeometryError(f'"{item.name}" has not been unwrapped or is in Edit Mode; unwrap it and switch to Object Mode.')
    check_writable(path)
    pixels = draw_stretch_image(uv_stretch.uvs[uv_stretch.loops], uv_stretch.stretches, resolution)
    image = create_image("stretch", np.dstack([pixels, np.ones((resolution, resolution), np.float32)]), is_data=False)
    try:
        image.file_format = "PNG"
        save_image(image, path)
    finally:
        bpy.data.images.remove(image)
