"""Developable charts are unfolded isometrically; all others are rejected."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from charts import chart_of, dome
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.parameterization.developable import FRONTS_PER_YIELD, unfold_developable
from shapes import random_rotation, sheet


def unfold(mesh: TriangleMesh) -> np.ndarray | None:
    return run_to_end(unfold_developable(chart_of(mesh)))


def assert_is_isometric(mesh: TriangleMesh, uv: np.ndarray) -> None:
    edges = find_edges(mesh.triangles)
    uv_lengths, lengths = (np.linalg.norm(np.subtract(*positions[edges.ends.T]), axis=1) for positions in (uv, mesh.vertices))
    assert uv_lengths == pytest.approx(lengths, rel=1e-6)
    areas, _ = face_areas_and_normals(mesh.corners)
    assert signed_areas(uv[mesh.triangles]) == pytest.approx(areas, rel=1e-6)


def rolled_sheet(turns: float, side: int = 12, taper: float = 0.0) -> TriangleMesh:
    """A sheet rolled to `turns` of a cylinder, or of a cone, cut open."""
    mesh = sheet(side)
    angles, heights = 2.0 * np.pi * turns * mesh.vertices[:, 0], 2.0 * mesh.vertices[:, 1]
    radii = 1.0 - taper * heights
    return TriangleMesh(np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights]), mesh.triangles)


@given(folds=st.lists(st.floats(-2.5, 2.5), min_size=1, max_size=12), seed=st.integers(0, 99))
def test_a_folded_strip_unfolds(folds, seed):
    profile = np.concatenate([[[0.0, 0.0]], np.cumsum([[np.cos(angle), np.sin(angle)] for angle in np.cumsum(folds)], axis=0)])
    vertices = (
        np.concatenate([np.column_stack([profile, np.full(len(profile), height)]) for height in (0.0, 0.7)]) @ random_rotation(seed).T
    )
    index = np.arange(len(folds))
    following, above = index + 1, len(profile)
    lower = np.stack([index, following, following + above], axis=1)
    upper = np.stack([index, following + above, index + above], axis=1)
    mesh = TriangleMesh(vertices, np.concatenate([lower, upper]).astype(np.int32))
    assert_is_isometric(mesh, unfold(mesh))


@pytest.mark.parametrize(("turns", "taper"), [(0.9, 0.0), (0.9, 0.3), (0.25, -0.2)])
def test_open_cylinders_and_cones_unroll(turns, taper):
    mesh = rolled_sheet(turns, taper=taper)
    assert_is_isometric(mesh, unfold(mesh))


def test_a_flat_plate_with_a_hole_keeps_its_shape():
    mesh = sheet(9)
    is_hole = np.abs(mesh.corners.mean(axis=1)[:, :2] - 0.5).max(axis=1) < 0.2
    used, triangles = np.unique(mesh.triangles[~is_hole], return_inverse=True)
    plate = TriangleMesh(mesh.vertices[used] @ random_rotation(4).T, triangles.reshape(-1, 3).astype(np.int32))
    assert_is_isometric(plate, unfold(plate))


def test_a_long_strip_reports_progress():
    count = 3 * FRONTS_PER_YIELD
    vertices = np.column_stack([np.arange(count), np.tile([0.0, 1.0], count // 2), np.zeros(count)])
    triangles = np.stack([np.arange(count - 2), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    triangles[::2] = triangles[::2, [0, 2, 1]]
    mesh = TriangleMesh(vertices.astype(float), triangles.astype(np.int32))
    assert_is_isometric(mesh, unfold(mesh))
    assert sum(1 for _ in unfold_developable(chart_of(mesh))) > 2


def test_a_doubly_curved_surface_is_rejected():
    assert unfold(dome(8)) is None


def test_a_spiral_of_more_than_one_turn_is_rejected():
    mesh = sheet(40)
    angles, radii = 4.0 * np.pi * mesh.vertices[:, 0], 1.0 + mesh.vertices[:, 1]
    spiral = TriangleMesh(np.column_stack([radii * np.cos(angles), radii * np.sin(angles), 1e-4 * angles]), mesh.triangles)
    assert unfold(spiral) is None


def test_uneven_density_is_rejected():
    mesh = sheet(4)
    assert run_to_end(unfold_developable(Chart(mesh.vertices, mesh.triangles, np.linspace(1.0, 2.0, len(mesh.triangles))))) is None


def test_a_triangle_without_area_is_rejected():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    assert unfold(TriangleMesh(vertices, np.array([[0, 1, 2], [1, 0, 3]], np.int32))) is None
