"""Overlay that colors the vertices of meshes by the last scale at which they are features."""

from collections.abc import Callable, Hashable

import bpy

from ...core.texmesh.scale_colors import color_scales
from ..geometry.mesh_arrays import read_loop_triangles, read_loop_vertices, read_positions, read_values
from ..overlays.face_overlay import FaceColors, FaceOverlay, offset_from_faces
from .scale_attributes import SCALE_ATTRIBUTE, read_scales


class ScaleOverlay(FaceOverlay):
    """The colors of all meshes that have been analyzed, read from them whenever they change.

    read_lowest: returns the scale at which the smallest colored features end.
    """

    def __init__(self, read_lowest: Callable[[], int]) -> None:
        super().__init__()
        self._read_lowest = read_lowest

    def find_key(self, item: bpy.types.Object) -> Hashable:
        """Return the name of an object's mesh, and the lowest scale; None if the mesh has not been analyzed."""
        if item.type != "MESH" or SCALE_ATTRIBUTE not in item.data.attributes:
            return None
        return item.data.name_full, self._read_lowest()

    def read_colors(self, item: bpy.types.Object) -> FaceColors | None:
        """Return the colors of an object's mesh; None if it has no scales, for instance in Edit Mode."""
        mesh = item.data
        scales = read_scales(mesh)
        if scales is None or not len(scales):
            return None
        positions = offset_from_faces(read_positions(mesh), read_values(mesh.vertex_normals, "vector", 3))
        loops, _ = read_loop_triangles(mesh)
        triangles = read_loop_vertices(mesh)[loops]
        return FaceColors(positions[triangles], color_scales(scales, self._read_lowest())[triangles])
