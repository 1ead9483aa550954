"""Layouts of charts: no triangle flipped, nowhere over themselves, a plane as it is, and as the setting of border and shape asks."""

import numpy as np
import pytest

from charts import chart_of, dome, laid_out, with_holes
from farfield.addon.core.edges import edges_of
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.mesh import face_areas_and_normals
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.borders import border_loops
from farfield.addon.core.unwrap.chart import Chart
from farfield.addon.core.unwrap.chart_layout import Border, chart_layout
from farfield.addon.core.unwrap.collapses import thinned
from farfield.addon.core.unwrap.insertions import inserted
from farfield.addon.core.unwrap.plane import signed_areas
from farfield.addon.core.unwrap.rest_shapes import rest_shapes
from farfield.addon.core.unwrap.shape_barrier import least_ratios
from farfield.addon.core.unwrap.stretch_energy import jacobians
from farfield.addon.core.unwrap.tutte import circle, convex_layout, square
from farfield.addon.core.unwrap.weights import density_ratio
from shapes import cylinder, rotation, sheet, sphere


def l2(chart: Chart, layout: np.ndarray) -> float:
    """L2 stretch over the whole chart: 1 for an isometry, whatever its size."""
    shapes = rest_shapes(chart.vertices[chart.triangles])
    at = jacobians(shapes, chart.triangles, layout)
    stretch = shapes.areas @ (0.5 * at.squares / at.determinants**2)
    return float(np.sqrt(stretch * (shapes.areas @ at.determinants)) / shapes.areas.sum())


@pytest.mark.parametrize("side", [3, 12, 40])
def test_a_plane_comes_back_as_it_is(side):
    mesh = sheet(side)
    chart = Chart(mesh.vertices @ rotation(3).T * 5.0, mesh.triangles, np.ones(len(mesh.triangles)))
    assert l2(chart, laid_out(chart)) == pytest.approx(1.0, abs=1e-4)


def test_a_surface_that_unrolls_is_unrolled():
    mesh = sheet(20, lambda x, y: np.sqrt(1.0 - (x - 0.5) ** 2) + 0.0 * y)
    assert l2(chart_of(mesh), laid_out(chart_of(mesh))) < 1.002


def test_a_dome_is_stretched_as_little_as_it_must_be():
    chart = chart_of(dome(16, 0.5))
    layout = laid_out(chart)
    assert 1.02 < l2(chart, layout) < 1.06  # Lambert's projection of equal areas has 1.061
    assert signed_areas(layout[chart.triangles]).sum() == pytest.approx(1.0, abs=0.1)


def test_size_place_and_turn_of_the_surface_do_not_matter():
    chart = chart_of(dome(12))
    other = Chart(37.0 * chart.vertices @ rotation(5).T + [3.0, -200.0, 1.0], chart.triangles, chart.density)
    assert l2(chart, laid_out(other)) == pytest.approx(l2(chart, laid_out(chart)), rel=2e-2)


@pytest.mark.parametrize("border", [Border.CIRCLE, Border.SQUARE])
def test_a_fixed_border_stays_where_it_is_put(border):
    chart = chart_of(dome(14))
    layout = laid_out(chart, border)
    [rim] = border_loops(chart.triangles, chart.vertices)
    middle = layout[rim] - 0.5 * (layout[rim].min(axis=0) + layout[rim].max(axis=0))
    away = np.linalg.norm(middle, axis=1) if border is Border.CIRCLE else np.abs(middle).max(axis=1)
    assert away == pytest.approx(np.full(len(rim), away.mean()), rel=1e-2)
    assert l2(chart, layout) < 1.15


def test_a_bound_on_shape_holds_and_costs_little():
    chart = chart_of(dome(20, 0.9))
    without, within = laid_out(chart), laid_out(chart, Border.FREE, 0.15)
    assert least_ratios(within[chart.triangles]).min() >= 0.15
    assert least_ratios(without[chart.triangles]).min() < 0.15
    assert l2(chart, within) < 1.08 * l2(chart, without)


