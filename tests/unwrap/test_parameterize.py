"""Parameterizations of charts: without flips and overlaps, isometric where possible, and as the boundary and quality settings require."""

import numpy as np
import pytest

from charts import chart_of, dome, parameterize_and_check, sphere_with_holes
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_loops
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.distortion import compute_stretches, measure_distortion
from farfield.addon.core.unwrap.energies.rest_shapes import compute_rest_shapes
from farfield.addon.core.unwrap.energies.shape_barrier import min_height_to_base
from farfield.addon.core.unwrap.energies.stretch_energy import compute_jacobians
from farfield.addon.core.unwrap.multiresolution.halfedge_decimation import decimate
from farfield.addon.core.unwrap.multiresolution.vertex_splits import split_vertices
from farfield.addon.core.unwrap.parameterization.density_control import compute_density_ratio
from farfield.addon.core.unwrap.parameterization.parameterize import Balance, Boundary, DistortionError, parameterize
from farfield.addon.core.unwrap.parameterization.tutte import circle_outline, square_outline, tutte_embedding
from shapes import cylinder, random_rotation, sheet, sphere


def l2_stretch(chart: Chart, uv: np.ndarray) -> float:
    """L2 stretch of the whole chart: 1 for an isometry of any size."""
    shapes = compute_rest_shapes(chart.vertices[chart.triangles])
    jacobians = compute_jacobians(shapes, chart.triangles, uv)
    stretch = shapes.areas @ (0.5 * jacobians.frobenius_squared / jacobians.determinants**2)
    return float(np.sqrt(stretch * (shapes.areas @ jacobians.determinants)) / shapes.areas.sum())


@pytest.mark.parametrize("side", [3, 12, 40])
def test_a_plane_is_not_stretched(side):
    mesh = sheet(side)
    chart = Chart(mesh.vertices @ random_rotation(3).T * 5.0, mesh.triangles, np.ones(len(mesh.triangles)))
    assert l2_stretch(chart, parameterize_and_check(chart)) == pytest.approx(1.0, abs=1e-4)


def test_a_part_of_a_cylinder_is_unrolled():
    mesh = sheet(20, lambda x, y: np.sqrt(1.0 - (x - 0.5) ** 2) + 0.0 * y)
    assert l2_stretch(chart_of(mesh), parameterize_and_check(chart_of(mesh))) < 1.002


def test_a_dome_has_little_stretch():
    chart = chart_of(dome(16, 0.5))
    uv = parameterize_and_check(chart)
    assert 1.02 < l2_stretch(chart, uv) < 1.06  # the Lambert azimuthal equal-area projection has 1.061
    assert signed_areas(uv[chart.triangles]).sum() == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_balance_decides_between_stretch_needles_and_even_sizes():
    """The opening of a nearly closed sphere is too short for the map."""
    chart = chart_of(dome(24, 0.85))
    metrics = {}
    for balance in Balance:
        uv = parameterize_and_check(chart, Boundary.FREE, 0.0, balance)
        mesh, corner_uvs = TriangleMesh(chart.vertices, chart.triangles), uv[chart.triangles]
        stretches = run_to_end(compute_stretches(mesh, corner_uvs))
        metrics[balance] = run_to_end(measure_distortion(mesh, corner_uvs, stretches, np.zeros(len(corner_uvs))))
    balanced, symmetric, stretch = (metrics[balance] for balance in (Balance.BALANCED, Balance.SYMMETRIC, Balance.STRETCH))
    assert stretch.l2 < balanced.l2 < symmetric.l2
    lowest = symmetric.symmetric_dirichlet
    assert lowest < balanced.symmetric_dirichlet < 1.03 * lowest < stretch.symmetric_dirichlet
    assert balanced.needles < symmetric.needles < 0.5 * stretch.needles


def test_nothing_is_returned_where_a_chart_is_too_distorted():
    chart = chart_of(dome(24, 0.9))
    with pytest.raises(DistortionError) as caught:
        run_to_end(parameterize(chart, Boundary.FREE, 0.0, max_excess=0.05))
    assert caught.value.excess > 0.05
    run_to_end(parameterize(chart_of(dome(24, 0.3)), Boundary.FREE, 0.0, max_excess=0.05))


def test_stretch_does_not_depend_on_size_and_placement_of_the_surface():
    chart = chart_of(dome(12))
    transformed = Chart(37.0 * chart.vertices @ random_rotation(5).T + [3.0, -200.0, 1.0], chart.triangles, chart.density)
    transformed_stretch = l2_stretch(chart, parameterize_and_check(transformed))
    assert transformed_stretch == pytest.approx(l2_stretch(chart, parameterize_and_check(chart)), rel=2e-2)


@pytest.mark.parametrize("boundary", [Boundary.CIRCLE, Boundary.SQUARE])
def test_a_fixed_boundary_keeps_its_shape(boundary):
    chart = chart_of(dome(14))
    uv = parameterize_and_check(chart, boundary)
    [loop] = boundary_loops(chart.triangles, chart.vertices)
    offsets = uv[loop] - 0.5 * (uv[loop].min(axis=0) + uv[loop].max(axis=0))
    radii = np.linalg.norm(offsets, axis=1) if boundary is Boundary.CIRCLE else np.abs(offsets).max(axis=1)
    assert radii == pytest.approx(np.full(len(loop), radii.mean()), rel=1e-2)
    assert l2_stretch(chart, uv) < 1.15


