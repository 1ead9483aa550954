"""Simplification whose collapses seams, hard edges and orientations do not stop, because their costs count."""

import numpy as np
import pytest

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.deviation_quadrics import DeviationQuadrics
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.engine import CollapseEngine
from farfield.addon.core.texmesh.simplification.levels import SubsetLevel, extract_level, simplify_by_cost
from farfield.addon.core.texmesh.simplification.removal_orders import TextureQuadrics
from farfield.addon.core.texmesh.simplification.topology import orient_alike
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh, merge_wedges
from textured_models import check_no_flips, plane, torus

CHOSEN = TexmeshSettings(drastic_simplification=False)


def simplify(mesh: TexturedMesh, target: int) -> TexturedMesh:
    level = run_to_end(simplify_by_cost(mesh, None, [target], CHOSEN)).levels[0]
    assert level.constraint == ""
    if mesh.attributes.shape[1] == 0:
        check_no_flips(mesh, level)
    return extract_level(mesh, level)


def deviate(mesh: TexturedMesh, level: TexturedMesh) -> float:
    return float(closest_on_mesh(mesh.vertices, level.vertices[level.triangles])[0].max())


@pytest.mark.slow
@pytest.mark.parametrize("islands", [40, pytest.param(200, marks=pytest.mark.exhaustive)])
def test_many_islands_do_not_stop_the_collapses(islands):
    mesh = torus(islands=islands, has_materials=True)
    level = simplify(mesh, len(mesh.triangles) // 20)
    edges = find_edges(level.triangles)
    assert (edges.face_counts == 2).all() and len(level.vertices) == len(level.triangles) // 2  # a torus still
    assert deviate(mesh, level) < 1.5 * deviate(mesh, simplify(torus(islands=1), len(mesh.triangles) // 20))


def test_corners_have_texture_coordinates_of_their_islands_and_materials():
    mesh = torus(islands=40, has_materials=True)
    level = simplify(mesh, len(mesh.triangles) // 20)
    fine, coarse = (
        set(zip(*item.corner_uvs.reshape(-1, 2).T.tolist(), np.repeat(item.materials, 3).tolist(), strict=True)) for item in (mesh, level)
    )
    assert coarse <= fine
    np.testing.assert_array_equal(level.wedge_vertices[level.wedge_triangles], level.triangles)


def test_seams_stay_where_they_are_as_long_as_that_costs_little():
    """The border of an island within a flat sheet is straight, so that no triangle needs to leave it."""
    mesh = plane(8, 8)
    is_right = mesh.vertices[mesh.triangles][..., 0].mean(axis=1) > 4.0
    mesh = build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles), mesh.corner_uvs + 3.0 * is_right[:, None, None])
    level = simplify(mesh, 8)
    corners = level.vertices[level.triangles]
    is_right = level.corner_uvs[..., 0].mean(axis=1) > 3.0
    assert (corners[is_right][..., 0] >= 4.0).all() and (corners[~is_right][..., 0] <= 4.0).all()
    np.testing.assert_allclose(level.corner_uvs[..., 0] - 3.0 * is_right[:, None], corners[..., 0] / 100.0, atol=1e-12)


def test_hard_edges_do_not_stop_the_collapses():
    smooth = torus(24, 12, 1)
    normals = face_areas_and_normals(smooth.vertices[smooth.triangles])[1]
    base = TriangleMesh(smooth.vertices, smooth.triangles)
    mesh = merge_wedges(build_textured_mesh(base, smooth.corner_uvs, np.repeat(normals[:, None], 3, axis=1), has_normals=True))
    assert deviate(mesh, simplify(mesh, 100)) < 1.1 * deviate(smooth, simplify(smooth, 100))


def test_faces_of_mixed_orientation_stay_connected_and_keep_it():
    mesh = torus(24, 12, 1)
    is_turned = np.random.default_rng(0).uniform(size=len(mesh.triangles)) < 0.4
    corners = np.where(is_turned[:, None], [0, 2, 1], [0, 1, 2])
    triangles = np.take_along_axis(mesh.triangles, corners, axis=1)
    np.testing.assert_array_equal(orient_alike(triangles), is_turned)
    uvs = np.take_along_axis(mesh.corner_uvs, corners[..., None], axis=1)
    turned = build_textured_mesh(TriangleMesh(mesh.vertices, triangles), uvs)
    level = extract_level(turned, run_to_end(simplify_by_cost(turned, None, [100], CHOSEN)).levels[0])
    assert len(level.vertices) == len(level.triangles) // 2
    assert 0.2 < orient_alike(level.triangles).mean() < 0.5
    assert deviate(mesh, level) < 1.2 * deviate(mesh, simplify(mesh, 100))


def test_a_moebius_strip_is_left_as_it_is():
    i, j = np.arange(16), (np.arange(16) + 1) % 16
    low, high = 2 * i, 2 * i + 1
    next_low, next_high = np.where(j > 0, 2 * j, 1), np.where(j > 0, 2 * j + 1, 0)
    triangles = np.concatenate([np.stack([low, next_low, high], axis=1), np.stack([high, next_low, next_high], axis=1)])
    assert not orient_alike(triangles).any()


def test_an_island_stays_as_long_as_its_texture_is_larger_than_what_else_would_change():
    """A label on a sheet with waves that are lower than the label is wide."""
    heights = 0.02 * np.sin(np.arange(17.0))[:, None] * np.cos(np.arange(17.0))
    mesh = plane(16, 16, heights)
    uvs, centers = mesh.corner_uvs.copy(), mesh.vertices[mesh.triangles].mean(axis=1)
    uvs[(np.abs(centers[:, :2] - 8.5) < 0.5).all(axis=1)] += 5.0
    level = simplify(build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles), uvs), 40)
    assert (level.corner_uvs > 4.0).any()


