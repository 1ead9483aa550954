"""Tests of the decimation: it keeps its bounds for every point of the fine mesh, and flat input gives one quad."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.decimation.decimate import decimate_to_error, propose_mesh
from farfield.addon.core.billboards.decimation.edge_operations import evaluate_collapses, flip_edges
from farfield.addon.core.billboards.decimation.reference_mesh import DecimatedMesh
from farfield.addon.core.billboards.decimation.triangle_patches import find_flat_regions
from farfield.addon.core.billboards.decimation.vertex_fit import fit_vertices
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.distance import TriangleTree, bound_hausdorff, closest_on_mesh
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.tracked_points import TrackedPoints
from farfield.addon.core.jobs.progress import run_to_end
from shapes import random_rotation

BOUND = np.radians(60.0)


def sphere(rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Return a closed unit sphere of rings x 2 rings quads, triangulated."""
    sides = 2 * rings
    polar = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    azimuth = 2.0 * np.pi * np.arange(sides) / sides
    sines, ones = np.sin(polar), np.ones(sides)
    inner = np.stack([np.outer(sines, np.cos(azimuth)), np.outer(sines, np.sin(azimuth)), np.outer(np.cos(polar), ones)], axis=2)
    inner = inner.reshape(-1, 3)
    vertices = np.concatenate([inner, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    here, following = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for ring in range(rings - 2):
        upper, lower = ring * sides, (ring + 1) * sides
        faces.append(np.stack([upper + here, lower + here, lower + following], axis=1))
        faces.append(np.stack([upper + here, lower + following, upper + following], axis=1))
    last = (rings - 2) * sides
    faces.append(np.stack([np.full(sides, len(inner)), here, following], axis=1))
    faces.append(np.stack([np.full(sides, len(inner) + 1), last + following, last + here], axis=1))
    return vertices, np.concatenate(faces).astype(np.int32)


def sheet(side: int, height) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0.0, 1.0, side + 1), np.linspace(0.0, 1.0, side + 1), indexing="ij")
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return np.stack([x, y, height(x, y)], axis=2).reshape(-1, 3), triangles


def check_bounds(decimated: DecimatedMesh, vertices: np.ndarray, triangles: np.ndarray, error: float) -> None:
    """Check all bounds that a decimated mesh promises."""
    assert len(decimated.unassigned) <= 0.25 * len(decimated.triangles)
    coarse = decimated.vertices[decimated.triangles]
    _, normals = face_areas_and_normals(coarse)
    is_assigned = decimated.assignment >= 0
    assignment, triangles = decimated.assignment[is_assigned], triangles[is_assigned]
    heights = np.einsum("tci,ti->tc", vertices[triangles] - coarse[assignment][:, :1], normals[assignment])
    assert np.abs(heights).max() <= error * (1.0 + 1e-9)
    assert closest_on_mesh(vertices[triangles].reshape(-1, 3), coarse)[0].max() <= error * (1.0 + 1e-9)
    assert bound_hausdorff(vertices[triangles], TriangleTree(coarse), 0.001 * error)[1] <= 1.002 * error
    areas, fine_normals = face_areas_and_normals(vertices[triangles])
    is_violating = np.einsum("ij,ij->i", fine_normals, normals[assignment]) < np.cos(BOUND)
    assert decimated.normal_violations == is_violating.sum()
    assert areas[is_violating].sum() <= 0.021 * areas.sum()


def test_flat_sheet_becomes_few_triangles():
    vertices, triangles = sheet(3, lambda x, y: 0.3 * x - 0.1 * y)
    decimated = run_to_end(decimate_to_error(vertices, triangles, 0.01, BOUND))
    check_bounds(decimated, vertices, triangles, 0.01)
    assert len(decimated.triangles) <= 4


@pytest.mark.slow
def test_triangles_of_sphere_follow_from_curvature():
    """A triangle on both sides of a sphere may have edges of sqrt(12 r e), so an area of 4 pi r^2 needs about 2.4 r / e triangles."""
    vertices, triangles = sphere(5)
    unit, error = 1e-4, 0.2
    decimated = run_to_end(decimate_to_error(unit * vertices, triangles, unit * error, BOUND))
    check_bounds(decimated, unit * vertices, triangles, unit * error)
    assert 0.8 * 2.4 / error <= len(decimated.triangles) <= 2.0 * 2.4 / error
    area = face_areas_and_normals(decimated.vertices[decimated.triangles])[0].sum() / unit**2
    assert area == pytest.approx(face_areas_and_normals(vertices[triangles])[0].sum(), rel=0.1)


