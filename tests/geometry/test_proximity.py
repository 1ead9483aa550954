"""Distances and proximity graphs equal brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry.distance import squared_point_triangle_distances
from farfield.addon.core.geometry.proximity import (
    contract,
    decode_pairs,
    nearest_pairs,
    neighbor_pairs,
    primitive_distances,
    sorted_unique,
    triangle_distances,
    unique_pair_keys,
)
from shapes import random_rotation, sheet, soup

SEEDS = st.integers(0, 2**32 - 1)
TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def all_pairs(count: int) -> np.ndarray:
    return np.stack(np.triu_indices(count, 1), axis=1).astype(np.int32)


def sampled_distance(first: np.ndarray, second: np.ndarray, steps: int = 40) -> float:
    """Return the smallest distance of a lattice of points on the triangle `first` (3, 3) to the triangle `second`."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    weights = np.stack([i, j, steps - i - j], axis=-1)[i + j <= steps] / steps
    points = weights @ first
    return float(np.sqrt(squared_point_triangle_distances(points, np.broadcast_to(second, (len(points), 3, 3))).min()))


class TestTriangleDistances:
    """Distances between two triangles."""

    @pytest.mark.parametrize(
        ("other", "distance"),
        [
            (TRIANGLE + [0.0, 0.0, 0.7], 0.7),  # face above face
            (TRIANGLE + [3.0, 0.0, 0.0], 2.0),  # corner to corner
            (np.array([[0.2, 0.2, 0.5], [0.2, 0.2, 2.0], [0.3, 0.1, 2.0]]), 0.5),  # corner above face
            (np.array([[0.5, -0.25, -1.0], [0.5, -0.25, 1.0], [0.5, -2.0, 0.0]]), 0.25),  # edge across edge
            (np.array([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [3.0, 3.0, 0.0]]), np.sqrt(0.5)),  # edge to the hypotenuse
        ],
    )
    def test_known_distances(self, other, distance):
        assert triangle_distances(TRIANGLE[None], other[None])[0] == pytest.approx(distance)
        assert triangle_distances(other[None], TRIANGLE[None])[0] == pytest.approx(distance)

    @settings(max_examples=20)
    @given(SEEDS)
    def test_distance_bounds_all_samples_and_is_approached(self, seed):
        random = np.random.default_rng(seed)
        first = random.normal(size=(3, 3))
        second = random.normal(size=(3, 3)) + random_rotation(seed)[0] * 6.0
        exact = triangle_distances(first[None], second[None])[0]
        sampled = sampled_distance(first, second)
        assert exact <= sampled * (1.0 + 1e-9)
        side = np.linalg.norm(first - np.roll(first, 1, axis=0), axis=1).max()
        assert sampled <= exact + side / 40.0

    @settings(max_examples=30)
    @given(SEEDS)
    def test_distance_is_invariant_under_similarity(self, seed):
        corners = soup(20, seed=seed, size=0.3).corners
        before = triangle_distances(corners[:10], corners[10:])
        after = triangle_distances(*np.split(3.0 * corners @ random_rotation(seed).T + [1.0, 2.0, 3.0], 2))
        is_disjoint = before > 1e-6
        np.testing.assert_allclose(after[is_disjoint], 3.0 * before[is_disjoint], rtol=1e-6)


