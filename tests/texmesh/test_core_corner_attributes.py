"""Normals and colors of levels, fitted to those of the original."""

from dataclasses import replace

import numpy as np

from farfield.addon.core.geometry.mesh import face_areas_and_normals, vertex_normals
from farfield.addon.core.geometry.transforms import normalize
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.corner_attributes import CornerAttributes
from farfield.addon.core.texmesh.refitting.outliers import FineSurface
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh, merge_wedges
from tests.shapes import box
from textured_levels import textured_sphere


def build_box(is_hard: bool, cuts: int = 12) -> TexturedMesh:
    """Return a box that is shaded flat, by normals, or smooth over all edges."""
    mesh = box(cuts=cuts)
    _, faces = face_areas_and_normals(mesh.corners)
    normals = np.repeat(faces[:, None], 3, axis=1) if is_hard else vertex_normals(mesh.vertices, mesh.triangles)[mesh.triangles]
    return build_textured_mesh(mesh, mesh.corners[..., :2] + 0.3 * mesh.corners[..., 2:], normals, has_normals=True)


def simplify(fine: TexturedMesh, count: int) -> TexturedMesh:
    plain = merge_wedges(fine)
    level = extract_level(plain, run_to_end(simplify_by_cost(plain, None, [count], TexmeshSettings())).levels[0])
    return CornerAttributes(fine, FineSurface.of(plain)).add_to(level)


def angles_to_faces(mesh: TexturedMesh, weights: list[float]) -> np.ndarray:
    """Return the angles in degrees between triangles and the normals that they show at barycentric coordinates."""
    _, faces = face_areas_and_normals(mesh.vertices[mesh.triangles])
    shown = normalize(np.einsum("i,tia->ta", weights, mesh.attributes[mesh.wedge_triangles, :3].astype(float)))
    return np.degrees(np.arccos(np.clip(np.einsum("ti,ti->t", shown, faces), -1.0, 1.0)))


def test_hard_edges_stay_hard():
    level = simplify(build_box(is_hard=True), 12)
    assert len(level.triangles) == 12 and len(level.uvs) == 24
    for weights in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
        assert angles_to_faces(level, weights).max() < 1.0


def test_faces_do_not_swell_where_narrow_ones_were_shaded_smooth():
    """The original shows the normals of its faces but in a narrow strip next to the edges; so must a level without the strip."""
    level = simplify(build_box(is_hard=False), 12)
    assert angles_to_faces(level, [1 / 3, 1 / 3, 1 / 3]).max() < 5.0
    assert angles_to_faces(level, [0.8, 0.1, 0.1]).max() < 20.0  # 55 degrees at the corners of the original


def test_smooth_surfaces_stay_smooth():
    fine = textured_sphere(32)
    fine = replace(fine, attributes=normalize(fine.vertices[fine.wedge_vertices]).astype(np.float32), has_normals=True)
    level = simplify(fine, 400)
    normals, radial = level.attributes, normalize(level.vertices[level.wedge_vertices])
    assert np.einsum("wi,wi->w", normals, radial).min() > np.cos(np.radians(8.0))
    for vertex in range(len(level.vertices)):
        assert np.ptp(normals[level.wedge_vertices == vertex], axis=0).max() == 0.0


def test_colors_that_are_linear_on_a_face_are_kept():
    mesh = box(cuts=6)
    colors = mesh.corners @ np.array([[0.2, 0.1, 0.0, 0.0], [0.0, 0.3, 0.1, 0.0], [0.1, 0.0, 0.2, 0.0]]) + 0.4
    fine = build_textured_mesh(mesh, mesh.corners[..., :2] + 0.3 * mesh.corners[..., 2:], colors)
    level = simplify(fine, 24)
    matrix = np.array([[0.2, 0.1, 0.0, 0.0], [0.0, 0.3, 0.1, 0.0], [0.1, 0.0, 0.2, 0.0]])
    np.testing.assert_allclose(level.attributes, level.vertices[level.wedge_vertices] @ matrix + 0.4, atol=1e-3)


def test_borders_of_colors_stay_sharp():
    """The upper and lower halves of a box have different colors, and so have those of its levels."""
    mesh = box(cuts=8)
    is_upper = mesh.corners[..., 2].mean(axis=1) > mesh.vertices[:, 2].mean()
    colors = np.where(is_upper[:, None, None], [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]).repeat(3, axis=1)
    fine = build_textured_mesh(mesh, mesh.corners[..., :2] + 0.3 * mesh.corners[..., 2:], colors)
    level = simplify(fine, 60)
    assert set(map(tuple, np.round(level.attributes, 3).tolist())) == {(1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)}


def test_levels_of_meshes_without_attributes_have_none():
    level = simplify(textured_sphere(16), 60)
    assert level.attributes.shape == (len(level.uvs), 0) and not level.has_normals
