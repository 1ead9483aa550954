"""The last scales at which vertices are features, as an attribute of meshes, and an overlay that colors vertices by them."""

from collections.abc import Callable, Hashable

import bpy
import numpy as np

from ...core.texmesh.scale_space.features import SCALES, ScaleMap
from ..geometry.mesh_arrays import read_loop_triangles, read_loop_vertices, read_positions, read_values
from ..overlays.face_overlay import FaceColors, FaceOverlay, offset_from_faces
from .sources import TexturedSource

SCALE_ATTRIBUTE = "farfield_scale"  # integer attribute of vertices: the last scale at which they are features
RAMP = np.array([[0.20, 0.22, 0.55], [0.13, 0.45, 0.60], [0.15, 0.65, 0.45], [0.60, 0.80, 0.20], [1.00, 0.88, 0.12]])  # sRGB
OPACITY = 0.9


def find_vertex_scales(source: TexturedSource, scale_map: ScaleMap) -> np.ndarray:
    """Return the last scale (V,) int32 of each vertex of the evaluated mesh; 0 where triangles without area were dropped."""
    scales = np.zeros(len(source.evaluated.vertices), np.int32)
    rows = source.mesh.sources
    vertices = source.evaluated.triangles[rows // 3, rows % 3]
    np.maximum.at(scales, vertices, scale_map.last_scales[source.mesh.triangles].astype(np.int32))
    return scales


def write_scale_map(item: bpy.types.Object, source: TexturedSource, scale_map: ScaleMap) -> bool:
    """Write the attribute SCALE_ATTRIBUTE. Return False, and write nothing, if the mesh of the object has other vertices than the evaluated
    one, or cannot be changed."""
    mesh = item.data
    if item.type != "MESH" or not mesh.is_editable or len(mesh.vertices) != len(source.evaluated.vertices):
        return False
    attribute = mesh.attributes.get(SCALE_ATTRIBUTE)
    if attribute is not None and (attribute.data_type != "INT" or attribute.domain != "POINT"):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        attribute = mesh.attributes.new(SCALE_ATTRIBUTE, "INT", "POINT")
    attribute.data.foreach_set("value", find_vertex_scales(source, scale_map))
    mesh.update()
    return True


def read_scales(mesh: bpy.types.Mesh) -> np.ndarray | None:
    """Return the scales (V,) int32 that were written, None if there are none."""
    attribute = mesh.attributes.get(SCALE_ATTRIBUTE)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type != "INT":
        return None
    scales = np.empty(len(mesh.vertices), np.int32)
    if len(attribute.data) != len(scales):
        return None  # in Edit Mode
    attribute.data.foreach_get("value", scales)
    return scales


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


def color_scales(scales: np.ndarray, lowest: int) -> np.ndarray:
    """Return colors with opacity (N, 4) float32, sRGB, of last `scales` (N,); those below `lowest` are transparent."""
    fractions = np.clip(np.asarray(scales, np.float64) / (SCALES - 1), 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(RAMP))
    colors = [np.interp(fractions, stops, RAMP[:, channel]) for channel in range(3)]
    return np.stack([*colors, np.where(np.asarray(scales) >= lowest, OPACITY, 0.0)], axis=1).astype(np.float32)
