"""Normals of corners in Blender: they are those that were written, and Cycles shows them."""

import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import read_values, write_corner_normals, write_triangles
from farfield.addon.core.geometry.mesh import face_areas_and_normals
from tests.shapes import box


def write_box(cuts: int) -> tuple[bpy.types.Mesh, np.ndarray]:
    """Return a mesh with the shape of a box, whose faces share vertices, and the positions (T, 3, 3) of its corners."""
    corners = box(cuts=cuts).corners
    vertices, indices = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0, return_inverse=True)
    mesh = bpy.data.meshes.new("Box")
    write_triangles(mesh, vertices, indices.reshape(-1, 3).astype(np.int32))
    return mesh, vertices[indices.reshape(-1, 3)]


def test_edges_where_normals_differ_are_sharp_and_no_others():
    """A box with hard edges at its upper and lower side, whose other sides are shaded smooth."""
    mesh, corners = write_box(1)
    normals = np.repeat(face_areas_and_normals(corners)[1][:, None], 3, axis=1)
    is_upright = np.abs(normals[:, 0, 2]) < 0.5
    radial = (corners - corners.mean(axis=(0, 1))) * [1.0, 1.0, 0.0]
    normals[is_upright] = (radial / np.linalg.norm(radial, axis=2, keepdims=True))[is_upright]
    write_corner_normals(mesh, normals.astype(np.float32))
    np.testing.assert_allclose(read_values(mesh.corner_normals, "vector", 3), normals.reshape(-1, 3), atol=1e-3)
    is_sharp = read_values(mesh.attributes["sharp_edge"].data, "value", dtype=bool)
    ends = np.array([[mesh.vertices[index].co for index in edge.vertices] for edge in mesh.edges])
    is_border = (ends[:, 0, 2] == ends[:, 1, 2]) & ((ends[:, 0] == ends[:, 1]).sum(axis=1) == 2)  # not the diagonals
    np.testing.assert_array_equal(is_sharp, is_border)


def test_smooth_meshes_have_no_sharp_edges():
    mesh, corners = write_box(2)
    directions = corners - corners.mean(axis=(0, 1))
    write_corner_normals(mesh, (directions / np.linalg.norm(directions, axis=2, keepdims=True)).astype(np.float32))
    assert "sharp_edge" not in mesh.attributes
