"""Pictures of UV maps, coloured by stretch, as files."""

from pathlib import Path

import bpy
import numpy as np

from ..core.errors import FileError, GeometryError
from ..core.unwrap.stretch_colors import stretch_picture
from .images import data_image
from .uv_maps import STRETCH, drawn_triangles


def save(item: bpy.types.Object, path: Path, side: int) -> None:
    """Write a PNG of `side` pixels of the active UV map of an object's mesh.

    Raises:
        GeometryError: when the mesh has not been unwrapped. FileError: when the file cannot be written.
    """
    mesh = item.data
    if STRETCH not in mesh.attributes or mesh.uv_layers.active is None:
        raise GeometryError(f'"{item.name}" has not been unwrapped; unwrap it first.')
    loops, polygons = drawn_triangles(mesh)
    uvs, stretches = np.empty(2 * len(mesh.loops), np.float32), np.empty(len(mesh.polygons), np.float32)
    mesh.uv_layers.active.uv.foreach_get("vector", uvs)
    mesh.attributes[STRETCH].data.foreach_get("value", stretches)
    drawn = stretch_picture(uvs.reshape(-1, 2)[loops], stretches[polygons], side)
    image = data_image("stretch", np.dstack([drawn, np.ones((side, side), np.float32)]), is_data=False)
    try:
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
    except RuntimeError:  # what Blender raises
        raise FileError(f'Cannot write "{path}"; choose another folder.') from None
    finally:
        bpy.data.images.remove(image)
