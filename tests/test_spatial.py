"""Nearness is what brute force says it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.distance import point_triangle_distances
from farfield.addon.core.spatial import (
    contract,
    nearest_pairs,
    neighbour_pairs,
    pair_keys,
    primitive_distances,
    sorted_unique,
    split_keys,
    triangle_distances,
)
from shapes import rotation, sheet, soup

seeds = st.integers(0, 2**32 - 1)
FLAT = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def all_pairs(count: int) -> np.ndarray:
    return np.stack(np.triu_indices(count, 1), axis=1).astype(np.int32)


def sampled_distance(first: np.ndarray, second: np.ndarray, steps: int = 40) -> float:
    """Least distance of a lattice of points on the triangle `first` (3, 3) to the triangle `second`."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    shares = np.stack([i, j, steps - i - j], axis=-1)[i + j <= steps] / steps
    points = shares @ first
    return float(np.sqrt(point_triangle_distances(points, np.broadcast_to(second, (len(points), 3, 3))).min()))


class TestTriangleDistances:
    """The distance between two triangles."""

    @pytest.mark.parametrize(
        ("moved", "distance"),
        [
            (FLAT + [0.0, 0.0, 0.7], 0.7),  # face over face
            (FLAT + [3.0, 0.0, 0.0], 2.0),  # corner to corner
            (np.array([[0.2, 0.2, 0.5], [0.2, 0.2, 2.0], [0.3, 0.1, 2.0]]), 0.5),  # corner over face
            (np.array([[0.5, -0.25, -1.0], [0.5, -0.25, 1.0], [0.5, -2.0, 0.0]]), 0.25),  # edge across edge
            (np.array([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [3.0, 3.0, 0.0]]), np.sqrt(0.5)),  # edge to the slanted edge
        ],
    )
    def test_known_answers(self, moved, distance):
        assert triangle_distances(FLAT[None], moved[None])[0] == pytest.approx(distance)
        assert triangle_distances(moved[None], FLAT[None])[0] == pytest.approx(distance)

    @settings(max_examples=40)
    @given(seeds)
    def test_no_sample_is_nearer_and_some_is_as_near(self, seed):
        random = np.random.default_rng(seed)
        first = random.normal(size=(3, 3))
        second = random.normal(size=(3, 3)) + rotation(seed)[0] * 6.0
        exact = triangle_distances(first[None], second[None])[0]
        sampled = sampled_distance(first, second)
        assert exact <= sampled * (1.0 + 1e-9)
        side = np.linalg.norm(first - np.roll(first, 1, axis=0), axis=1).max()
        assert sampled <= exact + side / 40.0

    @given(seeds)
    def test_moving_both_changes_nothing(self, seed):
        corners = soup(20, seed=seed, size=0.3).corners
        before = triangle_distances(corners[:10], corners[10:])
        after = triangle_distances(*np.split(3.0 * corners @ rotation(seed).T + [1.0, 2.0, 3.0], 2))
        apart = before > 1e-6
        np.testing.assert_allclose(after[apart], 3.0 * before[apart], rtol=1e-6)


