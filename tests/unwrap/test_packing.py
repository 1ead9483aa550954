"""Packing and xatlas: charts keep their shapes, do not overlap, and neither size nor extreme proportions take long."""

import numpy as np
import pytest

from charts import torus
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate, scaled_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.atlas_seams import find_atlas_seams
from farfield.addon.core.unwrap.merging import MergeLimits, merge_islands
from farfield.addon.core.unwrap.overlaps import any_overlap
from farfield.addon.core.unwrap.packing import orient, orient_smallest, pack_charts, turn_upright
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.texture import Texture
from farfield.addon.core.unwrap.unwrapping import unwrap
from shapes import box, cylinder

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
SQUARE_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def pack_rectangles(sides, margin=0.01):
    """Pack rectangles and return their lower and upper corners (C, 2)."""
    packed = run_to_end(pack_charts([SQUARE * side for side in sides], [SQUARE_TRIANGLES] * len(sides), Texture(margin=2048 * margin))).uvs
    return np.array([uv.min(axis=0) for uv in packed]), np.array([uv.max(axis=0) for uv in packed])


def assert_separate(low, high):
    assert low.min() >= 0.0 and high.max() <= 1.0 + 1e-9
    for first in range(len(low)):
        for second in range(first):
            assert (low[first] >= high[second]).any() or (low[second] >= high[first]).any()


@pytest.mark.parametrize("unit", [1e-30, 1e-6, 1.0, 1e6, 1e19, 1e30])
def test_the_unit_of_length_does_not_matter(unit):
    """xatlas does not end when the squares of coordinates exceed single precision."""
    sides = np.array([[1.0, 2.0], [3.0, 1.0], [0.5, 0.5]])
    low, high = pack_rectangles(unit * sides)
    assert_separate(low, high)
    expected_low, expected_high = pack_rectangles(sides)
    np.testing.assert_allclose(high - low, expected_high - expected_low, rtol=1e-5)


@pytest.mark.parametrize("length", [1e3, 1e6, 1e12, 1e30])
def test_thin_charts_of_any_length_are_packed(length):
    low, high = pack_rectangles([[length, 1.0], [length, 1.0 / length], [1.0, 1.0]])
    assert_separate(low, high)
    assert 0.95 < (high - low)[0].max() <= 0.98 + 1e-9


@pytest.mark.parametrize("unit", [1e-30, 1e-3, 1.0, 1e6, 1e19, 1e36])
def test_seams_do_not_depend_on_the_unit_of_length(unit):
    mesh = cylinder(radius=0.5, length=2.0, sides=12, cuts=2)
    expected = find_atlas_seams(mesh, np.arange(len(mesh.triangles)))
    seams = find_atlas_seams(TriangleMesh(unit * mesh.vertices, mesh.triangles), np.arange(len(mesh.triangles)))
    assert len(seams) > 0
    np.testing.assert_array_equal(seams, expected)


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("islands", ["one", "atlas"])
@pytest.mark.parametrize("length", [pytest.param(1e4, marks=pytest.mark.exhaustive), 1e10])
def test_a_surface_with_a_far_vertex_is_unwrapped(islands, length):
    mesh = box(cuts=2)
    vertices = mesh.vertices.copy()
    vertices[0, 1] = -length
    triangle_count = len(mesh.triangles)
    steps = unwrap(
        TriangleMesh(vertices, mesh.triangles),
        np.arange(triangle_count),
        np.zeros((0, 2), np.int64),
        np.zeros(triangle_count),
        UnwrapSettings(islands=islands),
    )
    assert np.isfinite(run_to_end(steps).corner_uvs).all()


def pack_random_rectangles(texture, count=40, seed=3):
    """Pack rectangles; return their sides (C, 2), and lower and upper corners (C, 2) in texels of the texture."""
    sides = np.random.default_rng(seed).uniform(0.2, 1.0, (count, 2))
    packing = run_to_end(pack_charts([SQUARE * side for side in sides], [SQUARE_TRIANGLES] * count, texture))
    corners = np.array(packing.uvs) * texture.size
    return packing, sides, corners.min(axis=1), corners.max(axis=1)


@pytest.mark.parametrize(
    ("size", "margin"),
    [
        pytest.param((2048, 2048), 8, marks=pytest.mark.exhaustive),
        pytest.param((1024, 1024), 3, marks=pytest.mark.exhaustive),
        pytest.param((4096, 1024), 8, marks=pytest.mark.exhaustive),
        ((512, 1024), 20),
        ((256, 256), 0),
    ],
)
def test_margins_are_kept_in_pixels_and_proportions_on_any_texture(size, margin):
    packing, sides, low, high = pack_random_rectangles(Texture(size=size, margin=margin))
    assert packing.tile_count == 1
    assert low.min() >= margin - 1e-6 and (high <= np.array(size) - margin + 1e-6).all()
    np.testing.assert_allclose(np.sort(high - low, axis=1), np.sort(sides, axis=1) * packing.density, rtol=1e-9)
    gaps = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)[~np.eye(len(low), dtype=bool)]
    assert gaps.min() >= margin - 1e-6
    assert (high - low).prod(axis=1).sum() > 0.4 * size[0] * size[1]


