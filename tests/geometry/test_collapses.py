"""Collapses: independent vertices and edges, the link condition, edges that are created twice, quality."""

import numpy as np
import pytest

from farfield.addon.core.geometry.collapses import (
    creates_existing_edge,
    creates_repeated_edge,
    measure_quality,
    satisfies_link_condition,
    select_disjoint,
    select_independent,
)
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.proximity import encode_pairs

TETRAHEDRON = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], np.int32)


def make_grid(side: int) -> np.ndarray:
    """Return the triangles (T, 3) of a grid of side x side vertices."""
    corners = np.arange(side * side).reshape(side, side)
    a, b, c, d = corners[:-1, :-1].ravel(), corners[:-1, 1:].ravel(), corners[1:, 1:].ravel(), corners[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def test_selected_vertices_have_no_common_triangle_and_leave_no_cheaper_neighbor_out():
    triangles = make_grid(12)
    keys = np.random.default_rng(0).permutation(144)
    selected = select_independent(np.arange(144), keys, np.ascontiguousarray(triangles.T), 144, passes=144)
    is_selected = np.isin(np.arange(144), selected)
    assert is_selected[triangles].sum(axis=1).max() == 1
    smallest = np.full(144, 144)  # the smallest key of a selected vertex around each vertex
    for corner in range(3):
        for other in range(3):
            np.minimum.at(smallest, triangles[:, corner], np.where(is_selected, keys, 144)[triangles[:, other]])
    assert (smallest <= keys).all()  # each vertex is selected, or a cheaper neighbor is


def test_selected_operations_touch_no_triangle_twice_and_are_the_cheapest_first():
    owners, touched = np.repeat(np.arange(4), 2), np.array([0, 1, 1, 2, 2, 3, 4, 5])
    costs = np.array([2.0, 1.0, 3.0, np.inf])
    assert select_disjoint(costs, owners, touched, 6, 4).tolist() == [1]
    assert select_disjoint(np.array([1.0, 2.0, 3.0, 4.0]), owners, touched, 6, 2).tolist() == [0, 2]


def test_an_edge_collapses_only_where_its_ends_have_no_other_common_neighbor():
    fan = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)], np.int32)
    edges = find_edges(fan)
    satisfied = {tuple(pair) for pair in edges.ends[satisfies_link_condition(edges)].tolist()}
    assert {(0, 1), (0, 2), (0, 3), (0, 4)} <= satisfied
    three_at_an_edge = find_edges(np.array([(0, 1, 2), (1, 0, 3), (0, 1, 4)], np.int32))
    assert not satisfies_link_condition(three_at_an_edge)[three_at_an_edge.between(np.array(0), np.array(1))]
    strip = find_edges(np.array([(0, 1, 2), (2, 1, 3)], np.int32))
    assert not satisfies_link_condition(strip)[strip.between(np.array(1), np.array(2))]  # both ends are on the boundary


def test_collapses_that_create_an_edge_that_exists_or_that_an_earlier_one_creates_are_found():
    edges = find_edges(TETRAHEDRON, 6)
    owners = np.array([0, 1, 2, 2, 3])
    keys = encode_pairs(np.array([0, 4, 4, 5, 5]), np.array([1, 0, 1, 2, 2]), 6)
    assert creates_existing_edge(owners, keys, edges.keys, 5).tolist() == [True, False, False, False, False]
    assert creates_repeated_edge(owners, keys, 5).tolist() == [False, False, False, True, False]
    assert not creates_repeated_edge(np.array([2, 2]), keys[3:], 5).any()  # twice by the same collapse


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_the_quality_of_a_triangle_is_one_if_equilateral_whatever_its_size_and_zero_without_area(size):
    double_areas = np.array([0.5 * np.sqrt(3.0), 1.0, 0.0, 0.0]) * size**2
    assert np.allclose(measure_quality(double_areas, np.array([3.0, 4.0, 2.0, 0.0]) * size**2), [1.0, np.sqrt(3.0) / 2.0, 0.0, 0.0])