@pytest.mark.slow
def test_duplicate_and_non_manifold_faces_are_allowed():
    vertices, triangles = sheet(4, lambda x, y: 0.1 * np.sin(6.0 * x + y))
    fin = np.array([[0.5, 0.0, 0.5], [0.5, 1.0, 0.5]])
    extra = np.array([[12, 17, len(vertices)], [12, 17, len(vertices) + 1]], np.int32)
    soup = np.concatenate([triangles, triangles[:7], extra])
    points = np.concatenate([vertices, fin])
    decimated = run_to_end(decimate_to_error(points, soup, 0.03, BOUND))
    check_bounds(decimated, points, soup, 0.03)


def test_returns_fine_mesh_if_no_coarser_one_satisfies_bounds():
    vertices, triangles = sheet(4, lambda x, y: np.sin(9.0 * x) * np.cos(8.0 * y))
    decimated = run_to_end(decimate_to_error(vertices, triangles, 1e-7, BOUND))
    check_bounds(decimated, vertices, triangles, 1e-7)
    assert len(decimated.triangles) == len(triangles)
    assert len(decimated.unassigned) == 0


def build_with_decimation(vertices: np.ndarray, triangles: np.ndarray, error: float) -> Cloud:
    return run_to_end(build_cloud(TriangleMesh(vertices, triangles), BillboardSettings(method="decimate", error=error, levels=1)))


