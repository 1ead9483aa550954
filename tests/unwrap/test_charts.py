"""Surfaces cut into charts: seams are kept, closed parts are opened, non-manifold parts are separated, and no triangle is lost."""

import numpy as np
import pytest

from charts import torus
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_edges, boundary_loops
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.cutting.charts import cut_into_charts
from farfield.addon.core.unwrap.cutting.cuts import _stretch_after_cut
from shapes import cylinder, sheet, sphere

NO_SEAMS = np.zeros((0, 2), int)
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)


def cut_and_check(vertices, triangles, seams=NO_SEAMS, polygon_ids=None, **options):
    """Cut a surface into charts that are disks, possibly with holes, and that contain every triangle once."""
    surface = Chart(vertices, triangles, np.ones(len(triangles)), polygon_ids)
    cuts = run_to_end(cut_into_charts(surface, seams, **options))
    assert np.array_equal(np.sort(np.concatenate([cut.triangle_indices for cut in cuts])), np.arange(len(triangles)))
    for cut in cuts:
        assert np.array_equal(cut.chart.vertices[cut.chart.triangles], vertices[triangles[cut.triangle_indices]])
        assert_is_planar(cut.chart)
    return cuts


def assert_is_planar(chart):
    """The chart is a connected and oriented manifold of genus 0 with a boundary."""
    edges = find_edges(chart.triangles)
    assert edges.face_counts.max() <= 2
    loops = boundary_loops(chart.triangles, chart.vertices)
    assert len(loops) >= 1
    assert len(chart.vertices) - len(edges.ends) + len(chart.triangles) == 2 - len(loops)


@pytest.mark.parametrize("handles", [1, 2])
def test_handles_are_cut(handles):
    [cut] = cut_and_check(*torus(handles=handles))
    assert len(boundary_loops(cut.chart.triangles, cut.chart.vertices)) == 1


@pytest.mark.parametrize("mesh", [sphere(16), sphere(3)], ids=["fine", "coarse"])
def test_a_closed_surface_becomes_one_chart(mesh):
    assert len(cut_and_check(mesh.vertices, mesh.triangles)) == 1


def test_a_tetrahedron_becomes_one_chart():
    assert len(cut_and_check(*TETRAHEDRON)) == 1


def test_a_tube_is_cut_lengthwise():
    mesh = cylinder()
    [cut] = cut_and_check(mesh.vertices, mesh.triangles)
    assert len(boundary_loops(cut.chart.triangles, cut.chart.vertices)) == 1


def test_only_seams_are_cut_where_they_suffice():
    mesh = sheet(8)
    across = np.flatnonzero(np.isclose(mesh.vertices[:, 0], np.median(mesh.vertices[:, 0])))
    across = across[np.argsort(mesh.vertices[across, 1])]
    cuts = cut_and_check(mesh.vertices, mesh.triangles, np.column_stack([across[:-1], across[1:]]))
    assert len(cuts) == 2
    assert sum(len(cut.chart.vertices) for cut in cuts) == len(mesh.vertices) + len(across)


def test_a_seam_that_ends_inside_opens_a_slit():
    mesh = sheet(8)
    row = np.flatnonzero(np.isclose(mesh.vertices[:, 0], np.median(mesh.vertices[:, 0])))
    row = row[np.argsort(mesh.vertices[row, 1])][:4]
    [cut] = cut_and_check(mesh.vertices, mesh.triangles, np.column_stack([row[:-1], row[1:]]))
    assert len(cut.chart.vertices) == len(mesh.vertices) + 3


def test_triangles_at_a_non_manifold_edge_are_separated():
    edge = np.array([[0.0, 0, 0], [0, 0, 1]])
    apexes = np.array([[np.cos(angle), np.sin(angle), 0.5] for angle in (0.0, 2.0, 4.0)])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)
    assert len(cut_and_check(np.concatenate([edge, apexes]), triangles)) == 3


def test_parts_that_touch_in_a_vertex_are_separated():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]])
    assert len(cut_and_check(vertices, np.array([[0, 1, 2], [0, 3, 4]], np.int32))) == 2


