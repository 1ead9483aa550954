"""Openings that stop the collapses: holes and tunnels are found, and closed where a target needs it."""

import numpy as np
import pytest

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.deviation_quadrics import DeviationQuadrics
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.engine import CollapseEngine
from farfield.addon.core.texmesh.simplification.levels import SubsetLevel, extract_level, simplify_by_cost, simplify_in_order
from farfield.addon.core.texmesh.simplification.openings import choose_tunnels, find_holes, find_loops, find_side
from farfield.addon.core.texmesh.simplification.removal_orders import GivenOrder, ScaleWeightedQuadrics
from farfield.addon.core.texmesh.simplification.topology import BOUNDARY, label_connected
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from textured_models import check_subset, euler_characteristic, torus, uv_signs


def make_part(is_solid: np.ndarray, has_texture: bool) -> TexturedMesh:
    """Return the surface of the cubes `is_solid` (X, Y, Z) bool, a UV island with an area above 0 for each connected plane part."""
    quads, offsets = [], []
    padded = np.pad(is_solid, 1)
    for axis in range(3):
        for step in (-1, 1):
            cubes = np.argwhere(padded & ~np.roll(padded, -step, axis)) - 1
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            first = cubes + (step > 0) * np.eye(3, dtype=int)[axis]
            around = [first, first + u, first + u + v, first + v]
            quads.append(np.stack(around if step > 0 else around[::-1], axis=1))
            depths = np.array([0, 0, 0])
            depths[axis] = 1
            offsets.append(10.0 * (quads[-1] @ depths) + 100.0 * (2 * axis + (step > 0)))
    corners, offset = np.concatenate(quads)[:, [[0, 1, 2], [0, 2, 3]]], np.concatenate(offsets)[:, [[0, 1, 2], [0, 2, 3]]]
    corners, offset = corners.reshape(-1, 3, 3), offset.reshape(-1, 3)
    vertices, triangles = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    _, normals = face_areas_and_normals(corners.astype(float))
    axes = np.abs(normals).argmax(axis=1)
    first, second = ((axes + turn) % 3 for turn in (1, 2))
    rows = np.arange(len(corners))[:, None], np.arange(3)
    uvs = np.stack([corners[(*rows, first[:, None])] * normals.sum(axis=1)[:, None], corners[(*rows, second[:, None])]], axis=2)
    uvs = (uvs + np.stack([offset, 0.0 * offset], axis=2)) if has_texture else np.zeros_like(uvs, float)
    return build_textured_mesh(TriangleMesh(vertices.astype(float), triangles.reshape(-1, 3).astype(np.int32)), uvs)


def block_with_hole(has_texture: bool = False) -> TexturedMesh:
    """Return a block of 7 x 7 x 3 cubes with a hole of 3 x 3 through it."""
    is_solid = np.ones((7, 7, 3), bool)
    is_solid[2:5, 2:5] = False
    return make_part(is_solid, has_texture)


def simplify(mesh: TexturedMesh, targets: list[int], kind: str, drastic: bool = True) -> list[SubsetLevel]:
    chosen = TexmeshSettings(vertices="optimized" if kind == "optimized" else "original", drastic_simplification=drastic)
    if kind == "given":
        steps = simplify_in_order(mesh, np.zeros(len(mesh.vertices)), targets, chosen)
    else:
        costs = {
            "optimized": lambda mesh, _: DeviationQuadrics(mesh, 8.0),
            "scales": lambda mesh, vertices: ScaleWeightedQuadrics(mesh, np.arange(len(vertices)) % 4),
            "quadrics": None,
        }
        steps = simplify_by_cost(mesh, costs[kind], targets, chosen)
    return list(run_to_end(steps).levels)


def check_closed(triangles: np.ndarray) -> None:
    """Check that as many triangles pass each edge in one direction as in the other."""
    edges = np.stack([triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()], axis=1)
    np.testing.assert_array_equal(*(np.sort(pairs[:, 0] * (triangles.max() + 1) + pairs[:, 1]) for pairs in (edges, edges[:, ::-1])))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "target"),
    [("optimized", 24), *((kind, 8) for kind in ("optimized", "quadrics", "scales", "given"))]
    + [pytest.param(kind, 24, marks=pytest.mark.exhaustive) for kind in ("quadrics", "scales", "given")],
)
def test_a_block_with_a_hole_through_it_reaches_its_targets(kind, target):
    """A surface of genus 1 has at least 14 triangles."""
    mesh = block_with_hole()
    assert euler_characteristic(mesh.triangles) == 0
    level = simplify(mesh, [target], kind)[0]
    assert level.constraint == "" and len(level.triangles) <= target
    check_closed(level.triangles)
    check_subset(mesh, level)
    is_closed = any("tunnel was closed" in sentence for sentence in level.drastic_steps)
    assert is_closed if target < 14 else True


