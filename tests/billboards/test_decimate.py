"""Simplification keeps its measured bound, from every point of the original and to the plane of every triangle's stand-in."""

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.decimate import decimate_to_error, propose
from farfield.addon.core.billboards.fine_mesh import Decimated
from farfield.addon.core.billboards.remesh import flip, judge_collapses
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.billboards.straddle import straddle
from farfield.addon.core.billboards.triangles import flat_parts
from farfield.addon.core.distance import closest_on_mesh, one_sided_distance
from farfield.addon.core.edges import edges_of
from farfield.addon.core.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.progress import finish

BOUND = np.radians(60.0)


def sphere(rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A closed unit sphere of rings x 2 rings quads in triangles."""
    sides = 2 * rings
    polar = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    turn = 2.0 * np.pi * np.arange(sides) / sides
    inner = np.stack(
        [np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn)), np.outer(np.cos(polar), np.ones(sides))], axis=2
    ).reshape(-1, 3)
    vertices = np.concatenate([inner, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    around, next_around = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for ring in range(rings - 2):
        upper, lower = ring * sides, (ring + 1) * sides
        faces.append(np.stack([upper + around, lower + around, lower + next_around], axis=1))
        faces.append(np.stack([upper + around, lower + next_around, upper + next_around], axis=1))
    last = (rings - 2) * sides
    faces.append(np.stack([np.full(sides, len(inner)), around, next_around], axis=1))
    faces.append(np.stack([np.full(sides, len(inner) + 1), last + next_around, last + around], axis=1))
    return vertices, np.concatenate(faces).astype(np.int32)


def sheet(side: int, height) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0.0, 1.0, side + 1), np.linspace(0.0, 1.0, side + 1), indexing="ij")
    index = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return np.stack([x, y, height(x, y)], axis=2).reshape(-1, 3), triangles


def check_promises(found: Decimated, vertices: np.ndarray, triangles: np.ndarray, error: float) -> None:
    assert len(found.apart) <= 0.25 * len(found.triangles)
    coarse = found.vertices[found.triangles]
    _, normals = face_areas_and_normals(coarse)
    kept = found.primitive_of >= 0
    of, triangles = found.primitive_of[kept], triangles[kept]
    heights = np.einsum("tci,ti->tc", vertices[triangles] - coarse[of][:, :1], normals[of])
    assert np.abs(heights).max() <= error * (1.0 + 1e-9)
    assert closest_on_mesh(vertices[triangles].reshape(-1, 3), coarse)[0].max() <= error * (1.0 + 1e-9)
    assert one_sided_distance(vertices[triangles], coarse, 0.001 * error) <= found.distance + 0.002 * error <= error * 1.002
    areas, original = face_areas_and_normals(vertices[triangles])
    turned = np.einsum("ij,ij->i", original, normals[of]) < np.cos(BOUND)
    assert found.beyond == turned.sum()
    assert areas[turned].sum() <= 0.021 * areas.sum()


def test_a_flat_sheet_becomes_a_few_triangles():
    vertices, triangles = sheet(12, lambda x, y: 0.3 * x - 0.1 * y)
    found = finish(decimate_to_error(vertices, triangles, 0.01, BOUND))
    check_promises(found, vertices, triangles, 0.01)
    assert len(found.triangles) <= 4


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_a_sphere_needs_about_what_its_curvature_says(unit):
    """A triangle that straddles the sphere bears edges of sqrt(12 r e), so 4 pi r^2 of it take about 2.4 r / e triangles."""
    vertices, triangles = sphere(14)
    error = 0.08
    found = finish(decimate_to_error(unit * vertices, triangles, unit * error, BOUND))
    check_promises(found, unit * vertices, triangles, unit * error)
    assert 0.8 * 2.4 / error <= len(found.triangles) <= 2.0 * 2.4 / error
    area = face_areas_and_normals(found.vertices[found.triangles])[0].sum() / unit**2
    assert area == pytest.approx(4.0 * np.pi, rel=0.1)


def test_duplicate_and_non_manifold_faces_are_fine():
    vertices, triangles = sheet(10, lambda x, y: 0.1 * np.sin(6.0 * x + y))
    fin = np.array([[0.5, 0.0, 0.5], [0.5, 1.0, 0.5]])
    extra = np.array([[55, 65, len(vertices)], [55, 65, len(vertices) + 1]], np.int32)
    soup = np.concatenate([triangles, triangles[:7], extra])
    points = np.concatenate([vertices, fin])
    found = finish(decimate_to_error(points, soup, 0.03, BOUND))
    check_promises(found, points, soup, 0.03)


def test_where_nothing_coarser_holds_the_original_stands():
    vertices, triangles = sheet(4, lambda x, y: np.sin(9.0 * x) * np.cos(8.0 * y))
    found = finish(decimate_to_error(vertices, triangles, 1e-7, BOUND))
    check_promises(found, vertices, triangles, 1e-7)
    assert len(found.triangles) == len(triangles)
    assert len(found.apart) == 0


def built(vertices: np.ndarray, triangles: np.ndarray, error: float) -> Cloud:
    return finish(build(TriangleMesh(vertices, triangles), BillboardSettings(method="decimate", error=error, levels=1)))


def disc(sides: int) -> tuple[np.ndarray, np.ndarray]:
    turn = 2.0 * np.pi * np.arange(sides) / sides
    rim = np.stack([np.cos(turn), np.sin(turn), 0.3 * np.cos(turn)], axis=1)
    around = np.arange(sides)
    return np.vstack([rim, np.zeros(3)]), np.stack([around, np.roll(around, -1), np.full(sides, sides)], axis=1).astype(np.int32)


@pytest.mark.parametrize("flat", [sheet(7, lambda x, y: 0.2 * x + 0.1 * y), disc(40)], ids=["square", "disc"])
def test_what_lies_in_one_plane_is_one_quad(flat):
    level = built(*flat, 0.01).levels[0]
    assert len(level.quads) == 1


def test_the_sides_of_a_box_are_one_quad_each():
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([[a, b, c] for a, b, c, d in quads] + [[a, c, d] for a, b, c, d in quads], np.int32)
    level = built(corners, triangles, 0.01).levels[0]
    assert len(level.quads) == 6
    np.testing.assert_allclose(sorted(4.0 * level.quads.half_sizes.prod(axis=1)), [2.0, 2.0, 3.0, 3.0, 6.0, 6.0], rtol=0.05)


def test_a_plane_is_flat_over_its_edges_alone():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.001], [2.0, 0.0, 1.0], [2.0, 1.0, 1.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], np.int32)
    for tolerance, parts in ((0.01, [0, 0, 1, 1]), (1e-5, [0, 1, 2, 2])):
        np.testing.assert_array_equal(flat_parts(vertices, triangles, tolerance), parts)


def test_faces_that_no_triangle_keeps_get_quads_of_their_own():
    """Long faces across the ridges of a corrugated sheet: few triangles can follow, and every face is still shown within the error."""
    vertices, triangles = sheet(10, lambda x, y: 0.08 * np.abs((5.0 * x + 2.0 * y) % 1.0 - 0.5))
    cloud = built(vertices, triangles, 0.02)
    assert cloud.uncovered_faces == 0
    assert cloud.max_plane_distance <= 1.0


def test_moving_vertices_halves_the_distance_of_an_inscribed_mesh():
    vertices, triangles = sphere()
    coarse, faces = propose(vertices, triangles, 150)
    before = closest_on_mesh(vertices, coarse[faces])[0].max()
    after = closest_on_mesh(vertices, straddle(vertices, coarse, faces, (2.0, 3.0, 4.0, 4.0))[faces])[0].max()
    assert after <= 0.65 * before


def test_a_collapse_keeps_its_limit_and_the_topology():
    vertices, triangles = sphere(10)
    coarse, faces = judge_collapses(vertices, vertices, triangles).carry_out(vertices, triangles, 0.08, 40)
    assert len(faces) < len(triangles)
    assert closest_on_mesh(vertices, coarse[faces])[0].max() <= 0.08 * (1.0 + 1e-9)
    edges = edges_of(faces)
    assert (edges.uses == 2).all()
    assert len(coarse) - len(edges.ends) + len(faces) == 2


def test_a_flip_turns_the_edge_across_a_valley():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]])
    along = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    across = np.array([[0, 1, 3], [1, 2, 3]], np.int32)
    random = np.random.default_rng(0)
    shares = random.dirichlet(np.ones(3), 300)
    samples = np.einsum("sk,tkj->tsj", shares, vertices[across]).reshape(-1, 3)
    flipped = flip(samples, vertices, along, 1e-3)
    assert {frozenset(face) for face in flipped.tolist()} == {frozenset(face) for face in across.tolist()}
    np.testing.assert_array_equal(flip(samples, vertices, flipped, 1e-3), flipped)