def test_triangles_of_opposite_orientation_are_separated():
    mesh = sheet(4)
    triangles = mesh.triangles.copy()
    triangles[[3, 7]] = triangles[[3, 7]][:, ::-1]
    cuts = cut_and_check(mesh.vertices, triangles)
    assert sorted(cut.triangle_indices.tolist() for cut in cuts if len(cut.triangle_indices) == 1) == [[3], [7]]


def test_a_moebius_strip_is_cut():
    angles = 2.0 * np.pi * np.arange(24) / 24
    half = np.stack([np.cos(0.5 * angles) * np.cos(angles), np.cos(0.5 * angles) * np.sin(angles), np.sin(0.5 * angles)], axis=1)
    center = np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    vertices = np.concatenate([center - 0.3 * half, center + 0.3 * half])
    triangles = []
    for index in range(24):
        following = (index + 1) % 24
        low, high = (following, following + 24) if following else (24, 0)
        triangles += [[index, low, high], [index, high, index + 24]]
    cut_and_check(vertices, np.array(triangles, np.int32))


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_the_stretch_of_a_proxy_that_a_cut_divides():
    """Only one of its parts is measured; vertices of the others count as average."""
    vertices, triangles = sheet(4).vertices, sheet(4).triangles
    proxy = Chart(vertices, triangles, np.ones(len(triangles)))
    edges = find_edges(triangles)
    is_cut = np.isclose(vertices[edges.ends][..., 0], np.median(vertices[:, 0])).all(axis=1)
    excess, stretch = _stretch_after_cut(proxy, edges, is_cut)
    assert excess == pytest.approx(0.0, abs=2e-3) and stretch == pytest.approx(np.full(len(vertices), stretch.mean()), rel=0.1)


def test_polygons_are_never_cut():
    mesh = sphere(10)
    polygon_ids = np.arange(len(mesh.triangles)) // 2
    edges = find_edges(mesh.triangles)
    for cut in cut_and_check(mesh.vertices, mesh.triangles, polygon_ids=polygon_ids):
        index = np.full(len(mesh.triangles), -1)
        index[cut.triangle_indices] = np.arange(len(cut.triangle_indices))
        for first, second in zip(index[0::2], index[1::2], strict=True):
            shared = set(edges.face_edges[cut.triangle_indices[first]]) & set(edges.face_edges[cut.triangle_indices[second]])
            if shared:
                assert len(set(cut.chart.triangles[first]) & set(cut.chart.triangles[second])) == 2


def test_a_sliver_between_doubled_vertices_does_not_become_a_triangle_with_two_corners():
    """Its two vertices are at the same position, and the triangles around it are connected across doubled vertices."""
    b = [0.0, 0.0, 0.0]
    vertices = np.array([b, b, [1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    triangles = np.array([[2, 0, 1], [0, 2, 3], [0, 3, 4], [1, 5, 6], [1, 6, 2]], np.int32)
    charts = run_to_end(cut_into_charts(Chart(vertices, triangles, np.ones(5)), NO_SEAMS))
    assert sorted(np.concatenate([cut.triangle_indices for cut in charts])) == list(range(5))
    for cut in charts:
        assert (np.sort(cut.chart.triangles, axis=1)[:, 1:] != np.sort(cut.chart.triangles, axis=1)[:, :-1]).all()


@pytest.mark.parametrize("axis", [0, *(pytest.param(axis, marks=pytest.mark.exhaustive) for axis in (1, 2))])
def test_cuts_avoid_the_important_half_of_a_sphere(axis):
    mesh = sphere(14)
    points, indices = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    triangles = indices.reshape(-1)[mesh.triangles].astype(np.int32)
    is_important = points[triangles].mean(axis=1)[:, axis] > 0.0
    charts = run_to_end(cut_into_charts(Chart(points, triangles, np.where(is_important, 4.0, 1.0)), NO_SEAMS))
    edges = [cut.chart.vertices[boundary_edges(cut.chart.triangles)] for cut in charts]
    centers = np.concatenate(edges).mean(axis=1)[:, axis]
    lengths = np.linalg.norm(np.subtract(*np.concatenate(edges).transpose(1, 0, 2)), axis=1)
    assert lengths.sum() > 2.0
    assert lengths[centers > 0.1].sum() < 0.05 * lengths.sum()