def test_the_quality_limit_is_met_for_little_stretch():
    chart = chart_of(dome(20, 0.9))
    unlimited, limited = parameterize_and_check(chart), parameterize_and_check(chart, Boundary.FREE, 0.15)
    assert min_height_to_base(limited[chart.triangles]).min() >= 0.15
    assert min_height_to_base(unlimited[chart.triangles]).min() < 0.15
    assert l2_stretch(chart, limited) < 1.08 * l2_stretch(chart, unlimited)


@pytest.mark.parametrize("ratio", [pytest.param(2.0, marks=pytest.mark.exhaustive), 4.0])
def test_the_requested_density_ratio_is_reached(ratio):
    mesh = dome(20)
    is_top = mesh.vertices[mesh.triangles].mean(axis=1)[:, 2] > 0.3
    uv = parameterize_and_check(Chart(mesh.vertices, mesh.triangles, np.where(is_top, ratio, 1.0)))
    areas, _ = face_areas_and_normals(mesh.corners)
    assert compute_density_ratio(signed_areas(uv[mesh.triangles]), areas, is_top.astype(float)) == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize(("uv_areas", "areas"), [((1.0, 1.0), (1.0, 0.0)), ((1.0, 0.0), (1.0, 1.0)), ((1.0, 1.0), (0.0, 1.0))])
def test_a_set_without_area_has_no_density_ratio(uv_areas, areas):
    with np.errstate(all="raise"):
        assert compute_density_ratio(np.array(uv_areas), np.array(areas), np.array([1.0, 0.0])) == 0.0


def test_holes_stay_open():
    mesh = sphere_with_holes()
    assert len(boundary_loops(mesh.triangles, mesh.vertices)) == 3
    assert l2_stretch(chart_of(mesh), parameterize_and_check(chart_of(mesh))) < 1.4


def test_an_open_cylinder_becomes_an_annulus():
    mesh = cylinder(cuts=6)
    assert len(boundary_loops(mesh.triangles, mesh.vertices)) == 2
    parameterize_and_check(chart_of(mesh))


def test_charts_of_one_and_two_triangles():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
    for triangles in ([[0, 1, 2]], [[0, 1, 2], [2, 1, 3]]):
        used = vertices[: np.max(triangles) + 1]
        chart = Chart(used, np.array(triangles, np.int32), np.ones(len(triangles)))
        assert l2_stretch(chart, parameterize_and_check(chart)) == pytest.approx(1.0, abs=1e-3)


def test_slivers_and_triangles_without_area_are_accepted():
    mesh = sheet(10)
    random = np.random.default_rng(0)
    vertices = mesh.vertices.copy()
    interior = np.flatnonzero(~find_edges(mesh.triangles).boundary_vertices)
    vertices[random.choice(interior, 12, replace=False)] = vertices[random.choice(interior, 12, replace=False)]
    parameterize_and_check(Chart(vertices, mesh.triangles, np.ones(len(mesh.triangles))))


def test_a_surface_collapsed_to_a_point_is_accepted():
    mesh = sheet(4)
    parameterize_and_check(Chart(0.0 * mesh.vertices, mesh.triangles, np.ones(len(mesh.triangles))))


def test_a_closed_surface_is_an_error():
    with pytest.raises(GeometryError, match="cut it first"):
        run_to_end(parameterize(chart_of(sphere(6)), Boundary.FREE, 0.0))


def test_decimation_preserves_the_topology_and_is_reversible():
    mesh = sphere_with_holes(24)
    coarse, batches = run_to_end(decimate(mesh.vertices, mesh.triangles, 150, np.zeros(len(mesh.vertices), bool)))
    edges = find_edges(coarse, len(mesh.vertices))
    assert len(np.unique(coarse)) <= 150
    assert set(edges.face_counts) == {1, 2}
    assert len(np.unique(coarse)) - len(edges.ends) + len(coarse) == 2 - 3
    assert len(boundary_loops(coarse, mesh.vertices)) == 3
    assert np.array_equal(batches[0].triangles, mesh.triangles)
    count = len(np.unique(coarse))
    for batch in reversed(batches):
        count += len(batch.removed)
        assert len(np.unique(batch.triangles)) == count


def test_vertex_splits_flip_no_triangle():
    mesh = dome(24, 0.95)
    coarse, batches = run_to_end(decimate(mesh.vertices, mesh.triangles, 60, np.zeros(len(mesh.vertices), bool)))
    [loop] = boundary_loops(coarse, mesh.vertices)
    uv = tutte_embedding(mesh.vertices, coarse, loop, circle_outline(np.ones(len(loop))))
    assert signed_areas(uv[coarse]).min() > 0.0
    for batch in reversed(batches):
        uv = split_vertices(uv, batch, mesh.vertices)
        assert signed_areas(uv[batch.triangles]).min() > 0.0


def test_outlines_have_area_one_and_are_counter_clockwise():
    lengths = np.random.default_rng(1).uniform(0.2, 1.0, 60)
    for outline in (circle_outline(lengths), square_outline(lengths, 0.0)):
        following = np.roll(outline, -1, axis=0)
        assert 0.5 * (outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]).sum() == pytest.approx(1.0, abs=0.02)
    corners = {(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)}
    assert corners <= {tuple(position) for position in square_outline(lengths, 0.0).tolist()}