class TestNeighborPairs:
    """Every primitive is paired with its nearest ones."""

    @settings(max_examples=15)
    @given(SEEDS, st.integers(2, 20))
    def test_small_soups_equal_brute_force(self, seed, total):
        """With as many candidates as primitives the k-d tree cannot miss any."""
        corners = soup(total, size=0.5, seed=seed).corners
        count = max(total * 4 // 5, 1)
        pairs, distances = neighbor_pairs(corners, count)
        candidates = all_pairs(total)
        table = np.full((total, total), np.inf)
        table[candidates[:, 0], candidates[:, 1]] = table[candidates[:, 1], candidates[:, 0]] = primitive_distances(corners, candidates)
        expected = set()
        for index, row in enumerate(table):
            expected |= {(min(index, other), max(index, other)) for other in np.flatnonzero(row < np.sort(row)[min(count, total - 1) - 1])}
        found = {(int(a), int(b)) for a, b in pairs}
        assert expected <= found
        np.testing.assert_array_equal(distances, table[pairs[:, 0], pairs[:, 1]])

    def test_large_soups_miss_few(self):
        corners = soup(400, size=0.1).corners
        pairs, _ = neighbor_pairs(corners, 10)
        candidates = all_pairs(400)
        nearest = candidates[nearest_pairs(candidates, primitive_distances(corners, candidates), 400, 10)]
        found = {tuple(pair) for pair in pairs.tolist()}
        assert np.mean([tuple(pair) in found for pair in nearest.tolist()]) > 0.9

    def test_pairs_are_ordered_unique_and_enough(self):
        pairs, distances = neighbor_pairs(soup(100).corners, 8)
        assert pairs.dtype == np.int32
        assert (pairs[:, 0] < pairs[:, 1]).all()
        np.testing.assert_array_equal(np.unique(pairs, axis=0), pairs)
        assert np.bincount(pairs.reshape(-1), minlength=100).min() >= 8
        assert (distances >= 0.0).all()

    def test_a_shared_corner_means_distance_zero(self):
        mesh = sheet(4)
        pairs, distances = neighbor_pairs(mesh.corners, 31)
        has_common_corner = np.array([len(np.intersect1d(mesh.triangles[a], mesh.triangles[b])) > 0 for a, b in pairs])
        np.testing.assert_array_equal(distances == 0.0, has_common_corner)
        assert len(pairs) == 32 * 31 // 2

    def test_a_large_primitive_is_paired_with_small_ones_near_its_end(self):
        """The centroid of a long wall is far from a leaf at its end."""
        wall = np.array([[[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 0.0, 100.0]]])
        near_centroid = 0.1 * soup(20).corners + [100.0 / 3.0, 20.0, 100.0 / 3.0]
        leaf = 0.1 * soup(1).corners + [0.0, 0.3, 95.0]
        near_leaf = 0.1 * soup(20).corners + [0.0, 10.0, 95.0]
        pairs, _ = neighbor_pairs(np.concatenate([wall, leaf, near_centroid, near_leaf]), 5)
        assert [0, 1] in pairs.tolist()

    @pytest.mark.parametrize("total", [0, 1])
    def test_a_single_primitive_has_no_neighbors(self, total):
        pairs, distances = neighbor_pairs(soup(total).corners, 5)
        assert pairs.shape == (0, 2) and distances.shape == (0,)

    def test_two_primitives_are_one_pair(self):
        assert neighbor_pairs(soup(2).corners, 50)[0].tolist() == [[0, 1]]

    def test_squares_are_approximated_by_discs(self):
        square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        corners = np.stack([square, square + [5.0, 0.0, 0.0], square + [1.0, 0.0, 0.0]])
        gap = 5.0 - 2.0 * np.sqrt(2.0)
        np.testing.assert_allclose(primitive_distances(corners, np.array([[0, 1], [0, 2]])), [gap, 0.0])


class TestPairs:
    """Pair keys and contracted pairs."""

    @settings(max_examples=30)
    @given(SEEDS)
    def test_keys_encode_unordered_pairs(self, seed):
        first, second = np.random.default_rng(seed).integers(0, 12, (2, 60))
        expected = sorted({(min(a, b), max(a, b)) for a, b in zip(first.tolist(), second.tolist(), strict=True) if a != b})
        assert [tuple(pair) for pair in decode_pairs(unique_pair_keys(first, second, 12), 12).tolist()] == expected

    @given(st.lists(st.integers(0, 20)))
    def test_sorted_unique_equals_numpy(self, values):
        keys = np.array(values, np.int64)
        unique, first = sorted_unique(keys)
        expected, expected_first = np.unique(keys, return_index=True)
        np.testing.assert_array_equal(unique, expected)
        np.testing.assert_array_equal(first, expected_first)

    @settings(max_examples=30)
    @given(SEEDS)
    def test_contracted_pairs_connect_groups(self, seed):
        random = np.random.default_rng(seed)
        pairs, labels = random.integers(0, 30, (50, 2)), random.integers(0, 6, 30)
        expected = {(min(a, b), max(a, b)) for a, b in labels[pairs].tolist() if a != b}
        joined = contract(pairs, labels, 6)
        assert {tuple(pair) for pair in joined.tolist()} == expected
        assert len(joined) == len(expected)

    @given(SEEDS, st.integers(1, 8))
    def test_nearest_pairs_are_near_for_either_end(self, seed, count):
        candidates = all_pairs(12)
        distances = np.random.default_rng(seed).permutation(len(candidates)).astype(float)
        near = nearest_pairs(candidates, distances, 12, count)
        for index, (a, b) in enumerate(candidates):
            ranks = [(distances[(candidates == end).any(axis=1)] < distances[index]).sum() for end in (a, b)]
            assert near[index] == (min(ranks) < count)