class TestNeighbourPairs:
    """Every primitive is joined to its nearest."""

    @settings(max_examples=30)
    @given(seeds, st.integers(2, 20))
    def test_small_soups_agree_with_brute_force(self, seed, total):
        """With as many candidates as primitives nothing is left to the k-d tree."""
        corners = soup(total, size=0.5, seed=seed).corners
        count = max(total * 4 // 5, 1)
        pairs, distances = neighbour_pairs(corners, count)
        every = all_pairs(total)
        table = np.full((total, total), np.inf)
        table[every[:, 0], every[:, 1]] = table[every[:, 1], every[:, 0]] = primitive_distances(corners, every)
        expected = set()
        for one, row in enumerate(table):
            expected |= {(min(one, other), max(one, other)) for other in np.flatnonzero(row < np.sort(row)[min(count, total - 1) - 1])}
        found = {(int(a), int(b)) for a, b in pairs}
        assert expected <= found
        np.testing.assert_array_equal(distances, table[pairs[:, 0], pairs[:, 1]])

    def test_large_soups_miss_few(self):
        corners = soup(400, size=0.1).corners
        pairs, _ = neighbour_pairs(corners, 10)
        every = all_pairs(400)
        nearest = every[nearest_pairs(every, primitive_distances(corners, every), 400, 10)]
        found = {tuple(pair) for pair in pairs.tolist()}
        assert np.mean([tuple(pair) in found for pair in nearest.tolist()]) > 0.9

    def test_pairs_are_ordered_unique_and_enough(self):
        pairs, distances = neighbour_pairs(soup(100).corners, 8)
        assert pairs.dtype == np.int32
        assert (pairs[:, 0] < pairs[:, 1]).all()
        np.testing.assert_array_equal(np.unique(pairs, axis=0), pairs)
        assert np.bincount(pairs.reshape(-1), minlength=100).min() >= 8
        assert (distances >= 0.0).all()

    def test_a_shared_corner_is_no_distance(self):
        mesh = sheet(4)
        pairs, distances = neighbour_pairs(mesh.corners, 31)
        sharing = np.array([len(np.intersect1d(mesh.triangles[a], mesh.triangles[b])) > 0 for a, b in pairs])
        np.testing.assert_array_equal(distances == 0.0, sharing)
        assert len(pairs) == 32 * 31 // 2

    def test_a_large_primitive_knows_the_small_ones_along_it(self):
        """The centroid of a long wall is far from the leaves at its end."""
        wall = np.array([[[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 0.0, 100.0]]])
        beside_its_centroid = 0.1 * soup(20).corners + [100.0 / 3.0, 20.0, 100.0 / 3.0]
        leaf = 0.1 * soup(1).corners + [0.0, 0.3, 95.0]
        beside_the_leaf = 0.1 * soup(20).corners + [0.0, 10.0, 95.0]
        pairs, _ = neighbour_pairs(np.concatenate([wall, leaf, beside_its_centroid, beside_the_leaf]), 5)
        assert [0, 1] in pairs.tolist()

    @pytest.mark.parametrize("total", [0, 1])
    def test_one_alone_has_no_neighbours(self, total):
        pairs, distances = neighbour_pairs(soup(total).corners, 5)
        assert pairs.shape == (0, 2) and distances.shape == (0,)

    def test_two_are_each_other_s(self):
        assert neighbour_pairs(soup(2).corners, 50)[0].tolist() == [[0, 1]]

    def test_squares_are_taken_by_their_discs(self):
        square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        corners = np.stack([square, square + [5.0, 0.0, 0.0], square + [1.0, 0.0, 0.0]])
        gap = 5.0 - 2.0 * np.sqrt(2.0)
        np.testing.assert_allclose(primitive_distances(corners, np.array([[0, 1], [0, 2]])), [gap, 0.0])


class TestPairs:
    """Pairs as numbers, and between groups."""

    @given(seeds)
    def test_keys_hold_unordered_pairs(self, seed):
        first, second = np.random.default_rng(seed).integers(0, 12, (2, 60))
        expected = sorted({(min(a, b), max(a, b)) for a, b in zip(first.tolist(), second.tolist(), strict=True) if a != b})
        assert [tuple(pair) for pair in split_keys(pair_keys(first, second, 12), 12).tolist()] == expected

    @given(st.lists(st.integers(0, 20)))
    def test_sorted_unique_is_numpy_s(self, values):
        keys = np.array(values, np.int64)
        unique, first = sorted_unique(keys)
        expected, expected_first = np.unique(keys, return_index=True)
        np.testing.assert_array_equal(unique, expected)
        np.testing.assert_array_equal(first, expected_first)

    @given(seeds)
    def test_contracting_joins_groups_that_a_pair_joins(self, seed):
        random = np.random.default_rng(seed)
        pairs, labels = random.integers(0, 30, (50, 2)), random.integers(0, 6, 30)
        expected = {(min(a, b), max(a, b)) for a, b in labels[pairs].tolist() if a != b}
        joined = contract(pairs, labels, 6)
        assert {tuple(pair) for pair in joined.tolist()} == expected
        assert len(joined) == len(expected)

    @given(seeds, st.integers(1, 8))
    def test_nearest_pairs_keep_what_is_near_for_either_end(self, seed, count):
        every = all_pairs(12)
        distances = np.random.default_rng(seed).permutation(len(every)).astype(float)
        near = nearest_pairs(every, distances, 12, count)
        for number, (a, b) in enumerate(every):
            ranks = [(distances[(every == end).any(axis=1)] < distances[number]).sum() for end in (a, b)]
            assert near[number] == (min(ranks) < count)
