"""Foliage gets fewer and larger leaves with the same area; surfaces made of loose parts do not."""

from itertools import pairwise

import numpy as np
import pytest

from distance_scenes import scattered, square
from farfield.addon.core.distance.aggregates import AggregateLevel, Elements, count_triangles, find_elements, simplify_elements
from farfield.addon.core.distance.deviation import DETAIL_SIZE, measure_pixel_size, measure_texture_shift
from farfield.addon.core.geometry.mesh import face_areas_and_normals

COUNT = 1024
SIDE = 0.1  # Of a leaf.


def hexagon() -> tuple[np.ndarray, np.ndarray]:
    """Return a hexagon of six triangles."""
    angles = np.arange(6) * np.pi / 3.0
    corners = SIDE * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])
    return np.concatenate([corners, np.zeros((1, 3))]), np.array([(6, corner, (corner + 1) % 6) for corner in range(6)])


def prism() -> tuple[np.ndarray, np.ndarray]:
    """Return a thin closed twig along the x axis."""
    corners = np.array([(x, y, z) for x in (0, 1) for y, z in ((0, 0), (0.02, 0), (0.01, 0.017))], float)
    sides = [(k, (k + 1) % 3, (k + 1) % 3 + 3, k + 3) for k in range(3)]
    triangles = [triangle for a, b, c, d in sides for triangle in ((a, d, c), (a, c, b))]
    return corners, np.array([*triangles, (0, 1, 2), (3, 5, 4)])


def foliage(shape: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, Elements]:
    vertices, triangles = scattered(*shape, COUNT)
    elements = find_elements(vertices, triangles)
    assert elements is not None and len(elements.centers) == COUNT
    return vertices, triangles, elements


def area(vertices: np.ndarray, triangles: np.ndarray, level: AggregateLevel) -> float:
    kept, _ = face_areas_and_normals(vertices[triangles[level.kept]])
    return float(kept.sum() + face_areas_and_normals(level.positions)[0].sum())


@pytest.mark.parametrize("pixel", [0.5, 1.0, 2.0, 4.0, 8.0])
def test_as_many_leaves_stay_as_have_the_same_area(pixel):
    vertices, triangles, elements = foliage(square(SIDE))
    level = simplify_elements(elements, pixel * SIDE)
    expected = COUNT / max(pixel, 1.0) ** 2
    assert len(level.positions) == count_triangles(elements, pixel * SIDE).sum() == pytest.approx(2 * expected, abs=2)
    assert not len(level.kept)
    assert area(vertices, triangles, level) == pytest.approx(COUNT * SIDE**2, rel=1.01 / expected)


