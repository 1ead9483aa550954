"""Quadrics of positions at vertices, and moves of kept vertices to their minima."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh, scaled_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.deviation_quadrics import DeviationQuadrics
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.collapse_fans import Surface
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_by_cost
from farfield.addon.core.texmesh.simplification.placement import shorten_steps
from farfield.addon.core.texmesh.simplification.wedge_quadrics import COLUMNS, ROWS, fix_uvs
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def make_level(mesh: TexturedMesh, target: int, moves_vertices: bool) -> TexturedMesh:
    def make_cost(divided: TexturedMesh, _vertices: np.ndarray) -> DeviationQuadrics:
        cost = DeviationQuadrics(divided, 8.0)
        cost.moves_vertices = moves_vertices
        return cost

    result = run_to_end(simplify_by_cost(mesh, make_cost, [target], TexmeshSettings(vertices="optimized")))
    return extract_level(mesh, result.levels[0])


def measure_mean(fine: TexturedMesh, level: TexturedMesh) -> float:
    return float(closest_on_mesh(fine.vertices, level.vertices[level.triangles])[0].mean())


def make_sphere(scale: float) -> TexturedMesh:
    """Return a unit sphere whose halves are islands, seen from above and below with a `scale`; 0 for no area."""
    index = np.arange(2000.0)
    heights, angles = 1.0 - (2.0 * index + 1.0) / 2000.0, np.pi * (1.0 + np.sqrt(5.0)) * index
    radii = np.sqrt(1.0 - heights**2)
    vertices = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights])
    triangles = ConvexHull(vertices).simplices
    centers = vertices[triangles].mean(axis=1)
    is_inward = np.einsum("ti,ti->t", scaled_normals(vertices[triangles]), centers) < 0.0
    triangles[is_inward] = triangles[is_inward, ::-1]
    uvs = scale * (vertices[triangles][..., :2] + 3.0 * (centers[:, 2] < 0.0)[:, None, None])
    return build_textured_mesh(TriangleMesh(vertices, triangles.astype(np.int32)), uvs)


@pytest.mark.slow
def test_vertices_move_to_where_the_surface_is_nearest_on_both_sides():
    """Levels whose vertices stay on a sphere are inside of it, and farther from it."""
    for fine in (make_sphere(0.0), make_sphere(0.1)):
        kept, moved = (make_level(fine, 500, moves_vertices) for moves_vertices in (False, True))
        np.testing.assert_allclose(np.linalg.norm(kept.vertices, axis=1), 1.0)
        assert len(kept.triangles) == len(moved.triangles) == 500
        assert measure_mean(fine, moved) < 0.6 * measure_mean(fine, kept)


def test_fixed_texture_coordinates_leave_a_quadric_of_the_position():
    generator = np.random.default_rng(3)
    rows = generator.normal(size=(5, 4, 6))
    points = generator.normal(size=(5, 5))
    homogeneous = np.column_stack([points, np.ones(5)])
    expected = (np.einsum("nij,nj->ni", rows, homogeneous) ** 2).sum(axis=1)
    quadrics = fix_uvs(np.einsum("nki,nkj->nij", rows, rows)[:, ROWS, COLUMNS], points[:, 3:])
    full = np.zeros((5, 4, 4))
    upper = np.triu_indices(4)
    full[:, upper[0], upper[1]] = full[:, upper[1], upper[0]] = quadrics
    position = np.column_stack([points[:, :3], np.ones(5)])
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", position, full, position), expected, rtol=1e-10)


def test_steps_are_shortened_where_they_fold():
    """A fan around a vertex of a flat hexagon: a step across its border becomes half as long until it is inside, another stays."""
    angles = np.arange(6) * np.pi / 3.0
    vertices = np.vstack([np.zeros(3), np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])])
    triangles = np.array([[0, 1 + corner, 1 + (corner + 1) % 6] for corner in range(6)])
    surface = Surface(vertices.T.copy(), np.tile([[0.0], [0.0], [1.0]], 7), np.zeros((2, 7)))
    for step, expected in ((0.5, 0.5), (1.2, 0.6), (30.0, 0.0)):
        steps = shorten_steps(surface, triangles.T, np.array([0]), np.array([[step, 0.0, 0.0]]))
        np.testing.assert_allclose(steps, [[expected, 0.0, 0.0]])
        moved = vertices + np.outer(np.arange(7) == 0, steps[0])
        assert (scaled_normals(moved[triangles])[:, 2] > 0.0).all()