def make_cube() -> TexturedMesh:
    """Return a cube with sides of 1 and a corner at the origin, whose faces are islands."""
    corners = np.indices((2, 2, 2)).reshape(3, 8).T.astype(float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    axes = np.abs(face_areas_and_normals(corners[triangles])[1]).argmax(axis=1)
    flat = np.stack([np.delete(face, axis, axis=1) for face, axis in zip(corners[triangles], axes, strict=True)])
    return build_textured_mesh(TriangleMesh(corners, triangles), flat + 9.0 * np.arange(6).repeat(2)[:, None, None])


def test_the_plane_of_an_island_still_costs_when_its_triangles_are_gone():
    """Otherwise the corners of a plank whose end has vanished would slide along it."""
    mesh = make_cube()
    engine, cost = CollapseEngine(mesh, crosses_seams=True), TextureQuadrics(mesh)
    _, collapses = engine.topology.find_collapses(np.array([0]), engine.groups)
    moves = engine.find_moves(collapses)
    before = cost.evaluate(collapses, moves)
    at_end = (mesh.vertices[mesh.triangles][..., 1] == 0.0).all(axis=1)
    rows, corners = np.nonzero(at_end[:, None] & (mesh.triangles == 0))
    cost.drop_wedges(np.unique(mesh.wedge_triangles[rows, corners]), np.array([0]))
    expected = len(rows) * 0.5 / 3.0 * mesh.vertices[collapses.kept, 1]
    assert expected.max() > 0.1
    np.testing.assert_allclose(cost.evaluate(collapses, moves) - before, expected, atol=1e-12)


def record_dropped(mesh: TexturedMesh) -> tuple[SubsetLevel, list[int]]:
    """Return a level of `mesh`, and the wedges that the cost was told to have vanished."""
    dropped: list[int] = []

    class Recorded(DeviationQuadrics):
        def drop_wedges(self, wedges, vertices):
            dropped.extend(wedges.tolist())
            super().drop_wedges(wedges, vertices)

    target = len(mesh.triangles) // 20
    result = run_to_end(simplify_by_cost(mesh, lambda divided, _: Recorded(divided, 1.0), [target], CHOSEN))
    return result.levels[0], dropped


@pytest.mark.slow
def test_wedges_that_vanish_are_found():
    """Collapses drop all wedges but those that remain, and those that others replace: none where no island vanishes."""
    level, dropped = record_dropped(torus(islands=40))
    assert len(set(dropped)) == len(dropped) > 0
    assert not set(dropped) & set(level.wedge_triangles.ravel().tolist())
    assert record_dropped(torus(islands=1))[1] == []
