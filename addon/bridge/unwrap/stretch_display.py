"""UV stretch as colors: an overlay of faces in 3D Viewports and UV Editors, and image files."""

from pathlib import Path

import bpy
import numpy as np

from ...core.errors import GeometryError
from ...core.files.file_access import check_writable
from ...core.unwrap.distortion import draw_stretch_image, stretch_colors
from ..geometry.mesh_arrays import read_loop_vertices, read_positions, read_values
from ..imaging.images import create_image, save_image
from ..overlays.face_overlay import FaceColors, FaceOverlay, offset_from_faces
from .uv_maps import read_uv_stretch


class StretchOverlay(FaceOverlay):
    """The colors of all meshes that have been unwrapped, read from them whenever they change."""

    def find_key(self, item: bpy.types.Object) -> str | None:
        """Return the name of an object's mesh."""
        return item.data.name_full if item.type == "MESH" else None

    def read_colors(self, item: bpy.types.Object) -> FaceColors | None:
        """Return the colors of an object's mesh; None if it has not been unwrapped."""
        mesh = item.data
        uv_stretch = read_uv_stretch(mesh)
        if uv_stretch is None:
            return None
        positions = offset_from_faces(read_positions(mesh), read_values(mesh.vertex_normals, "vector", 3))
        corners = positions[read_loop_vertices(mesh)[uv_stretch.loops]]
        return FaceColors(corners, stretch_colors(uv_stretch.stretches), uv_stretch.uvs[uv_stretch.loops])


overlay = StretchOverlay()


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
