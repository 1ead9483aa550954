"""Charts that unfold without stretch do, exactly; all others are told apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from charts import chart_of, dome
from farfield.addon.core.edges import edges_of
from farfield.addon.core.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.chart import Chart
from farfield.addon.core.unwrap.plane import signed_areas
from farfield.addon.core.unwrap.unfolding import LEVELS, unfolded
from shapes import rotation, sheet


def unfold(mesh: TriangleMesh) -> np.ndarray | None:
    return finish(unfolded(chart_of(mesh)))


def assert_keeps_lengths(mesh: TriangleMesh, layout: np.ndarray) -> None:
    edges = edges_of(mesh.triangles)
    there, on_surface = (np.linalg.norm(np.subtract(*places[edges.ends.T]), axis=1) for places in (layout, mesh.vertices))
    assert there == pytest.approx(on_surface, rel=1e-6)
    areas, _ = face_areas_and_normals(mesh.corners)
    assert signed_areas(layout[mesh.triangles]) == pytest.approx(areas, rel=1e-6)


def rolled(turns: float, side: int = 12, taper: float = 0.0) -> TriangleMesh:
    """A sheet rolled up to so many `turns` of a cylinder, or of a cone, cut open."""
    mesh = sheet(side)
    angles, heights = 2.0 * np.pi * turns * mesh.vertices[:, 0], 2.0 * mesh.vertices[:, 1]
    radii = 1.0 - taper * heights
    return TriangleMesh(np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights]), mesh.triangles)


@given(folds=st.lists(st.floats(-2.5, 2.5), min_size=1, max_size=12), seed=st.integers(0, 99))
def test_a_folded_strip_unfolds(folds, seed):
    along = np.concatenate([[[0.0, 0.0]], np.cumsum([[np.cos(angle), np.sin(angle)] for angle in np.cumsum(folds)], axis=0)])
    vertices = np.concatenate([np.column_stack([along, np.full(len(along), height)]) for height in (0.0, 0.7)]) @ rotation(seed).T
    here = np.arange(len(folds))
    ahead, above = here + 1, len(along)
    triangles = np.concatenate([np.stack([here, ahead, ahead + above], axis=1), np.stack([here, ahead + above, here + above], axis=1)])
    mesh = TriangleMesh(vertices, triangles.astype(np.int32))
    assert_keeps_lengths(mesh, unfold(mesh))


@pytest.mark.parametrize(("turns", "taper"), [(0.9, 0.0), (0.9, 0.3), (0.25, -0.2)])
def test_tubes_and_cones_that_are_cut_open_unroll(turns, taper):
    mesh = rolled(turns, taper=taper)
    assert_keeps_lengths(mesh, unfold(mesh))


def test_a_plate_with_a_hole_is_its_own_layout():
    mesh = sheet(9)
    middle = np.abs(mesh.corners.mean(axis=1)[:, :2] - 0.5).max(axis=1) < 0.2
    used, triangles = np.unique(mesh.triangles[~middle], return_inverse=True)
    plate = TriangleMesh(mesh.vertices[used] @ rotation(4).T, triangles.reshape(-1, 3).astype(np.int32))
    assert_keeps_lengths(plate, unfold(plate))


def test_a_long_strip_is_unfolded_in_portions():
    count = 3 * LEVELS
    along = np.column_stack([np.arange(count), np.tile([0.0, 1.0], count // 2), np.zeros(count)])
    triangles = np.stack([np.arange(count - 2), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    triangles[::2] = triangles[::2, [0, 2, 1]]
    mesh = TriangleMesh(along.astype(float), triangles.astype(np.int32))
    assert_keeps_lengths(mesh, unfold(mesh))
    assert sum(1 for _ in unfolded(chart_of(mesh))) > 2


def test_what_is_curved_both_ways_does_not_unfold():
    assert unfold(dome(8)) is None


def test_a_ring_wound_more_than_once_does_not_unfold_over_itself():
    mesh = sheet(40)
    angles, radii = 4.0 * np.pi * mesh.vertices[:, 0], 1.0 + mesh.vertices[:, 1]
    stairs = TriangleMesh(np.column_stack([radii * np.cos(angles), radii * np.sin(angles), 1e-4 * angles]), mesh.triangles)
    assert unfold(stairs) is None


def test_what_matters_unevenly_has_to_be_stretched():
    mesh = sheet(4)
    assert finish(unfolded(Chart(mesh.vertices, mesh.triangles, np.linspace(1.0, 2.0, len(mesh.triangles))))) is None


def test_a_triangle_without_area_cannot_be_laid_down():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    assert unfold(TriangleMesh(vertices, np.array([[0, 1, 2], [1, 0, 3]], np.int32))) is None