@pytest.mark.parametrize("wanted", [2.0, 4.0])
def test_texels_are_as_dense_as_wanted(wanted):
    mesh = dome(20)
    top = mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0.3
    layout = laid_out(Chart(mesh.vertices, mesh.triangles, np.where(top, wanted, 1.0)))
    surface, _ = face_areas_and_normals(mesh.corners)
    assert density_ratio(signed_areas(layout[mesh.triangles]), surface, top.astype(float)) == pytest.approx(wanted, rel=0.1)


def test_holes_stay_holes():
    mesh = with_holes()
    assert len(border_loops(mesh.triangles, mesh.vertices)) == 3
    assert l2(chart_of(mesh), laid_out(chart_of(mesh))) < 1.4


def test_an_open_cylinder_becomes_a_ring():
    mesh = cylinder(cuts=6)
    assert len(border_loops(mesh.triangles, mesh.vertices)) == 2
    laid_out(chart_of(mesh))


def test_one_triangle_and_two_have_layouts():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
    for triangles in ([[0, 1, 2]], [[0, 1, 2], [2, 1, 3]]):
        used = vertices[: np.max(triangles) + 1]
        chart = Chart(used, np.array(triangles, np.int32), np.ones(len(triangles)))
        assert l2(chart, laid_out(chart)) == pytest.approx(1.0, abs=1e-3)


def test_needles_and_triangles_without_area_do_no_harm():
    mesh = sheet(10)
    random = np.random.default_rng(0)
    vertices = mesh.vertices.copy()
    inner = np.flatnonzero(~edges_of(mesh.triangles).on_border)
    vertices[random.choice(inner, 12, replace=False)] = vertices[random.choice(inner, 12, replace=False)]
    laid_out(Chart(vertices, mesh.triangles, np.ones(len(mesh.triangles))))


def test_a_surface_that_is_one_point_still_has_a_layout():
    mesh = sheet(4)
    laid_out(Chart(0.0 * mesh.vertices, mesh.triangles, np.ones(len(mesh.triangles))))


def test_a_closed_surface_is_refused():
    with pytest.raises(GeometryError, match="cut it first"):
        finish(chart_layout(chart_of(sphere(6)), Border.FREE, 0.0))


def test_thinning_keeps_the_topology_and_is_undone_to_the_last_triangle():
    mesh = with_holes(24)
    coarse, rounds = finish(thinned(mesh.vertices, mesh.triangles, 150, np.zeros(len(mesh.vertices), bool)))
    edges = edges_of(coarse, len(mesh.vertices))
    assert len(np.unique(coarse)) <= 150
    assert set(edges.uses) == {1, 2}
    assert len(np.unique(coarse)) - len(edges.ends) + len(coarse) == 2 - 3
    assert len(border_loops(coarse, mesh.vertices)) == 3
    assert np.array_equal(rounds[0].triangles, mesh.triangles)
    count = len(np.unique(coarse))
    for made in reversed(rounds):
        count += len(made.removed)
        assert len(np.unique(made.triangles)) == count


def test_vertices_come_back_into_a_layout_without_flipping_a_triangle():
    mesh = dome(24, 0.95)
    coarse, rounds = finish(thinned(mesh.vertices, mesh.triangles, 60, np.zeros(len(mesh.vertices), bool)))
    [rim] = border_loops(coarse, mesh.vertices)
    layout = convex_layout(mesh.vertices, coarse, rim, circle(np.ones(len(rim))))
    assert signed_areas(layout[coarse]).min() > 0.0
    for made in reversed(rounds):
        layout = inserted(layout, made, mesh.vertices)
        assert signed_areas(layout[made.triangles]).min() > 0.0


def test_outlines_have_the_area_one_and_turn_left():
    lengths = np.random.default_rng(1).uniform(0.2, 1.0, 60)
    for outline in (circle(lengths), square(lengths, 0.0)):
        around = np.roll(outline, -1, axis=0)
        assert 0.5 * (outline[:, 0] * around[:, 1] - outline[:, 1] * around[:, 0]).sum() == pytest.approx(1.0, abs=0.02)
    assert {(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)} <= {tuple(place) for place in square(lengths, 0.0).tolist()}
