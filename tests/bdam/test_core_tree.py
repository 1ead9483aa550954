"""The bintrees alone: triangles of a level tile the square, children their parents, and diamonds share a hypotenuse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.bdam.tree import Tree, bisect

TREES = st.builds(Tree, st.integers(2, 70), st.integers(2, 70), st.sampled_from([2, 4, 6, 8]))


def areas_of(corners) -> np.ndarray:
    """Twice the signed areas (N,) of triangles (N, 3, 2)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def cells_of(corners, side) -> np.ndarray:
    """Whether triangles (N, 3, 2) contain the centers of the two triangles of each cell and diagonal, (N, side, side, 4)."""
    y, x = np.mgrid[0:side, 0:side]
    offsets = np.array([(0.5, 0.2), (0.8, 0.5), (0.5, 0.8), (0.2, 0.5)])  # one in each quarter of a cell that its diagonals make
    points = np.stack([x, y], axis=-1)[:, :, None] + offsets
    is_inside = np.ones((len(corners), side, side, 4), bool)
    for edge in range(3):
        start, end = (corners[:, index % 3][:, None, None, None] for index in (edge, edge + 1))
        direction, offset = end - start, points - start
        is_inside &= direction[..., 0] * offset[..., 1] - direction[..., 1] * offset[..., 0] > 0.0
    return is_inside


@pytest.mark.parametrize(
    ("rows", "columns", "leaf_cells", "depth"), [(2, 2, 2, 0), (33, 33, 32, 0), (34, 2, 32, 1), (65, 65, 32, 1), (8193, 100, 32, 8)]
)
def test_the_depth_is_the_least_that_covers_the_field(rows, columns, leaf_cells, depth):
    tree = Tree(rows, columns, leaf_cells)
    assert (tree.depth, tree.leaf_level, tree.side) == (depth, 2 * depth, leaf_cells << depth)


def test_known_triangles():
    tree = Tree(9, 9, 4)
    assert tree.triangle_corners(0, np.arange(2)).tolist() == [[[8, 8], [0, 0], [8, 0]], [[0, 0], [8, 8], [0, 8]]]
    assert tree.corners_of(1, 0).tolist() == [[8, 0], [8, 8], [4, 4]]
    assert tree.corners_of(1, 3).tolist() == [[8, 8], [0, 8], [4, 4]]
    assert tree.corners_of(2, 0).tolist() == [[4, 4], [8, 0], [8, 4]]


@given(tree=TREES, data=st.data())
def test_children_divide_their_parents(tree, data):
    level = data.draw(st.integers(0, max(tree.leaf_level - 1, 0)))
    parents = tree.triangle_corners(level, np.arange(2 << level))
    children = np.stack([bisect(parents, np.full(len(parents), side)) for side in (False, True)], axis=1)
    assert (areas_of(children.reshape(-1, 3, 2)).reshape(-1, 2) * 2 == areas_of(parents)[:, None]).all(), "both have half of the area"
    centers = (parents[:, 0] + parents[:, 1]) // 2
    assert (children[:, :, 2] == centers[:, None]).all(), "their right angles are at the middle of the hypotenuse"
    for child in (0, 1):  # their hypotenuses are the legs
        assert (children[:, child, :2].sum(axis=1) == parents[:, [0, 1][child]] + parents[:, 2]).all()
    finer = tree.triangle_corners(level + 1, np.arange(4 << level))
    assert np.array_equal(finer.reshape(-1, 2, 3, 2), children)


@given(tree=TREES, data=st.data())
def test_one_triangle_is_that_of_many(tree, data):
    level = data.draw(st.integers(0, tree.leaf_level))
    index = data.draw(st.integers(0, (2 << level) - 1))
    assert np.array_equal(tree.corners_of(level, index), tree.triangle_corners(level, np.array([index]))[0])


@given(tree=st.builds(Tree, st.integers(2, 25), st.integers(2, 25), st.sampled_from([2, 4, 6])), data=st.data())
def test_existing_triangles_of_a_level_cover_the_field_once_and_no_other_triangle_overlaps_it(tree, data):
    level = data.draw(st.integers(0, min(tree.leaf_level, 6)))
    indices = tree.existing_triangles(level)
    assert (np.diff(indices) > 0).all() and (indices >= 0).all() and (indices < 2 << level).all()
    corners = tree.triangle_corners(level, np.arange(2 << level))
    contains = cells_of(corners, tree.side)
    assert (contains.sum(axis=0) == 1).all(), "all triangles cover the root square once"
    in_field = contains[:, : tree.rows - 1, : tree.columns - 1].any(axis=(1, 2, 3))
    assert np.array_equal(np.flatnonzero(in_field), indices)
    if level:
        assert np.isin(indices >> 1, tree.existing_triangles(level - 1)).all(), "parents exist"


@given(tree=TREES, data=st.data())
def test_both_triangles_of_a_diamond_have_the_same_hypotenuse(tree, data):
    level = data.draw(st.integers(0, tree.leaf_level))
    indices = tree.existing_triangles(level)
    corners, diamonds = tree.triangle_corners(level, indices), tree.find_diamonds(level, indices)
    assert np.array_equal(np.sort(diamonds[diamonds >= 0]), np.arange(len(indices))), "each triangle is in one diamond"
    assert (diamonds[:, 0] >= 0).all() and (np.diff(diamonds[:, 0]) > 0).all()
    pairs = diamonds[diamonds[:, 1] >= 0]
    assert np.array_equal(corners[pairs[:, 0], 0], corners[pairs[:, 1], 1])
    assert np.array_equal(corners[pairs[:, 0], 1], corners[pairs[:, 1], 0])
    assert (pairs[:, 0] < pairs[:, 1]).all()
    ends = {tuple(np.sort(pair[:2], axis=0).ravel()) for pair in corners[diamonds[:, 0]]}
    assert len(ends) == len(diamonds), "no two diamonds have the same hypotenuse"