def test_triangles_in_tunnels_have_texture_coordinates_that_are_not_flipped():
    mesh = block_with_hole(has_texture=True)
    assert (uv_signs(mesh, mesh.wedge_triangles) == 1).all()
    for level in simplify(mesh, [24, 12, 8], "optimized"):
        assert level.constraint == ""
        check_closed(level.triangles)
        assert (uv_signs(mesh, level.wedge_triangles) == 1).all()
        part = extract_level(mesh, level).vertices
        assert (part >= mesh.vertices.min(axis=0) - 0.5).all() and (part <= mesh.vertices.max(axis=0) + 0.5).all()


@pytest.mark.slow
def test_many_tunnels_are_closed():
    """A plate with 16 holes of different sizes has the genus 16; its surface has at least 64 triangles as long as they are there."""
    is_solid = np.ones((17, 17, 2), bool)
    for x in range(4):
        for y in range(4):
            is_solid[1 + 4 * x : 2 + 4 * x + (x + y) % 3, 1 + 4 * y : 3 + 4 * y] = False
    mesh = make_part(is_solid, has_texture=False)
    assert euler_characteristic(mesh.triangles) == -30
    half, coarse = simplify(mesh, [len(mesh.triangles) // 2, 40], "optimized")
    assert half.constraint == coarse.constraint == ""
    assert half.drastic_steps == () and euler_characteristic(half.triangles) == -30
    check_closed(coarse.triangles)
    assert label_connected(coarse.triangles, len(mesh.vertices)).max() == 0


def test_tunnels_stay_as_long_as_the_target_can_be_reached_without():
    mesh = torus(24, 12, 1)
    plain, drastic = (simplify(mesh, [100], "optimized", is_drastic)[0] for is_drastic in (False, True))
    np.testing.assert_array_equal(plain.triangles, drastic.triangles)
    assert drastic.drastic_steps == () and euler_characteristic(drastic.triangles) == 0


def test_parts_joined_by_a_thin_neck_stay_connected():
    is_solid = np.zeros((4, 4, 11), bool)
    is_solid[:, :, :4] = is_solid[:, :, 7:] = is_solid[1, 1] = True
    mesh = make_part(is_solid, has_texture=False)
    level = simplify(mesh, [8], "optimized")[0]
    assert level.constraint == "" and not any("tunnel" in sentence for sentence in level.drastic_steps)
    check_closed(level.triangles)
    assert euler_characteristic(level.triangles) == 2
    assert label_connected(level.triangles, len(mesh.vertices)).max() == 0


def test_large_holes_are_closed_at_last():
    """A tube has at least six triangles as long as both of its ends are open."""
    rows, columns = 8, 12
    angles = 2.0 * np.pi * np.arange(columns) / columns
    rings = [np.stack([np.cos(angles), np.sin(angles), np.full(columns, 0.5 * row)], axis=1) for row in range(rows)]
    first = (columns * np.arange(rows - 1)[:, None] + np.arange(columns)).ravel()
    second = (columns * np.arange(rows - 1)[:, None] + (np.arange(columns) + 1) % columns).ravel()
    triangles = np.concatenate([np.stack([first, second, second + columns]), np.stack([first, second + columns, first + columns])], axis=1)
    mesh = build_textured_mesh(TriangleMesh(np.concatenate(rings), triangles.T.astype(np.int32)), np.zeros((triangles.shape[1], 3, 2)))
    level = simplify(mesh, [5], "optimized")[0]
    assert level.constraint == "" and any("closed" in sentence for sentence in level.drastic_steps)


def test_the_simplest_components_are_dropped_at_last():
    is_solid = np.zeros((29, 3, 3), bool)
    for index in range(6):
        is_solid[5 * index : 5 * index + 3 + (index == 3)] = True
    mesh = make_part(is_solid, has_texture=False)
    level = simplify(mesh, [12], "optimized")[0]
    assert level.constraint == "" and "3 small components were dropped, 12 triangles." in level.drastic_steps
    assert mesh.vertices[level.triangles, 0].max() > 15.0  # The largest stays.


def number_vertices(mesh: TexturedMesh, vertices: np.ndarray) -> np.ndarray:
    """Return which of `vertices` (V, 3) those of `mesh` are, (V,)."""
    return np.abs(mesh.vertices[:, None] - vertices).sum(axis=2).argmin(axis=1)


def small_torus() -> tuple[TexturedMesh, np.ndarray]:
    """Return a torus of 3 x 3 vertices, two of which have an edge in common unless they are on the same diagonal of one direction, and the
    numbers of its vertices, row by row."""
    row, column = (index.ravel() for index in np.meshgrid(np.arange(3), np.arange(3), indexing="ij"))
    a, b, c, d = ((row + i) % 3 * 3 + (column + j) % 3 for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    angles = 2.0 * np.pi * np.stack([row, column]) / 3.0
    radius = 2.0 + np.cos(angles[1])
    vertices = np.stack([radius * np.cos(angles[0]), radius * np.sin(angles[0]), np.sin(angles[1])], axis=1)
    mesh = build_textured_mesh(TriangleMesh(vertices, triangles), np.zeros((18, 3, 2)))
    return mesh, number_vertices(mesh, vertices)


def test_loops_of_three_edges_are_found():
    """Of the 27 loops of three edges of the small torus, 18 are triangles. The others are tunnels; two without a common vertex go around
    the same one."""
    mesh, numbers = small_torus()
    topology = CollapseEngine(mesh).topology
    loops = find_loops(topology)
    assert loops.shape == (3, 9)
    np.testing.assert_array_equal(topology.ends[loops], topology.starts[loops[[1, 2, 0]]])
    found = {tuple(vertices) for vertices in np.sort(numbers[topology.starts[loops]], axis=0).T.tolist()}
    lines = [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(3)] + [(k, k + 3, k + 6) for k in range(3)]
    assert found == {*lines, (0, 4, 8), (1, 5, 6), (2, 3, 7)}
    for first in range(9):
        chosen = choose_tunnels(topology, loops, (np.arange(9) != first).astype(float), 9)
        np.testing.assert_array_equal(chosen, loops[:, [first]])


def test_a_loop_that_divides_the_surface_is_no_tunnel():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1], [0.3, 0.3, -1]])
    triangles = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 4], [2, 1, 4], [0, 2, 4]], np.int32)
    mesh = build_textured_mesh(TriangleMesh(vertices, triangles), np.zeros((6, 3, 2)))
    topology = CollapseEngine(mesh).topology
    loops = find_loops(topology)
    np.testing.assert_array_equal(np.sort(number_vertices(mesh, vertices)[topology.starts[loops]], axis=0).T, [[0, 1, 2]])
    assert choose_tunnels(topology, loops, np.zeros(1), 1).shape == (3, 0)


