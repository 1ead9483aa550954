"""Tests of the hierarchical clustering: costs follow equation 3, merging in rounds is as good as one pair at a time, levels nest."""

import numpy as np
import pytest
from greedy_clustering import merge_one_at_a_time, texture_waste
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.clustering.hierarchy import ClusterBounds, Clusters, find_mutual_best, merge_in_rounds
from farfield.addon.core.billboards.primitives import Primitives, from_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.geometry.proximity import neighbor_pairs
from farfield.addon.core.jobs.progress import run_to_end
from shapes import bumpy_sphere, cylinder, random_rotation, sheet, sphere

SIXTY = np.radians(60.0)
BOUNDS = ClusterBounds(error=0.01, max_normal_deviation=SIXTY, max_texture_waste=8.0)
SQUARE = sheet(1)


def merge_cost(first: TriangleMesh, second: TriangleMesh, coarsest: int = 9) -> float:
    """Return the cost of merging two meshes, one cluster each, after a random rotation, which must not matter."""
    both = concatenate([first, second])
    primitives = from_mesh(TriangleMesh(both.vertices @ random_rotation(5).T, both.triangles))
    groups = np.repeat(np.array([0, 1], np.int32), [len(first.triangles), len(second.triangles)])
    return float(Clusters(primitives, groups).merge_costs(np.array([0]), np.array([1]), BOUNDS, coarsest)[0])


def translate(mesh: TriangleMesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + [x, y, z], mesh.triangles)


def fold(angle: float) -> tuple[TriangleMesh, TriangleMesh]:
    """Return two unit squares that share the Y axis, with `angle` between their normals."""
    half = 0.5 * angle
    left = SQUARE.vertices * [-1.0, 1.0, 1.0]
    tilt = np.array([[np.cos(half), 0.0, -np.sin(half)], [0.0, 1.0, 0.0], [np.sin(half), 0.0, np.cos(half)]])
    return TriangleMesh(SQUARE.vertices @ tilt.T, SQUARE.triangles), TriangleMesh(left @ tilt, SQUARE.triangles[:, ::-1])


