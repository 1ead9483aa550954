"""Borders of islands while they are simplified: straight ones cost nothing, corners that are cut off do."""

import numpy as np
import pytest

from farfield.addon.core.geometry.edges import find_edges, halfedge_ends
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.border_curves import find_border_curves, find_border_halfedges
from farfield.addon.core.texmesh.refitting.correspondence import sample_surface
from farfield.addon.core.texmesh.refitting.deviation_quadrics import BorderDeviations, DeviationQuadrics
from farfield.addon.core.texmesh.refitting.edge_splits import split_far_edges
from farfield.addon.core.texmesh.refitting.level_state import attach
from farfield.addon.core.texmesh.refitting.outliers import FineSurface, measure_distances
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_by_cost
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import sheet

SIDE = 12


def build_sheet(side: int = SIDE, height: float = 0.0) -> TexturedMesh:
    """Return a sheet with a seam at x = 0.5 and waves of `height`."""
    mesh = sheet(side, lambda x, y: height * np.sin(5.0 * x) * np.cos(4.0 * y))
    corners = mesh.vertices[mesh.triangles]
    is_right = corners[:, :, 0].mean(axis=1) > 0.5
    return build_textured_mesh(mesh, corners[:, :, :2] + 2.0 * is_right[:, None, None] * [1.0, 0.0])


def find_wedge(mesh: TexturedMesh, x: float, y: float) -> np.ndarray:
    return np.array([np.abs(mesh.vertices[mesh.wedge_vertices, :2] - [x, y]).sum(axis=1).argmin()])


def test_only_moves_that_cut_off_a_corner_cost():
    mesh, step = build_sheet(), 1.0 / SIDE
    borders = BorderDeviations(mesh, mesh.vertices[mesh.wedge_vertices])
    corner, along, inside = find_wedge(mesh, 0.0, 0.0), find_wedge(mesh, step, 0.0), find_wedge(mesh, step, step)
    farther = find_wedge(mesh, 2.0 * step, 0.0)
    assert borders.evaluate(along, farther) == pytest.approx(0.0, abs=1e-15)
    assert borders.evaluate(along, inside) == 0.0 and borders.evaluate(inside, along) == 0.0
    chord, distance = np.sqrt(2.0) * step, step / np.sqrt(2.0)
    assert borders.evaluate(corner, along) == pytest.approx((chord * distance) ** 2)


def test_deviations_are_carried_along():
    mesh, step = build_sheet(), 1.0 / SIDE
    borders = BorderDeviations(mesh, mesh.vertices[mesh.wedge_vertices])
    corner, along, farther = (find_wedge(mesh, x, 0.0) for x in (0.0, step, 2.0 * step))
    borders.merge(corner, along)
    assert borders.evaluate(along, farther) > (np.sqrt(5.0) * step * step / np.sqrt(2.0)) ** 2


def test_windows_keep_their_corners():
    fine = build_sheet(24, 0.05)
    centers = fine.vertices[fine.triangles].mean(axis=1)
    is_hole = (np.abs(centers[:, 0] - 0.25) < 0.125) & (np.abs(centers[:, 1] - 0.5) < 0.25)
    mesh = sheet(24, lambda x, y: 0.05 * np.sin(5.0 * x) * np.cos(4.0 * y))
    kept = TriangleMesh(mesh.vertices, mesh.triangles[~is_hole])
    windowed = build_textured_mesh(kept, kept.vertices[kept.triangles][:, :, :2])
    simplified = run_to_end(simplify_by_cost(windowed, lambda mesh, _: DeviationQuadrics(mesh, 8.0), [120], TexmeshSettings()))
    level = extract_level(windowed, simplified.levels[0])
    corners = [[x, y] for x in (0.125, 0.375) for y in (0.25, 0.75)]
    distances = np.linalg.norm(level.vertices[:, None, :2] - np.array(corners), axis=2).min(axis=0)
    assert distances.max() < 1.5 / 24


def test_splits_on_borders_stay_on_the_curves_of_the_fine_mesh():
    fine, level = build_sheet(24, 0.1), build_sheet(4, 0.1)
    samples = sample_surface(fine, find_islands(fine), 4000, np.random.default_rng(0))
    state = attach(level, find_islands(level), samples, 1.0)
    surface, curves = FineSurface(fine, find_islands(fine)), find_border_curves(fine, find_islands(fine))
    split = split_far_edges(state, measure_distances(state, surface), 12, surface, curves).mesh
    assert len(level.triangles) < len(split.triangles) <= len(level.triangles) + 12
    edges = find_edges(split.triangles)
    assert edges.face_counts.max() == 2
    assert len(split.vertices) - len(edges.ends) + len(split.triangles) == 1
    new = split.vertices[len(level.vertices) :]
    assert surface.measure_distances(new).max() < 1e-9
    halfedges, twins = find_border_halfedges(split)
    paired = twins >= 0
    first = split.uvs[halfedge_ends(split.wedge_triangles, halfedges[paired])]
    second = split.uvs[halfedge_ends(split.wedge_triangles, twins[paired])][:, ::-1]
    assert paired.any() and np.allclose(np.abs(first - second), [2.0, 0.0])


def test_every_triangle_gets_samples_if_a_part_is_divided_evenly():
    mesh = build_sheet(6)
    vertices = mesh.vertices.copy()
    vertices[:, 0] = vertices[:, 0] ** 4  # triangles at the left are a thousand times smaller
    narrow = build_textured_mesh(TriangleMesh(vertices, mesh.triangles), mesh.corner_uvs)
    samples = sample_surface(narrow, find_islands(narrow), 600, np.random.default_rng(0), 0.5)
    assert np.bincount(samples.triangles, minlength=len(narrow.triangles)).min() >= 1
    assert samples.weights.sum() == pytest.approx(1.0)
    plain = sample_surface(narrow, find_islands(narrow), 600, np.random.default_rng(0))
    assert np.bincount(plain.triangles, minlength=len(narrow.triangles)).min() == 0
    assert np.ptp(plain.weights) == 0.0
