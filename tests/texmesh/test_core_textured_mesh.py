"""Textured meshes: wedges, seams, and what is welded or split when they are built."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def grid(columns: int, rows: int) -> TriangleMesh:
    """A plane of columns x rows squares."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = first, first + 1, first + columns + 2, first + columns + 1
    return TriangleMesh(vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32))


def planar_uvs(mesh: TriangleMesh) -> np.ndarray:
    return mesh.corners[..., :2] / 10.0


def seam_ends(mesh: TexturedMesh) -> np.ndarray:
    edges = find_edges(mesh.triangles)
    return mesh.vertices[edges.ends[mesh.find_seams(edges)]]


def test_a_mesh_with_one_island_has_one_wedge_per_vertex_and_no_seams():
    mesh = grid(4, 3)
    textured = build_textured_mesh(mesh, planar_uvs(mesh))
    assert len(textured.vertices) == len(textured.uvs) == 20
    assert not len(seam_ends(textured))
    np.testing.assert_array_equal(textured.vertices[textured.triangles], mesh.corners)
    np.testing.assert_array_equal(textured.corner_uvs, planar_uvs(mesh))


@pytest.mark.parametrize("kind", ["uvs", "materials", "attributes"])
def test_seams_are_where_values_differ(kind):
    """The two halves of a plane, left and right of x = 2."""
    mesh = grid(4, 3)
    is_right = mesh.corners[..., 0].mean(axis=1) > 2.0
    uvs = planar_uvs(mesh) + (is_right * 0.5 if kind == "uvs" else np.zeros(len(is_right)))[:, None, None]
    materials = is_right.astype(np.int32) if kind == "materials" else None
    attributes = np.repeat(is_right, 3).reshape(-1, 3, 1).astype(np.float32) if kind == "attributes" else None
    textured = build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles, materials), uvs, attributes)
    assert len(textured.vertices) == 20 and len(textured.uvs) == 24
    assert (seam_ends(textured)[..., 0] == 2.0).all() and len(seam_ends(textured)) == 3


def test_vertices_that_exporters_split_along_seams_are_welded():
    mesh = grid(4, 3)
    is_right = mesh.corners[..., 0].mean(axis=1) > 2.0
    vertices = np.concatenate([mesh.vertices, mesh.vertices])
    split = TriangleMesh(vertices, mesh.triangles + (is_right * len(mesh.vertices)).astype(np.int32)[:, None])
    textured = build_textured_mesh(split, planar_uvs(mesh) + is_right[:, None, None] * 0.5)
    assert len(textured.vertices) == 20 and len(seam_ends(textured)) == 3
    np.testing.assert_array_equal(textured.vertices[textured.triangles], mesh.corners)


def test_coinciding_sheets_are_not_welded():
    """A plane and its copy with the other side up, and a copy with the same side up, stay apart."""
    mesh = grid(2, 2)
    for triangles in (mesh.triangles, mesh.triangles[:, ::-1]):
        both = TriangleMesh(np.concatenate([mesh.vertices] * 2), np.concatenate([mesh.triangles, triangles + len(mesh.vertices)]))
        textured = build_textured_mesh(both, planar_uvs(both))
        counts = find_edges(textured.triangles).face_counts
        assert counts.max() <= 2
        np.testing.assert_array_equal(textured.vertices[textured.triangles], both.corners)


def test_triangles_that_touch_at_a_point_get_vertices_of_their_own():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (-1, 0, 0), (-1, -1, 0)], float)
    mesh = TriangleMesh(vertices, np.array([(0, 1, 2), (0, 3, 4)], np.int32))
    textured = build_textured_mesh(mesh, planar_uvs(mesh))
    assert len(textured.vertices) == 6
    np.testing.assert_array_equal(textured.vertices[textured.triangles], mesh.corners)


def test_three_triangles_at_an_edge_keep_it():
    vertices = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 0), (-1, 1, 0), (-1, -1, 0)], float)
    mesh = TriangleMesh(vertices, np.array([(0, 1, 2), (0, 1, 3), (0, 1, 4)], np.int32))
    textured = build_textured_mesh(mesh, np.zeros((3, 3, 2)) + mesh.corners[..., :2])
    assert len(textured.vertices) == 5 and find_edges(textured.triangles).face_counts.max() == 3


@given(st.integers(0, 10**6))
def test_corners_keep_their_values(seed):
    """For any triangles: positions and values of corners stay, and `sources` names them."""
    random = np.random.default_rng(seed)
    vertices = random.integers(0, 3, (8, 3)).astype(float)
    triangles = np.array([random.choice(8, 3, replace=False) for _ in range(6)], np.int32)
    uvs, attributes = random.integers(0, 2, (6, 3, 2)).astype(float), random.integers(0, 2, (6, 3, 2)).astype(np.float32)
    materials = random.integers(0, 2, 6).astype(np.int32)
    try:
        textured = build_textured_mesh(TriangleMesh(vertices, triangles, materials), uvs, attributes)
    except GeometryError:
        return
    rows = textured.sources
    np.testing.assert_array_equal(textured.vertices[textured.triangles], vertices[triangles].reshape(-1, 3)[rows])
    np.testing.assert_array_equal(textured.corner_uvs, uvs.reshape(-1, 2)[rows])
    np.testing.assert_array_equal(textured.attributes[textured.wedge_triangles], attributes.reshape(-1, 2)[rows])
    np.testing.assert_array_equal(textured.materials, materials[rows[:, 0] // 3])
    np.testing.assert_array_equal(textured.wedge_vertices[textured.wedge_triangles], textured.triangles)
    assert np.unique(textured.triangles).tolist() == list(range(len(textured.vertices)))
    assert np.unique(textured.wedge_triangles).tolist() == list(range(len(textured.uvs)))


def test_texture_coordinates_that_are_not_finite_are_refused():
    mesh = grid(1, 1)
    with pytest.raises(GeometryError, match='"Rock" has texture coordinates that are not finite numbers; correct its UV map'):
        build_textured_mesh(mesh, np.full((2, 3, 2), np.nan), name="Rock")
