"""Blender meshes as NumPy arrays: vertices, loops, UVs, attributes, and meshes built from arrays."""

import bpy
import numpy as np

VALUE_KEYS = {  # attribute type -> (property that holds the value, its width, its dtype)
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "INT8": ("value", 1, np.int32),
    "BOOLEAN": ("value", 1, bool),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
    "BYTE_COLOR": ("color", 4, np.float32),
}
MAX_NORMAL_STEP = 1e-3  # Step between normals of two faces at a smooth edge.
FLOAT_TYPES = {1: "FLOAT", 2: "FLOAT2", 3: "FLOAT_VECTOR", 4: "FLOAT_COLOR"}  # by width


def read_values(collection: bpy.types.bpy_prop_collection, key: str, width: int = 1, dtype: type = np.float32) -> np.ndarray:
    """Return the property `key` of all items: (N,) of `dtype`, or (N, width) if it has several components."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(key, values)
    return values if width == 1 else values.reshape(-1, width)


def read_positions(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the vertex positions (V, 3) float32 in object space."""
    return read_values(mesh.vertices, "co", 3)


def write_positions(mesh: bpy.types.Mesh, positions: np.ndarray) -> None:
    """Set the vertex positions (V, 3) in object space."""
    mesh.vertices.foreach_set("co", _flatten(positions))


def count_triangles(mesh: bpy.types.Mesh) -> int:
    """Return the number of triangles of a mesh: a polygon of C corners has C - 2."""
    return len(mesh.loops) - 2 * len(mesh.polygons)


def read_loop_vertices(mesh: bpy.types.Mesh) -> np.ndarray:
    """Return the vertex index (L,) int32 of every loop (face corner)."""
    return read_values(mesh.loops, "vertex_index", dtype=np.int32)


def read_loop_triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate the polygons as Blender draws them: return loop indices (T, 3) and polygon indices (T,), both int32."""
    mesh.calc_loop_triangles()
    loops = read_values(mesh.loop_triangles, "loops", 3, np.int32)
    return loops, read_values(mesh.loop_triangles, "polygon_index", dtype=np.int32)


def read_uvs(layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """Return the coordinates (L, 2) float32 of a UV map."""
    return read_values(layer.uv, "vector", 2)


def write_uvs(layer: bpy.types.MeshUVLoopLayer, uvs: np.ndarray) -> None:
    """Set the coordinates (L, 2), of any shape with as many numbers, of a UV map."""
    layer.uv.foreach_set("vector", _flatten(uvs))


def read_attribute(attribute: bpy.types.Attribute) -> np.ndarray:
    """Return the values of an attribute of a type in VALUE_KEYS: (N,) or (N, width). Colors are scene-linear."""
    return read_values(attribute.data, *VALUE_KEYS[attribute.data_type])


def write_attribute(mesh: bpy.types.Mesh, name: str, domain: str, values: np.ndarray) -> None:
    """Write `values` (N,) or (..., width) as the float attribute `name`, and create it in `domain` if it does not exist.

    Its type follows from the width: number, 2D vector (a UV map in the domain "CORNER"), vector or color.
    """
    data_type = FLOAT_TYPES[1 if values.ndim == 1 else values.shape[-1]]
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, data_type, domain)
    attribute.data.foreach_set(VALUE_KEYS[data_type][0], _flatten(values))


def write_integers(mesh: bpy.types.Mesh, name: str, domain: str, values: np.ndarray) -> None:
    """Create the integer attribute `name` with `values` (N,) in `domain`."""
    mesh.attributes.new(name, "INT", domain).data.foreach_set("value", np.ascontiguousarray(values, np.int32))


def write_geometry(mesh: bpy.types.Mesh, positions: np.ndarray, loop_vertices: np.ndarray, polygon_starts: np.ndarray) -> None:
    """Replace the geometry of `mesh` by polygons.

    Args:
        positions: (V, 3), object space. loop_vertices: vertex index (L,) of every loop, of any shape.
        polygon_starts: (P,) index of the first loop of every polygon.
    """
    mesh.clear_geometry()
    mesh.vertices.add(len(positions))
    mesh.loops.add(loop_vertices.size)
    mesh.polygons.add(len(polygon_starts))
    if len(positions):  # through the attributes, which Blender copies as a whole; empty meshes do not have them
        mesh.attributes["position"].data.foreach_set("vector", _flatten(positions))
    if loop_vertices.size:
        mesh.attributes[".corner_vert"].data.foreach_set("value", loop_vertices.astype(np.int32).ravel())
    mesh.polygons.foreach_set("loop_start", np.asarray(polygon_starts, np.int32))
    mesh.update(calc_edges=True)


def write_triangles(mesh: bpy.types.Mesh, positions: np.ndarray, triangles: np.ndarray) -> None:
    """Replace the geometry of `mesh` by `triangles` (T, 3) of `positions` (V, 3), object space."""
    write_geometry(mesh, positions, triangles, np.arange(0, triangles.size, 3))


def write_corner_normals(mesh: bpy.types.Mesh, normals: np.ndarray) -> None:
    """Write the normals (T, 3, 3) of the corners of a mesh of triangles, and mark the edges where they differ as sharp: Cycles divides
    vertices only there, and shades other vertices with one of their normals."""
    write_attribute(mesh, "custom_normal", "CORNER", normals)
    flat, vertices = normals.reshape(-1, 3), read_loop_vertices(mesh)
    edges = read_values(mesh.loops, "edge_index", dtype=np.int32)
    order = np.argsort(edges, kind="stable")
    first = np.flatnonzero(edges[order][1:] == edges[order][:-1])
    one, other = order[first], order[first + 1]
    following = np.arange(len(flat)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    is_opposite = vertices[one] != vertices[other]
    at_start, at_end = np.where(is_opposite, following[other], other), np.where(is_opposite, other, following[other])
    is_sharp = np.abs(flat[one] - flat[at_start]).max(axis=1) > MAX_NORMAL_STEP
    is_sharp |= np.abs(flat[following[one]] - flat[at_end]).max(axis=1) > MAX_NORMAL_STEP
    sharp = np.zeros(len(mesh.edges), bool)
    sharp[edges[one[is_sharp]]] = True
    if sharp.any():
        mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE").data.foreach_set("value", sharp)


def _flatten(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).ravel()