@pytest.mark.slow
def test_islands_go_to_further_tiles_at_a_texel_density():
    _, _, low, high = pack_random_rectangles(Texture(size=(1024, 1024), max_tiles=20, density=900.0))
    tiles = np.floor(low / 1024.0).astype(int)
    assert (np.floor(high / 1024.0) == tiles).all() and (tiles[:, 0] < 10).all()
    numbers = np.unique(tiles @ [1, 10])
    assert numbers.tolist() == list(range(len(numbers))) and 10 < len(numbers) <= 20
    assert (low % 1024.0 >= 8.0 - 1e-6).all() and (high % 1024.0 <= 1016.0 + 1e-6).all()


def test_a_texel_density_that_fits_into_one_tile_is_kept_exactly():
    packing, *_ = pack_random_rectangles(Texture(size=(1024, 1024), max_tiles=5, density=100.0))
    assert packing.tile_count == 1 and packing.density == 100.0


def test_a_texel_density_that_does_not_fit_is_lowered():
    dense, fitting = (pack_random_rectangles(Texture(size=(1024, 1024), density=density))[0] for density in (512.0, 0.0))
    assert dense.tile_count == 1 and dense.density == fitting.density < 512.0


@pytest.mark.slow
def test_without_a_texel_density_all_tiles_are_filled():
    one, four = (pack_random_rectangles(Texture(size=(1024, 1024), max_tiles=count))[0] for count in (1, 4))
    assert four.tile_count == 4 and 1.7 < four.density / one.density < 2.2