def test_small_leaves_of_a_fine_level_are_those_of_the_original():
    vertices, triangles, elements = foliage(square(SIDE))
    level = simplify_elements(elements, 0.01 * SIDE)
    assert np.allclose(level.positions, vertices.reshape(-1, 3)[triangles.ravel()[level.sources]])
    _, before = face_areas_and_normals(vertices[triangles[level.sources[:, 0] // 3]])
    assert np.allclose(face_areas_and_normals(level.positions)[1], before)


def test_a_leaf_of_many_triangles_becomes_a_rhombus_once_it_is_small():
    vertices, triangles, elements = foliage(hexagon())
    near, far = simplify_elements(elements, 0.01 * SIDE), simplify_elements(elements, 0.6 * SIDE)
    assert len(near.kept) == 6 * COUNT and not len(near.positions)
    assert not len(far.kept) and len(far.positions) == 2 * COUNT == count_triangles(elements, 0.6 * SIDE).sum()
    assert area(vertices, triangles, far) == pytest.approx(area(vertices, triangles, near))
    assert not far.is_flat.any()


def test_a_twig_becomes_a_sheet_that_covers_as_much_from_all_sides_together():
    vertices, triangles, elements = foliage(prism())
    level = simplify_elements(elements, 0.05)
    directions = np.linalg.qr(np.random.default_rng(1).normal(size=(200, 3, 3)))[0].reshape(-1, 3)
    normals, areas = face_areas_and_normals(vertices[triangles])[1], face_areas_and_normals(vertices[triangles])[0]
    before = 0.5 * (np.abs(normals @ directions.T) * areas[:, None]).sum(axis=0).mean()  # A closed surface covers everything twice.
    areas, normals = face_areas_and_normals(level.positions)
    after = (np.abs(normals @ directions.T) * areas[:, None]).sum(axis=0).mean()
    assert after == pytest.approx(before, rel=0.03) and level.is_flat.all()
    lengths = np.ptp(np.einsum("nki,ni->nk", level.positions, elements.frames[elements.of_triangles[level.sources[:, 0] // 3], 0]), axis=1)
    assert np.median(lengths) == pytest.approx(1.0, rel=0.02), "a twig that is longer than a pixel keeps its length and gets thicker"


def test_coarser_levels_have_only_leaves_of_finer_ones_and_are_evenly_distributed():
    _, _, elements = foliage(square(SIDE))
    leaves = [set((simplify_elements(elements, pixel * SIDE).sources // 6).ravel()) for pixel in (1.0, 2.0, 4.0, 8.0)]
    assert all(coarse < fine for fine, coarse in pairwise(leaves))
    octants = (elements.centers > 5.0) @ [1, 2, 4]
    chosen = np.bincount(octants[elements.of_triangles[2 * np.array(sorted(leaves[2]))]], minlength=8)
    assert np.abs(chosen - np.bincount(octants) / 16.0).max() <= 2.0, "64 leaves at random would have 8 +- 3 per octant"


def test_the_trunk_is_no_leaf():
    vertices, triangles = scattered(*square(SIDE), COUNT)
    trunk = np.array([(5, 5, 0), (5.3, 5, 0), (5, 5, 9)])
    elements = find_elements(np.concatenate([vertices, trunk]), np.concatenate([triangles, [[len(vertices) + k for k in range(3)]]]))
    assert elements.of_triangles[-1] == -1 and (elements.of_triangles[:-1] >= 0).all()


def test_surfaces_are_no_foliage():
    part, quad = square(0.2)
    grid = np.array([(x, y, 0.0) for x in range(32) for y in range(32)]) * 0.19
    random = np.random.default_rng(0)
    tilted = part @ [[1, 0, 0.05], [0, 1, 0.05], [0, 0, 1]]
    tiles = (tilted + grid[:, None] + random.normal(0.0, 0.005, (len(grid), 1, 3))).reshape(-1, 3)
    assert find_elements(tiles, (4 * np.arange(len(grid))[:, None, None] + quad).reshape(-1, 3)) is None, "a roof of loose tiles"
    slats = (part @ [[1, 0, 0], [0, 0.7, 0.7], [0, -0.7, 0.7]] + grid[:, None]).reshape(-1, 3)
    assert find_elements(slats, (4 * np.arange(len(grid))[:, None, None] + quad).reshape(-1, 3)) is None, "a shutter of tilted slats"
    vertices, triangles = scattered(*square(SIDE), count=100)
    assert find_elements(vertices, triangles) is None, "few parts"
    side = np.linspace(0.0, 1.0, 30)
    points = np.stack(np.meshgrid(side, side, [0.0]), axis=-1).reshape(-1, 3)
    corner = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()[:, None]
    assert find_elements(points, np.concatenate([corner + [0, 1, 31], corner + [0, 31, 30]])) is None, "one sheet"


def test_the_pixel_size_of_a_simplified_mesh_is_that_of_its_smallest_detail():
    random = np.random.default_rng(0)
    points = np.column_stack([random.uniform(0.1, 0.9, (5000, 2)), np.full(5000, 0.01)])
    corners = np.array([[(-1, -1, 0), (3, -1, 0), (-1, 3, 0)]], float)
    assert measure_pixel_size(points, corners) == pytest.approx(DETAIL_SIZE * 0.01)


def test_a_texture_moves_on_the_surface_by_its_shift_in_the_map():
    square = np.array([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 2.0, 0.0), (0.0, 2.0, 0.0)])
    corners = square[[[0, 1, 2], [0, 2, 3]]]
    uvs = 0.5 * corners[..., :2]  # A unit of the texture is 2 long.
    assert measure_texture_shift(corners, uvs, corners, uvs) == pytest.approx(0.0, abs=1e-12)
    assert measure_texture_shift(corners, uvs, corners + [0.0, 0.0, 0.3], uvs + [0.1, 0.0]) == pytest.approx(0.2)
    assert measure_texture_shift(corners, np.zeros_like(uvs), corners, uvs) == 0.0, "nothing of the texture is on the surface"
