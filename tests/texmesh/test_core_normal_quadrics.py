"""Shading normals in the cost of collapses: none where they are linear, and strips next to rounded edges stay."""

import numpy as np
import pytest

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.normal_quadrics import NormalQuadrics
from farfield.addon.core.texmesh.refitting.refit import make_starts
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import extract_level
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh
from tests.shapes import sheet

SIDE = 8


def tilt(x: np.ndarray) -> np.ndarray:
    """Return unit normals that turn by `x` radians around the Y axis."""
    return np.stack([np.sin(x), np.zeros_like(x), np.cos(x)], axis=-1)


def make_quadrics(normals: np.ndarray) -> tuple[TriangleMesh, NormalQuadrics]:
    mesh = sheet(SIDE, lambda x, y: 0.0 * x * y)
    return mesh, NormalQuadrics(mesh.vertices, mesh.triangles, normals[mesh.triangles], np.ones(len(mesh.triangles)))


def find_vertex(mesh: TriangleMesh, x: float, y: float) -> np.ndarray:
    return np.array([np.abs(mesh.vertices[:, :2] - [x, y]).sum(axis=1).argmin()])


def test_collapses_cost_what_normals_lose():
    mesh = sheet(SIDE, lambda x, y: 0.0 * x * y)
    _, linear = make_quadrics(mesh.vertices @ np.diag([0.1, 0.2, 0.0]) + [0.0, 0.0, 1.0])
    removed, kept = find_vertex(mesh, 0.5, 0.5), find_vertex(mesh, 0.5 + 1.0 / SIDE, 0.5)
    assert linear.evaluate(removed, kept, mesh.vertices[kept]) == pytest.approx(0.0, abs=1e-12)
    _, bent = make_quadrics(tilt(np.where(mesh.vertices[:, 0] < 0.45, 0.0, 1.0)))
    strip = find_vertex(mesh, 0.5 - 1.0 / SIDE, 0.5)
    costs = [bent.evaluate(strip, find_vertex(mesh, x, 0.5), np.array([[x, 0.5, 0.0]]))[0] for x in (0.25, 0.75)]
    assert costs[0] > 0.01 and costs[1] > 0.01
    bent.merge(strip, removed)
    assert bent.evaluate(removed, kept, mesh.vertices[kept])[0] > 0.01


def test_vertices_with_several_normals_cost_nothing():
    mesh = sheet(SIDE, lambda x, y: 0.0 * x * y)
    is_right = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0] > 0.5
    normals = np.broadcast_to(tilt(is_right.astype(float))[:, None], (len(mesh.triangles), 3, 3))
    hard = NormalQuadrics(mesh.vertices, mesh.triangles, normals, np.ones(len(mesh.triangles)))
    edge, above = find_vertex(mesh, 0.5, 0.5), find_vertex(mesh, 0.5, 0.5 + 1.0 / SIDE)
    assert hard.evaluate(edge, above, mesh.vertices[above]) == 0.0


def test_levels_keep_strips_next_to_rounded_edges():
    """A plate with a ridge whose normals turn within one row of triangles at each side, and are constant farther away."""
    ridge = sheet(24, lambda x, y: -0.5 * np.abs(x - 0.5) + 0.0 * y)
    normals = tilt(np.where(ridge.vertices[:, 0] < 0.499, -0.46, np.where(ridge.vertices[:, 0] > 0.501, 0.46, 0.0)))
    corners = ridge.vertices[ridge.triangles]
    mesh = build_textured_mesh(ridge, corners[:, :, :2])
    widths = []
    for source_normals in (normals[ridge.triangles].reshape(-1, 3), None):
        starts = run_to_end(make_starts(mesh, source_normals, [60], TexmeshSettings(), moves_vertices=False))[1]
        level = extract_level(mesh, starts[0].full)
        spans = np.ptp(level.vertices[level.triangles][:, :, 0], axis=1)
        is_at_ridge = (np.abs(level.vertices[level.triangles][:, :, 0] - 0.5) < 1e-6).any(axis=1)
        widths.append(spans[is_at_ridge].mean())
    assert widths[0] < 0.5 * widths[1]
