"""The scale map as an attribute of a mesh."""

import bpy
import numpy as np

from ...core.texmesh.scale_space.features import ScaleMap
from .sources import TexturedSource

SCALE_ATTRIBUTE = "farfield_scale"  # integer attribute of vertices: the last scale at which they are features


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
