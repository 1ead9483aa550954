"""Overlay that colors faces by UV stretch in 3D Viewports and UV Editors."""

import bpy

from ...core.unwrap.stretch_colors import stretch_colors
from ..geometry.mesh_arrays import read_loop_vertices, read_positions, read_values
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
