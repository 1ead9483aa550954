"""Blender meshes from levels of textured meshes, with everything that their source carries."""

import bpy
import numpy as np

from ...core.geometry.mesh import scaled_normals
from ...core.geometry.transforms import normalize
from ...core.texmesh.corner_normals import repair_normals
from ...core.texmesh.scale_space.features import ScaleMap
from ...core.texmesh.surface_points import find_vertex_weights
from ...core.texmesh.textured_mesh import TexturedMesh
from ..geometry.evaluated_mesh import EvaluatedMesh, MeshAttribute
from ..geometry.mesh_arrays import write_attribute, write_corner_normals, write_triangles
from .rigs import write_rig
from .scale_attributes import SCALE_ATTRIBUTE, find_vertex_scales
from .sources import NORMALS, TexturedSource


def create_level_mesh(
    name: str, item: bpy.types.Object, source: TexturedSource, level: TexturedMesh, scale_map: ScaleMap, is_subset: bool
) -> bpy.types.Mesh:
    """Create a mesh in the object space of `source`, which was read from `item`, without materials.

    Texture coordinates, normals and corner colors are those of the level. SCALE_ATTRIBUTE is that of `scale_map`, the analysis of the
    source. All other attributes are those of the source that `level.sources` refers to: those of faces at the first corner. Vertex groups
    and shape keys are interpolated.

    is_subset: whether normals are those of vertices of the source, which are repaired where they do not fit the faces.
    """
    mesh = bpy.data.meshes.new(name)
    write_triangles(mesh, level.vertices + source.origin if source.origin.any() else level.vertices, level.triangles)
    if not len(level.triangles):
        return mesh
    evaluated = source.evaluated
    faces, corners = level.sources // 3, level.sources % 3
    if source.uv_map:
        write_attribute(mesh, source.uv_map, "CORNER", level.corner_uvs)
    start = 0
    for attribute, width in source.attributes:
        columns = slice(start, start + width)
        start += width
        if attribute == NORMALS:
            normals = repair_normals(source.mesh, level) if is_subset else level.attributes[level.wedge_triangles, columns]
            _write_normals(mesh, level, normals, source.rig is not None)
        elif attribute not in mesh.attributes:
            write_attribute(mesh, attribute, "CORNER", level.attributes[:, columns][level.wedge_triangles])
    if not any(attribute == NORMALS for attribute, _ in source.attributes):
        _write_flat(mesh, np.ones(len(level.triangles), bool))
    vertex_corners = np.zeros(len(level.vertices), np.int64)
    vertex_corners[level.triangles] = level.sources
    scales = find_vertex_scales(source, scale_map)[evaluated.triangles[vertex_corners // 3, vertex_corners % 3]]
    mesh.attributes.new(SCALE_ATTRIBUTE, "INT", "POINT").data.foreach_set("value", scales)
    for attribute_name, attribute in evaluated.attributes.items():
        if attribute_name not in mesh.attributes:
            write_attribute(mesh, attribute_name, attribute.domain, _carry(evaluated, attribute, faces, corners, vertex_corners))
    mesh.attributes.new("material_index", "INT", "FACE").data.foreach_set("value", level.materials.astype(np.int32))
    _activate(mesh, source)
    if source.rig is not None:
        weights = find_vertex_weights(source.mesh, level, evaluated.triangles, len(evaluated.vertices))
        write_rig(mesh, source.rig, weights, item.data.shape_keys)
    return mesh


def _carry(mesh: EvaluatedMesh, attribute: MeshAttribute, faces: np.ndarray, corners: np.ndarray, vertex_corners: np.ndarray) -> np.ndarray:
    """Return the values of an attribute of the source for a level, in its own domain."""
    if attribute.domain == "CORNER":
        values = attribute.values[mesh.loops[faces, corners]]
    elif attribute.domain == "POINT":
        values = attribute.values[mesh.triangles[vertex_corners // 3, vertex_corners % 3]]
    else:
        values = attribute.values[mesh.polygons[faces[:, 0]]]
    return values[..., 0] if values.shape[-1] == 1 else values


def _write_normals(mesh: bpy.types.Mesh, level: TexturedMesh, normals: np.ndarray, is_deformed: bool) -> None:
    """Write the normals (T, 3, 3) of smooth faces; corners of flat faces have normals without length, and get that of the face.

    is_deformed: whether they turn with the faces when the mesh is deformed, for which Blender stores them in 16 bits.
    """
    is_flat = np.linalg.norm(normals, axis=2).min(axis=1) < 0.5
    if is_flat.any():
        _write_flat(mesh, is_flat)
    if not is_flat.all():
        faces = scaled_normals(level.vertices[level.triangles])
        directions = normalize(np.where(is_flat[:, None, None], faces[:, None], normals))
        write_corner_normals(mesh, directions)
        if is_deformed:
            mesh.attributes.remove(mesh.attributes["custom_normal"])
            mesh.normals_split_custom_set(directions.reshape(-1, 3).tolist())


def _write_flat(mesh: bpy.types.Mesh, is_flat: np.ndarray) -> None:
    mesh.attributes.new("sharp_face", "BOOLEAN", "FACE").data.foreach_set("value", is_flat)


def _activate(mesh: bpy.types.Mesh, source: TexturedSource) -> None:
    """Let the same UV map and color attribute render as in the source."""
    layer = mesh.uv_layers.get(source.uv_map)
    if layer is not None:
        mesh.uv_layers.active = layer
        layer.active_render = True
    if source.evaluated.color in mesh.attributes:
        mesh.attributes.default_color_name = source.evaluated.color
        mesh.attributes.active_color_name = source.evaluated.color