def disc(sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a planar disc, a fan of `sides` triangles around its center."""
    azimuth = 2.0 * np.pi * np.arange(sides) / sides
    boundary = np.stack([np.cos(azimuth), np.sin(azimuth), 0.3 * np.cos(azimuth)], axis=1)
    here = np.arange(sides)
    return np.vstack([boundary, np.zeros(3)]), np.stack([here, np.roll(here, -1), np.full(sides, sides)], axis=1).astype(np.int32)


@pytest.mark.parametrize("flat", [sheet(7, lambda x, y: 0.2 * x + 0.1 * y), disc(40)], ids=["square", "disc"])
def test_flat_input_gives_one_quad(flat):
    level = build_with_decimation(*flat, 0.01).levels[0]
    assert len(level.quads) == 1


@st.composite
def flat_meshes(draw) -> TriangleMesh:
    """Discs and sheets of random proportions, in random planes, at random scales, in double or single precision."""
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    if draw(st.booleans()):
        vertices, triangles = disc(draw(st.integers(3, 60)))
    else:
        vertices, triangles = sheet(draw(st.integers(1, 8)), lambda x, y: 0.0 * (x + y))
    vertices = vertices * [1.0, random.uniform(0.2, 1.0), 1.0]
    gradient = random.normal(size=2)
    vertices[:, 2] = vertices[:, :2] @ gradient
    vertices = 10.0 ** draw(st.floats(-4.0, 4.0)) * vertices @ random_rotation(seed).T
    vertices = vertices + draw(st.sampled_from([0.0, 1.0, 10.0])) * np.ptp(vertices) * random.normal(size=3)
    precision = draw(st.sampled_from([np.float32, np.float64]))
    return TriangleMesh(vertices.astype(precision).astype(np.float64), triangles)


@settings(max_examples=40)
@given(flat_meshes(), st.floats(0.001, 0.2))
def test_flat_input_gives_one_quad_whatever_the_rounding(mesh, error):
    (level,) = build_with_decimation(mesh.vertices, mesh.triangles, error).levels
    assert len(level.quads) == 1
    np.testing.assert_array_equal(level.quads.drawn, np.arange(len(mesh.triangles)))
    plane = (mesh.vertices - level.quads.centers[0]) @ level.quads.frames[0, 2]
    assert np.abs(plane).max() <= 1e-2 * level.error


def test_front_and_back_of_flat_sheet_are_two_quads():
    vertices, triangles = sheet(4, lambda x, y: 0.2 * x + 0.1 * y)
    (level,) = build_with_decimation(vertices, np.concatenate([triangles, triangles[:, ::-1]]), 0.01).levels
    assert len(level.quads) == 2
    np.testing.assert_array_equal(level.quads.owner[: len(triangles)] == level.quads.owner[0], np.ones(len(triangles), bool))
    assert level.quads.frames[0, 2] @ level.quads.frames[1, 2] == pytest.approx(-1.0)


@pytest.mark.slow
def test_thin_flat_frame_is_not_one_quad():
    """One quad around a thin square frame would be almost empty."""
    outer = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    inner = 0.5 + 0.98 * (outer - 0.5) * [1.0, 1.0, 0.0] - [0.0, 0.0, 0.5]
    here, following = np.arange(4), (np.arange(4) + 1) % 4
    triangles = np.concatenate([np.stack([here, following, following + 4], axis=1), np.stack([here, following + 4, here + 4], axis=1)])
    (level,) = build_with_decimation(np.concatenate([outer, inner]), triangles.astype(np.int32), 0.001).levels
    assert len(level.quads) >= 4
    assert level.texel_count * level.texel_size**2 < 0.2


def test_box_gives_one_quad_per_side():
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([[a, b, c] for a, b, c, d in quads] + [[a, c, d] for a, b, c, d in quads], np.int32)
    level = build_with_decimation(corners, triangles, 0.01).levels[0]
    assert len(level.quads) == 6
    np.testing.assert_allclose(sorted(4.0 * level.quads.half_sizes.prod(axis=1)), [2.0, 2.0, 3.0, 3.0, 6.0, 6.0], rtol=0.05)


def test_flat_regions_are_connected_by_edges():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.001], [2.0, 0.0, 1.0], [2.0, 1.0, 1.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], np.int32)
    for tolerance, labels in ((0.01, [0, 0, 1, 1]), (1e-5, [0, 1, 2, 2])):
        np.testing.assert_array_equal(find_flat_regions(vertices, triangles, tolerance), labels)


def test_unassigned_faces_get_their_own_quads():
    """Few triangles can follow long faces across the ridges of a corrugated sheet; all faces are still shown within the error."""
    vertices, triangles = sheet(5, lambda x, y: 0.08 * np.abs((5.0 * x + 2.0 * y) % 1.0 - 0.5))
    cloud = build_with_decimation(vertices, triangles, 0.015)
    assert cloud.uncovered_faces == 0
    assert cloud.max_plane_distance <= 1.0


def test_vertex_fit_halves_distance_of_inscribed_mesh():
    vertices, triangles = sphere()
    coarse, faces = propose_mesh(vertices, triangles, 150)
    before = closest_on_mesh(vertices, coarse[faces])[0].max()
    after = closest_on_mesh(vertices, fit_vertices(TrackedPoints(vertices, 0.01), coarse, faces, (2.0, 3.0, 4.0, 4.0))[faces])[0].max()
    assert after <= 0.65 * before


def test_collapses_keep_their_cost_limit_and_the_topology():
    vertices, triangles = sphere(10)
    coarse, faces = evaluate_collapses(vertices, vertices, triangles).apply(vertices, triangles, 0.08, 40)
    assert len(faces) < len(triangles)
    assert closest_on_mesh(vertices, coarse[faces])[0].max() <= 0.08 * (1.0 + 1e-9)
    edges = find_edges(faces)
    assert (edges.face_counts == 2).all()
    assert len(coarse) - len(edges.ends) + len(faces) == 2


def test_flip_moves_edge_into_valley():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]])
    along = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    across = np.array([[0, 1, 3], [1, 2, 3]], np.int32)
    random = np.random.default_rng(0)
    barycentric = random.dirichlet(np.ones(3), 300)
    samples = np.einsum("sk,tkj->tsj", barycentric, vertices[across]).reshape(-1, 3)
    flipped = flip_edges(samples, vertices, along, 1e-3)
    assert {frozenset(face) for face in flipped.tolist()} == {frozenset(face) for face in across.tolist()}
    np.testing.assert_array_equal(flip_edges(samples, vertices, flipped, 1e-3), flipped)
