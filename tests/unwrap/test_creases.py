"""Islands along creases: shapes whose seams are known, doubled vertices, bevels, long rims, and where seams may lie."""

import numpy as np
import pytest

from charts import urchin
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate, scaled_normals
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.creases import find_creases, fold_angles
from farfield.addon.core.unwrap.cutting.welding import pair_doubled_edges
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import UnwrapResult, unwrap
from shapes import box, cylinder, sheet, sphere

pytestmark = pytest.mark.usefixtures("coarse_packing")
BRACKET = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.4], [0.4, 0.4], [0.4, 2.0], [0.0, 2.0]])
BRACKET_TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]


def unwrap_mesh(mesh: TriangleMesh, importance: np.ndarray | None = None, **settings) -> UnwrapResult:
    count = len(mesh.triangles)
    importance = np.zeros(count) if importance is None else importance
    result = run_to_end(unwrap(mesh, np.arange(count), np.zeros((0, 2), int), importance, UnwrapSettings(**settings)))
    assert result.metrics.flips == result.metrics.overlaps == 0
    return result


def merged(mesh: TriangleMesh) -> TriangleMesh:
    """The same surface without doubled vertices."""
    vertices, indices = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    return TriangleMesh(vertices, indices.reshape(-1)[mesh.triangles].astype(np.int32))


