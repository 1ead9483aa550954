"""Normals of levels: hard edges stay hard, and normals that an artist has turned stay as they are."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.transforms import normalize
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.corner_normals import repair_normals
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import box
from textured_levels import textured_sphere


def textured_box(turn: float = 0.0, cuts: int = 6) -> TexturedMesh:
    """A box with hard edges. turn: adds to the normals, which turns all to one side."""
    mesh = box(cuts=cuts)
    _, faces = face_areas_and_normals(mesh.corners)
    normals = normalize(np.repeat(faces[:, None], 3, axis=1) + [0.0, 0.0, turn])
    return build_textured_mesh(mesh, mesh.corners[..., :2] + 0.3 * mesh.corners[..., 2:], normals)


def simplify(fine: TexturedMesh, count: int) -> TexturedMesh:
    return extract_level(fine, run_to_end(simplify_by_cost(fine, None, [count], TexmeshSettings())).levels[0])


def test_hard_edges_stay_hard_where_seams_were_dissolved():
    """Each vertex has the normal of one of its faces, as where the seams of a hard edge were dissolved."""
    fine = textured_box(cuts=1)
    corners = fine.vertices[fine.triangles]
    _, faces = face_areas_and_normals(corners)
    normals = np.empty_like(fine.vertices)
    normals[fine.triangles] = faces[:, None]
    dissolved = build_textured_mesh(TriangleMesh(fine.vertices, fine.triangles), corners[..., :2], normals[fine.triangles])
    assert len(fine.uvs) == 24 and len(dissolved.uvs) == 8
    repaired = repair_normals(fine, replace(dissolved, sources=fine.sources))
    assert np.allclose(repaired, faces[:, None], atol=1e-5)
    assert np.allclose(repair_normals(fine, fine), fine.attributes[fine.wedge_triangles])


@pytest.mark.parametrize("turn", [1.0, 3.0])
def test_normals_that_were_turned_stay(turn):
    fine = textured_box(turn)
    level = simplify(fine, 60)
    assert np.allclose(repair_normals(fine, level), level.attributes[level.wedge_triangles])


def test_smooth_surfaces_stay_smooth_with_few_triangles():
    fine = textured_sphere(16)
    fine = replace(fine, attributes=normalize(fine.vertices[fine.wedge_vertices]).astype(np.float32))
    level = simplify(fine, 80)
    assert np.allclose(repair_normals(fine, level), level.attributes[level.wedge_triangles])


def test_flat_faces_have_no_normals():
    fine = textured_box()
    fine = replace(fine, attributes=np.zeros_like(fine.attributes))
    assert not repair_normals(fine, fine).any()