class TestCosts:
    """Equation 3: e_t + k e_t_max, infinite beyond a bound."""

    def test_adjacent_squares_waste_nothing(self):
        assert merge_cost(SQUARE, translate(SQUARE, x=1.0)) == pytest.approx(1.0)

    @pytest.mark.parametrize("gap", [1.0, 3.0, 13.9])
    def test_a_gap_is_waste(self, gap):
        assert merge_cost(SQUARE, translate(SQUARE, x=1.0 + gap)) == pytest.approx((2.0 + gap) / 2.0)

    def test_too_much_waste_is_forbidden(self):
        assert merge_cost(SQUARE, translate(SQUARE, x=15.1)) == np.inf

    @pytest.mark.parametrize(("errors", "level"), [(0.5, 0), (0.99, 0), (1.01, 1), (1.99, 1), (2.01, 2), (3.0, 2), (4.01, 3)])
    def test_coarser_levels_cost_more_than_any_waste(self, errors, level):
        """e_n of two rectangles on top of each other is half their distance."""
        oblong = TriangleMesh(SQUARE.vertices * [2.0, 1.0, 1.0], SQUARE.triangles)
        cost = merge_cost(oblong, translate(oblong, z=2.0 * errors * BOUNDS.error))
        assert cost == pytest.approx(0.5 + level * BOUNDS.max_texture_waste)

    def test_merges_beyond_the_coarsest_level_are_forbidden(self):
        lifted = translate(SQUARE, z=2.0 * 3.0 * BOUNDS.error)
        assert np.isfinite(merge_cost(SQUARE, lifted, coarsest=2))
        assert merge_cost(SQUARE, lifted, coarsest=1) == np.inf

    @pytest.mark.parametrize(("degrees", "allowed"), [(20.0, True), (100.0, True), (118.0, True), (122.0, False), (160.0, False)])
    def test_merges_beyond_the_normal_bound_are_forbidden(self, degrees, allowed):
        """The plane of a symmetric fold has half the angle to both halves."""
        assert np.isfinite(merge_cost(*fold(np.radians(degrees)))) == allowed

    def test_opposite_sides_never_merge(self):
        assert merge_cost(SQUARE, TriangleMesh(SQUARE.vertices + [0.0, 0.0, 1e-3], SQUARE.triangles[:, ::-1])) == np.inf

    def test_costs_do_not_depend_on_the_order_of_merges(self):
        """Merging pair by pair keeps everything that costs depend on."""
        primitives = from_mesh(bumpy_sphere(6))
        indices = np.arange(len(primitives), dtype=np.int32)
        low, high = indices[: len(indices) // 2], indices[len(indices) // 2 :]
        stepwise = Clusters(primitives, indices)
        for half in (low, high):
            while len(half) > 1:
                odd, half = half[len(half) // 2 * 2 :], half[: len(half) // 2 * 2]
                stepwise.merge(half[::2], half[1::2])
                half = np.concatenate([half[::2], odd])
        at_once = Clusters(primitives, (indices >= len(low)).astype(np.int32))
        loose_bounds = ClusterBounds(0.01, np.pi, 1e9)
        costs = stepwise.merge_costs(low[:1], high[:1], loose_bounds, 99)
        np.testing.assert_allclose(costs, at_once.merge_costs(np.array([0]), np.array([1]), loose_bounds, 99))


class TestMutualBest:
    """Mutually cheapest pairs."""

    @given(st.integers(0, 2**32 - 1), st.integers(1, 60))
    def test_pairs_are_disjoint_and_the_cheapest_of_both_ends(self, seed, count):
        random = np.random.default_rng(seed)
        pairs = np.unique(np.sort(random.integers(0, 20, (count, 2)), axis=1), axis=0)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        cost = random.integers(0, 6, len(pairs)).astype(float)  # few values give many ties
        cost[random.random(len(pairs)) < 0.3] = np.inf
        best = find_mutual_best(pairs, cost, 20)
        ends = pairs[best].reshape(-1)
        assert len(np.unique(ends)) == len(ends)
        for pair in best:
            adjacent = np.isin(pairs, pairs[pair]).any(axis=1)
            assert cost[pair] == cost[adjacent].min()
        assert (len(best) > 0) == bool(np.isfinite(cost).any())


def cluster_levels(primitives: Primitives, bounds: ClusterBounds, levels: int) -> list[np.ndarray]:
    """Return the labels (P,) of every level, each merged from the one before."""
    pairs, distances = neighbor_pairs(primitives.positions, 50)
    labels = [np.arange(len(primitives), dtype=np.int32)]
    for level in range(levels):
        labels.append(run_to_end(merge_in_rounds(primitives, labels[-1], pairs, distances, bounds, level)))
    return labels[1:]


def least_axis(primitives: Primitives, members: np.ndarray) -> np.ndarray:
    """Return the direction (3,) of least variance of the surface of `members`."""
    areas, centroids = primitives.areas[members], primitives.positions[members].mean(axis=1)
    centered = centroids - np.average(centroids, axis=0, weights=areas)
    return np.linalg.eigh(np.einsum("p,pij->ij", areas, primitives.covariances[members] + centered[:, :, None] * centered[:, None]))[1][
        :, 0
    ]


class TestRounds:
    """Rounds of mutual best pairs."""

    @pytest.mark.slow
    @pytest.mark.parametrize(("error", "level"), [(0.02, 0), pytest.param(0.05, 0, marks=pytest.mark.exhaustive), (0.02, 2)])
    @pytest.mark.parametrize("mesh", [pytest.param(sphere(12), marks=pytest.mark.exhaustive), bumpy_sphere(11)], ids=["sphere", "bumpy"])
    def test_rounds_are_about_as_good_as_one_pair_at_a_time(self, mesh, error, level):
        primitives = from_mesh(mesh)
        bounds = ClusterBounds(error, SIXTY, 8.0)
        pairs, distances = neighbor_pairs(primitives.positions, 50)
        indices = np.arange(len(primitives), dtype=np.int32)
        rounds = run_to_end(merge_in_rounds(primitives, indices, pairs, distances, bounds, level))
        single = merge_one_at_a_time(primitives, pairs, bounds, level)
        assert rounds.max() + 1 <= 1.25 * (single.max() + 1)
        assert texture_waste(primitives, rounds) <= 1.25 * texture_waste(primitives, single)

    def test_levels_nest_and_need_fewer_clusters(self):
        primitives = from_mesh(bumpy_sphere())
        counts = []
        finer = np.arange(len(primitives))
        for labels in cluster_levels(primitives, BOUNDS, 4):
            count = int(labels.max()) + 1
            np.testing.assert_array_equal(np.unique(labels), np.arange(count))
            assert len(np.unique(np.stack([finer, labels], axis=1), axis=0)) == finer.max() + 1  # one owner each
            finer = labels
            counts.append(count)
        assert (np.diff(counts) < 0).all()

    @pytest.mark.parametrize("mesh", [sphere(16), bumpy_sphere()], ids=["sphere", "bumpy"])
    def test_clusters_are_thin_and_keep_the_normal_bound(self, mesh):
        """Extents are measured along fixed directions, so points between them are missed; the cover that follows is exact."""
        primitives = from_mesh(mesh)
        bounds = ClusterBounds(0.05, SIXTY, 8.0)
        for level, labels in enumerate(cluster_levels(primitives, bounds, 3)):
            thickness = []
            for members in (labels == index for index in range(labels.max() + 1)):
                normal = least_axis(primitives, members)
                thickness.append(0.5 * np.ptp(primitives.positions[members] @ normal) / (bounds.error * 2.0**level))
                assert np.abs(primitives.normals[members] @ normal).min() >= np.cos(1.05 * SIXTY)
            assert np.median(thickness) <= 1.1
            assert max(thickness) <= 2.0

    def test_cylinder_is_split_at_the_normal_bound(self):
        """If the error does not matter, a cluster spans at most twice the bound: 17 of 48 faces 7.5 degrees apart fit in 120 degrees."""
        labels = cluster_levels(from_mesh(cylinder(sides=48, cuts=2, length=1.0)), ClusterBounds(1.0, SIXTY, 8.0), 1)[0]
        assert int(np.ceil(48 / 17)) <= labels.max() + 1 <= 6

    def test_distant_parallel_planes_stay_separate(self):
        flat = sheet(5)
        both = from_mesh(concatenate([flat, translate(flat, z=10.0 * BOUNDS.error)]))
        labels = cluster_levels(both, BOUNDS, 1)[0]
        np.testing.assert_array_equal(labels, np.repeat(labels[[0, 50]], 50))
        assert labels[0] != labels[50]

    def test_close_parallel_planes_merge(self):
        flat = sheet(5)
        assert cluster_levels(from_mesh(concatenate([flat, translate(flat, z=1.5 * BOUNDS.error)])), BOUNDS, 1)[0].max() == 0

    def test_primitives_without_pairs_stay_separate(self):
        primitives = from_mesh(sheet(2))
        labels = run_to_end(merge_in_rounds(primitives, np.arange(8, dtype=np.int32), np.empty((0, 2), np.int32), np.empty(0), BOUNDS, 0))
        np.testing.assert_array_equal(labels, np.arange(8))