def find_seams(mesh: TriangleMesh, corner_uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of halfedges where the map is cut, and the lengths of their edges; `mesh` has no doubled vertices."""
    halfedges = find_edges(mesh.triangles).interior_halfedges
    (first, second), corners = (halfedges // 3).T, halfedges % 3
    sides = [(first, (corners[:, 0] + k) % 3, second, (corners[:, 1] + 3 - k) % 3) for k in (1, 2)]
    is_cut = np.any([np.abs(corner_uvs[a, b] - corner_uvs[c, d]).max(axis=1) > 1e-6 for a, b, c, d in sides], axis=0)
    ends = [mesh.vertices[mesh.triangles[a, b]] for a, b, _, _ in sides]
    return halfedges[is_cut], np.linalg.norm(ends[0] - ends[1], axis=1)[is_cut]


def extrude(polygon: np.ndarray, polygon_triangles: list, height: float) -> TriangleMesh:
    count, bottom = len(polygon), np.array(polygon_triangles)
    vertices = np.concatenate([np.column_stack([polygon, np.full(count, z)]) for z in (0.0, height)])
    here, following = np.arange(count), (np.arange(count) + 1) % count
    sides = np.concatenate([np.stack([here, following, following + count], 1), np.stack([here, following + count, here + count], 1)])
    return TriangleMesh(vertices, np.concatenate([bottom[:, ::-1], bottom + count, sides]).astype(np.int32))


def test_a_cube_becomes_two_strips_of_three_faces():
    """Two more faces in a strip would not fit into the square as well."""
    cube = merged(box(cuts=2))
    result = unwrap_mesh(cube)
    assert result.chart_count == 2
    assert find_seams(cube, result.corner_uvs)[1].sum() == pytest.approx(8.0)
    assert result.metrics.symmetric_dirichlet == pytest.approx(4.0) and result.metrics.fill > 0.62


def test_doubled_vertices_count_as_one():
    doubled = box(cuts=2)
    result, expected = unwrap_mesh(doubled), unwrap_mesh(merged(doubled))
    assert result.chart_count == expected.chart_count == 2
    assert len(find_seams(merged(doubled), result.corner_uvs)[1]) == len(find_seams(merged(doubled), expected.corner_uvs)[1])


def test_xatlas_cuts_a_box_with_and_without_doubled_vertices_alike():
    doubled = box(cuts=2)
    assert unwrap_mesh(doubled, islands="atlas").chart_count == unwrap_mesh(merged(doubled), islands="atlas").chart_count == 6


def test_vertices_are_welded_within_a_tolerance_only():
    one, other = sheet(2), sheet(2)
    for distance, count in ((1e-8, 2), (1e-3, 0)):
        both = concatenate([one, TriangleMesh(other.vertices + [1.0 + distance, 0.0, 0.0], other.triangles)])
        assert len(pair_doubled_edges(both.vertices, both.triangles, find_edges(both.triangles))) == count


def test_both_sides_of_a_card_stay_separate():
    front = sheet(3)
    card = concatenate([front, TriangleMesh(front.vertices, front.triangles[:, ::-1])])
    assert len(pair_doubled_edges(card.vertices, card.triangles, find_edges(card.triangles))) == 0
    assert unwrap_mesh(card).chart_count == 2


def test_a_cylinder_becomes_a_strip_and_two_caps():
    sides = 48
    circle = np.column_stack([np.cos(2.0 * np.pi * np.arange(sides) / sides), np.sin(2.0 * np.pi * np.arange(sides) / sides)])
    mesh = extrude(circle, [[0, index, index + 1] for index in range(1, sides - 1)], 3.0)
    result = unwrap_mesh(mesh)
    perimeter = sides * 2.0 * np.sin(np.pi / sides)
    assert result.chart_count == 3
    assert find_seams(mesh, result.corner_uvs)[1].sum() == pytest.approx(2.0 * perimeter + 3.0)
    assert result.metrics.symmetric_dirichlet == pytest.approx(4.0, abs=1e-4)


def test_seams_of_a_bracket_are_creases():
    mesh = extrude(BRACKET, BRACKET_TRIANGLES, 1.0)
    halfedges, lengths = find_seams(mesh, unwrap_mesh(mesh).corner_uvs)
    assert len(lengths) > 0
    assert fold_angles(mesh.vertices, mesh.triangles, halfedges) == pytest.approx(0.5 * np.pi)
    total = 2.0 * np.linalg.norm(np.roll(BRACKET, -1, axis=0) - BRACKET, axis=1).sum() + 6.0
    assert lengths.sum() < 0.7 * total


def test_a_weak_fold_is_a_crease_only_where_it_continues_one():
    x = np.arange(5.0)
    for second_fold, is_crease in ((30.0, True), (10.0, False)):
        folds = np.radians([50.0, 50.0, second_fold, second_fold])
        ridge = np.column_stack([x, 0.0 * x, 0.0 * x])
        left = ridge + [0.0, 1.0, 0.0]
        right = np.column_stack([x, -np.cos(np.append(folds, folds[-1])), -np.sin(np.append(folds, folds[-1]))])
        triangles = []
        for index in range(4):  # A wing on each side of every edge of the ridge.
            triangles += [[index, index + 1, 5 + index], [index + 1, index, 10 + index]]
        vertices, halfedges = np.concatenate([ridge, left, right]), find_edges(np.array(triangles)).interior_halfedges
        assert find_creases(vertices, np.array(triangles), halfedges).tolist() == [True, True, is_crease, is_crease]


@pytest.mark.slow
def test_a_long_thin_strip_does_not_determine_the_scale():
    """The side of a flat drum is 60 times as long as it is high, and cut into pieces no longer than the drum is wide."""
    sides = 96
    circle = 10.0 * np.column_stack([np.cos(2.0 * np.pi * np.arange(sides) / sides), np.sin(2.0 * np.pi * np.arange(sides) / sides)])
    mesh = extrude(circle, [[0, index, index + 1] for index in range(1, sides - 1)], 1.0)
    assert unwrap_mesh(mesh).metrics.fill > 0.35


@pytest.mark.parametrize(
    ("mesh", "max_seam"),
    [(sphere(12), 3.5), pytest.param(urchin(), 30.0, marks=pytest.mark.exhaustive)],
    ids=["sphere", "urchin"],
)
def test_closed_surfaces_without_creases_have_little_distortion(mesh, max_seam):
    result = unwrap_mesh(mesh)
    assert result.metrics.symmetric_dirichlet < 4.15 and result.metrics.needles < 0.005
    area = 0.5 * np.linalg.norm(np.cross(*np.diff(mesh.corners, axis=1).transpose(1, 0, 2)), axis=1).sum()
    assert find_seams(mesh, result.corner_uvs)[1].sum() < max_seam * np.sqrt(area)


def test_one_island_per_part_stays_a_choice():
    assert unwrap_mesh(merged(box(cuts=4)), islands="one").chart_count == 1


def test_a_tube_with_open_ends_is_one_strip():
    mesh = cylinder()
    result = unwrap_mesh(mesh)
    assert result.chart_count == 1
    assert find_seams(mesh, result.corner_uvs)[1].sum() == pytest.approx(2.0)


def texel_densities(mesh: TriangleMesh, corner_uvs: np.ndarray) -> np.ndarray:
    """Area in the map over area on the surface (T,)."""
    return np.abs(signed_areas(corner_uvs)) / (0.5 * np.linalg.norm(scaled_normals(mesh.corners), axis=1))


def test_important_faces_of_a_box_get_exactly_their_density_along_creases():
    mesh = merged(box((2.0, 1.0, 1.0), cuts=2))
    is_important = scaled_normals(mesh.corners)[:, 2] > 0.0
    result = unwrap_mesh(mesh, is_important.astype(float), density_ratio=9.0)
    densities = texel_densities(mesh, result.corner_uvs)
    assert densities[is_important] == pytest.approx(9.0 * densities[~is_important].mean())
    halfedges, _ = find_seams(mesh, result.corner_uvs)
    assert fold_angles(mesh.vertices, mesh.triangles, halfedges) == pytest.approx(0.5 * np.pi)
    assert 2 <= result.chart_count <= 4


def test_density_varies_inside_of_an_island_along_creases():
    mesh = merged(box((1.0, 1.0, 3.0), cuts=6))
    importance = mesh.corners[..., 2].mean(axis=1) / 3.0 + 0.5
    result = unwrap_mesh(mesh, importance, density_ratio=4.0)
    densities = texel_densities(mesh, result.corner_uvs)
    assert 2.5 < densities[importance > 0.9].mean() / densities[importance < 0.1].mean() < 5.0


@pytest.mark.slow
def test_equal_importance_everywhere_changes_nothing():
    mesh = merged(box(cuts=2))
    important = unwrap_mesh(mesh, np.ones(len(mesh.triangles)))
    np.testing.assert_allclose(important.corner_uvs, unwrap_mesh(mesh).corner_uvs, atol=1e-9)
