"""Solid parts as meshes: within the error, closed, divided into height fields, and no heavier than quads."""

import numpy as np
import pytest

from farfield.addon.core.billboards import BillboardSettings, build_cloud
from farfield.addon.core.billboards.parts.charts import divide_into_charts
from farfield.addon.core.billboards.parts.part_meshes import Part, PartMesh, find_closest_facing
from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate, face_areas_and_normals, longest_side
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, bumpy_sphere, sheet, sphere


def build(mesh, **settings):
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"levels": 1} | settings)), "Shape"))


def chart_corners(level) -> np.ndarray:
    return np.concatenate([chart.vertices[chart.triangles] for chart in level.charts if chart is not None])


def open_edges(corners: np.ndarray) -> int:
    """Return how many edges have not as many triangles on each side; positions must be equal to the last bit."""
    _, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    index = index.reshape(-1, 3)
    starts, ends = index.ravel(), np.roll(index, -1, axis=1).ravel()
    sums = np.zeros((index.max() + 1,) * 2, int)
    np.add.at(sums, (starts, ends), 1)
    np.add.at(sums, (ends, starts), -1)
    return int((sums != 0).sum())


@pytest.mark.slow
@pytest.mark.parametrize(("rings", "error"), [pytest.param(24, 0.02, marks=pytest.mark.exhaustive), (12, 0.06)])
def test_a_solid_becomes_a_closed_mesh_within_the_error(rings, error):
    mesh = sphere(rings)
    quads, cloud = build(mesh, error=error, solid_parts="quads").levels[0], build(mesh, error=error)
    (level,) = cloud.levels
    assert all(chart is not None for chart in level.charts)
    corners = chart_corners(level)
    assert open_edges(corners) == 0
    used = mesh.vertices[np.unique(mesh.triangles)]
    assert closest_on_mesh(used, corners)[0].max() <= level.error
    assert closest_on_mesh(corners.reshape(-1, 3), mesh.corners)[0].max() <= 1.25 * level.error
    assert 0.0 < cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0
    assert level.triangle_count == level.chart_triangle_count == len(corners) <= 1.3 * 1.1 * quads.triangle_count
    assert len(level.quads) < len(quads.quads), "charts show more than quads"


@pytest.mark.slow
def test_charts_are_height_fields_within_their_rectangles():
    (level,) = build(sphere(10), error=0.06).levels
    for quad, chart in enumerate(level.charts):
        normals = face_areas_and_normals(chart.vertices[chart.triangles])[1]
        assert (normals @ level.quads.frames[quad, 2]).min() >= 0.5 - 1e-9
        assert np.abs(level.to_cutout(quad, chart.vertices)).max() <= 1.0 + 1e-9
        np.testing.assert_allclose(np.linalg.norm(chart.normals, axis=1), 1.0)


def test_a_spiral_ramp_is_divided_where_it_overlaps_itself():
    angles = np.linspace(0.0, 5.0 * np.pi, 80)
    rail = np.column_stack([np.cos(angles), np.sin(angles), 0.1 * angles])
    vertices = np.concatenate([0.5 * rail * [1.0, 1.0, 2.0], rail])
    inner, outer = np.arange(79), np.arange(79) + 80
    triangles = np.concatenate([np.column_stack([inner, outer, outer + 1]), np.column_stack([inner, outer + 1, inner + 1])])
    placed = divide_into_charts(PartMesh(vertices, triangles))
    assert len(placed) >= 3
    assert np.array_equal(np.sort(np.concatenate([chart.members for chart in placed])), np.arange(len(triangles)))
    for chart in placed:
        flat = (chart.chart.vertices @ chart.axes.T)[chart.chart.triangles]
        centers = flat.mean(axis=1)
        edges = np.roll(flat, -1, axis=1) - flat
        to_center = centers[:, None, None] - flat[None]
        is_inside = (edges[None, ..., 0] * to_center[..., 1] - edges[None, ..., 1] * to_center[..., 0] > 1e-9).all(axis=2)
        assert (is_inside.sum(axis=1) == 1).all()


def test_a_box_is_a_box():
    (level,) = build(box(cuts=4), error=0.01).levels
    assert (len(level.quads), level.triangle_count) == (6, 12)
    chart = level.charts[0]
    np.testing.assert_allclose(chart.normals, np.tile(level.quads.frames[0, 2], (4, 1)), atol=1e-9, err_msg="no normal crosses a crease")


def test_leaves_stay_quads_beside_a_trunk():
    leaf = sheet(1)
    leaves = [TriangleMesh(0.05 * leaf.vertices + [0.3 * i, 0.0, 1.6 + 0.1 * i], leaf.triangles) for i in range(6)]
    trunk = sphere(8)
    mesh = concatenate([trunk, *leaves])
    (level,) = build(mesh, error=0.04).levels
    has_chart = np.array([chart is not None for chart in level.charts])
    is_leaf = np.arange(len(mesh.triangles)) >= len(trunk.triangles)
    assert has_chart[level.quads.owner[~is_leaf]].all() and not has_chart[level.quads.owner[is_leaf]].any()


@pytest.mark.slow
def test_parts_within_the_error_of_a_mesh_are_drawn_on_it():
    """Small bumps on a ball, as bolts on a hull."""
    ball, bolt = bumpy_sphere(8), box(cuts=1)
    corner = ball.vertices[np.abs(ball.vertices[:, 0]).argmax()]
    mesh = concatenate([ball, TriangleMesh(0.002 * bolt.vertices + corner, bolt.triangles)])
    (level,) = build(mesh, error=0.04).levels
    assert all(chart is not None for chart in level.charts)


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"solid_parts": "quads"}, {"nested_levels": True}, {"method": "hough"}])
def test_other_clouds_have_quads_only(settings):
    (level,) = build(sphere(12), error=0.05, **settings).levels
    assert level.charts == [None] * len(level.quads) and level.chart_triangle_count == 0
    assert level.quad_count == len(level.quads)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "budget"),
    [
        ("triangles", 50),
        pytest.param("quads", 12, marks=pytest.mark.exhaustive),
        pytest.param("texture_mb", 0.2, marks=pytest.mark.exhaustive),
    ],
)
def test_budgets_count_charts(name, budget):
    cloud = build(sphere(8), **{name: budget})
    level = cloud.levels[0]
    assert level.chart_triangle_count > 0 and cloud.max_plane_distance <= 1.0
    usage = {"triangles": level.triangle_count, "quads": level.quad_count}
    assert name == "texture_mb" or 0.7 * budget <= usage[name] <= budget


@pytest.mark.slow
def test_a_part_that_needs_too_many_triangles_has_no_mesh():
    mesh = bumpy_sphere(10)
    part = Part(mesh.corners)
    run_to_end(part.prepare(400))
    assert run_to_end(part.simplify(0.002 * longest_side(mesh.vertices), 40)) is None
    coarse = run_to_end(part.simplify(0.1 * longest_side(mesh.vertices), 400))
    assert len(coarse.triangles) < 60


def test_the_near_side_of_a_plate_is_found():
    """Of two parallel triangles, the one that faces the point's direction, though the other is nearer."""
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    corners = np.stack([triangle + [0.0, 0.0, 1.0], triangle[::-1]])
    normals = face_areas_and_normals(corners)[1]
    point, up = np.array([[0.2, 0.2, 0.1]]), np.array([[0.0, 0.0, 1.0]])
    assert find_closest_facing(corners, normals, point, up, 2.0) == [0]
    assert find_closest_facing(corners, normals, point, -up, 2.0) == [1]
    assert find_closest_facing(corners, normals, point, up, 0.5) == [1], "too far"