def test_a_cut_along_a_tunnel_opens_two_holes_also_at_a_boundary():
    mesh, _ = small_torus()
    missing = mesh.triangles[0]
    engine = CollapseEngine(mesh)
    engine.keep_triangles(np.arange(18) > 0)
    loops = find_loops(engine.topology)
    assert np.isin(engine.topology.starts[loops], missing).any(axis=0).sum() >= 3
    for loop in loops.T:
        engine = CollapseEngine(mesh)
        engine.keep_triangles(np.arange(18) > 0)
        engine.divide(find_side(engine.topology, loop[:, None]), GivenOrder(engine.surface.positions, np.zeros(9), 0.0))
        assert len(engine.fine_vertices) == 12 and np.count_nonzero(engine.topology.twins == BOUNDARY) == 3 + 6
        np.testing.assert_array_equal(engine.mesh.vertices, mesh.vertices[engine.fine_vertices])
        np.testing.assert_array_equal(engine.mesh.wedge_vertices[engine.wedges], engine.triangles)
        assert find_edges(engine.triangles.T).face_counts.max() == 2


def test_holes_of_three_edges_are_found():
    engine = CollapseEngine(small_torus()[0])
    corners = engine.triangles[:, 0]
    engine.keep_triangles(np.arange(18) > 0)
    holes = find_holes(engine.topology)
    assert holes.shape == (3, 1)
    vertices = engine.topology.starts[holes[:, 0]]
    assert [tuple(np.roll(corners, turn)) for turn in range(3)].count(tuple(vertices)) == 1


@pytest.mark.slow
def test_small_holes_are_closed_before_they_become_slits():
    """Only the 25 narrow holes of a plate are closed, and not the four wide ones, although all could stay."""
    is_solid = np.ones((41, 41, 4), bool)
    is_solid[4:40:8, 4:40:8] = False
    for x, y in ((7, 7), (7, 31), (31, 7), (31, 31)):
        is_solid[x : x + 3, y : y + 3] = False
    (level,) = simplify(make_part(is_solid, has_texture=False), [400], "optimized")
    assert level.drastic_steps == ("25 tunnels were closed.",)