def unwrap_boxes(orientation, sides=((1.0, 0.3, 2.0), (0.5, 0.6, 1.0))):
    """Unwrap boxes; return the map, and the mean gradient of height in the map of all triangles of vertical faces (T, 2), of length 1."""
    mesh = concatenate(
        [TriangleMesh(box(side, cuts=1).vertices + 5.0 * index, box(side, cuts=1).triangles) for index, side in enumerate(sides)]
    )
    count = len(mesh.triangles)
    settings = UnwrapSettings(orientation=orientation, islands="atlas")
    result = run_to_end(unwrap(mesh, np.arange(count) // 2, np.zeros((0, 2), np.int64), np.zeros(count), settings))
    is_vertical = np.abs(scaled_normals(mesh.corners)[:, 2]) < 1e-9
    uv, heights = result.corner_uvs[is_vertical], mesh.corners[is_vertical][..., 2]
    edges = uv[:, 1:] - uv[:, :1]
    gradients = np.linalg.solve(edges, (heights[:, 1:] - heights[:, :1])[..., None])[..., 0]
    return result, gradients / np.linalg.norm(gradients, axis=1, keepdims=True)


def test_islands_of_vertical_faces_are_turned_upright():
    upright, ups = unwrap_boxes("upright")
    np.testing.assert_allclose(ups, np.broadcast_to([0.0, 1.0], ups.shape), atol=1e-6)
    free, free_ups = unwrap_boxes("fill")
    assert upright.is_upright and not free.is_upright
    assert (free_ups[:, 1] < 0.9).any() and free.metrics.overlaps == upright.metrics.overlaps == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "sides",
    [((1.0, 0.3, 2.0), (0.5, 0.6, 1.0)), pytest.param(((6.0, 5.0, 0.5), (0.5, 0.5, 12.0)), marks=pytest.mark.exhaustive)],
)
def test_islands_are_upright_by_default_where_that_costs_little(sides):
    automatic, upright, free = (unwrap_boxes(orientation, sides)[0] for orientation in ("auto", "upright", "fill"))
    assert automatic.metrics.fill >= 0.98 * free.metrics.fill
    assert automatic.is_upright == (upright.metrics.fill >= 0.98 * free.metrics.fill)
    assert automatic.metrics.fill == (upright if automatic.is_upright else free).metrics.fill


def test_a_chart_is_turned_by_its_world_up():
    angle = np.radians(70.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    wall = np.column_stack([SQUARE[:, 0], 0.0 * SQUARE[:, 0], SQUARE[:, 1]])
    upright = turn_upright(SQUARE @ turn.T, SQUARE_TRIANGLES, wall)
    np.testing.assert_allclose(upright - upright[0], SQUARE, atol=1e-12)
    floor = np.column_stack([SQUARE, 0.3 * SQUARE[:, 0]])
    assert turn_upright(SQUARE, SQUARE_TRIANGLES, floor) is None


@pytest.mark.slow
def test_tiles_are_not_used_for_a_large_island_alone():
    """One island fills a tile, so that the others, which are small, cannot get larger: they fit into a second tile."""
    sides = [[1.0, 1.0]] + [[0.2, 0.15]] * 20
    packing = run_to_end(pack_charts([SQUARE * side for side in sides], [SQUARE_TRIANGLES] * 21, Texture(max_tiles=10)))
    dense = run_to_end(pack_charts([SQUARE * side for side in sides], [SQUARE_TRIANGLES] * 21, Texture(max_tiles=10, density=1e4)))
    assert packing.tile_count == dense.tile_count == 2
    assert min(packing.density, dense.density) > 0.95 * 2032.0


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_a_chart_whose_boundary_is_mostly_straight_is_not_turned_for_a_slightly_smaller_box(angle):
    """Two corners on the long sides make the bounding box smaller that is turned by a degree."""
    bottom, top = (
        [[0.0, 0.0], [7.8, 0.0], [8.0, -0.2], [8.2, 0.0], [10.0, 0.0]],
        [[10.0, 3.0], [2.2, 3.0], [2.0, 3.2], [1.8, 3.0], [0.0, 3.0]],
    )
    outline = np.array(bottom + top)
    faces = np.array([[0, 1, 9], [1, 3, 5], [1, 2, 3], [3, 4, 5], [1, 5, 6], [1, 6, 8], [6, 7, 8], [1, 8, 9]], np.int32)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    placed = orient(outline @ turn.T, faces)
    edge = np.abs(placed[1] - placed[0])
    assert edge.min() < 1e-6 * edge.max()
    smallest = np.ptp(orient_smallest(outline @ turn.T), axis=0).prod()
    assert 1.02 * smallest < np.ptp(placed, axis=0).prod() < 1.05 * smallest


def unwrap_uniformly(mesh):
    count = len(mesh.triangles)
    result = run_to_end(unwrap(mesh, np.arange(count), np.zeros((0, 2), np.int64), np.zeros(count), UnwrapSettings()))
    assert result.metrics.flips == result.metrics.overlaps == 0
    return result


def test_a_long_strip_is_cut_into_halves():
    result = unwrap_uniformly(cylinder(radius=0.5, length=4.0 * np.pi, sides=16, cuts=8))
    assert result.chart_count == 2 and result.metrics.fill > 0.9
    assert result.metrics.symmetric_dirichlet == pytest.approx(4.0, abs=1e-6)


@pytest.mark.slow
def test_an_island_that_fills_little_of_the_texture_is_cut_across():
    """In one piece the map of a thin torus is a strip that fills a quarter of the texture."""
    result = unwrap_uniformly(TriangleMesh(*torus(48, 24, tube_radius=0.3)))
    assert result.chart_count == 2 and result.metrics.fill > 0.55


@pytest.mark.parametrize(("limits", "is_joined"), [(MergeLimits(1.25), True), (MergeLimits(1.25, max_addition=1.25), False)])
def test_small_arms_of_a_large_island_can_be_forbidden(limits, is_joined):
    """A square plate with a wall of 0.2 x 0.1 that stands on its edge."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 0.4, 0], [1, 0.5, 0], [1, 1, 0], [0, 1, 0], [1, 0.4, 0.2], [1, 0.5, 0.2]], np.float64)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5], [3, 2, 6], [3, 6, 7]], np.int32)
    labels = np.array([0, 0, 0, 0, 1, 1])
    corners = vertices[triangles]
    corner_uvs = np.where((labels == 0)[:, None, None], corners[..., :2], 3.0 + corners[..., 1:] * [-1.0, 1.0])
    halfedges = find_edges(triangles, len(vertices)).interior_halfedges
    border = np.flatnonzero(np.ptp(labels[halfedges // 3], axis=1))
    _, is_sewn = run_to_end(merge_islands(TriangleMesh(vertices, triangles), corner_uvs, labels, halfedges, np.ones(6), limits))
    assert is_sewn[border].tolist() == [is_joined]


@pytest.mark.parametrize(
    ("distance", "radius", "is_overlap"), [(1e-3, 0.0, True), (1e-3, 0.01, False), (-1e-3, 0.01, True), (3e-3, 0.0, False)]
)
def test_triangles_may_only_be_closer_than_the_gap_at_a_joint(distance, radius, is_overlap):
    above = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    below = np.array([[[0.0, 0.0], [0.0, -1.0], [1.0, 0.0]]]) - [0.0, distance]
    assert any_overlap(above, below, 2e-3, np.zeros((1, 2)), radius) is is_overlap


def test_borders_of_slightly_different_lengths_are_joined_without_a_gap():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], np.float64)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], np.int32)
    labels = np.array([0, 0, 1, 1])
    corner_uvs = vertices[triangles][..., :2] * np.where(labels == 0, 1.0, 1.01)[:, None, None] + 3.0 * labels[:, None, None]
    halfedges = find_edges(triangles, len(vertices)).interior_halfedges
    mesh, limits = TriangleMesh(vertices, triangles), MergeLimits(2.0)
    joined, is_sewn = run_to_end(merge_islands(mesh, corner_uvs, labels, halfedges, np.ones(4), limits))
    assert is_sewn.all()
    np.testing.assert_allclose(joined[0, 1:], joined[3, [0, 2]], atol=1e-12)
