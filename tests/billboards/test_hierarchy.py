"""Merging costs what equation 3 says, rounds of merges are as good as one merge at a time, and levels nest."""

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import environment
from farfield.addon.core.billboards.hierarchy import ClusterBounds, Clusters, merge_in_rounds, mutual_best
from farfield.addon.core.billboards.primitives import Primitives, from_mesh
from farfield.addon.core.mesh import TriangleMesh, merge
from farfield.addon.core.progress import finish
from farfield.addon.core.spatial import neighbour_pairs
from shapes import bumpy_sphere, cylinder, rotation, sheet, sphere

sys.path.append(str(environment.ROOT / "benchmarks"))  # behind the scripts, some of which share names with benchmarks

from one_at_a_time import merge_one_at_a_time, texture_waste

SIXTY = np.radians(60.0)
BOUNDS = ClusterBounds(error=0.01, max_normal_deviation=SIXTY, max_texture_waste=8.0)
SQUARE = sheet(1)


def cost_of_two(first: TriangleMesh, second: TriangleMesh, coarsest: int = 9) -> float:
    """Cost of merging two meshes, each one cluster, turned at random: a cost knows no directions."""
    both = merge([first, second])
    primitives = from_mesh(TriangleMesh(both.vertices @ rotation(5).T, both.triangles))
    groups = np.repeat(np.array([0, 1], np.int32), [len(first.triangles), len(second.triangles)])
    return float(Clusters(primitives, groups).costs(np.array([0]), np.array([1]), BOUNDS, coarsest)[0])


def moved(mesh: TriangleMesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> TriangleMesh:
    return TriangleMesh(mesh.vertices + [x, y, z], mesh.triangles)


def folded(angle: float) -> tuple[TriangleMesh, TriangleMesh]:
    """Two unit squares that share the Y axis, their normals `angle` apart."""
    half = 0.5 * angle
    left = SQUARE.vertices * [-1.0, 1.0, 1.0]
    tilt = np.array([[np.cos(half), 0.0, -np.sin(half)], [0.0, 1.0, 0.0], [np.sin(half), 0.0, np.cos(half)]])
    return TriangleMesh(SQUARE.vertices @ tilt.T, SQUARE.triangles), TriangleMesh(left @ tilt, SQUARE.triangles[:, ::-1])


class TestCosts:
    """Equation 3: e_t + k e_t_max, infinite beyond a bound."""

    def test_two_squares_side_by_side_waste_nothing(self):
        assert cost_of_two(SQUARE, moved(SQUARE, x=1.0)) == pytest.approx(1.0)

    @pytest.mark.parametrize("gap", [1.0, 3.0, 13.9])
    def test_a_gap_is_waste(self, gap):
        assert cost_of_two(SQUARE, moved(SQUARE, x=1.0 + gap)) == pytest.approx((2.0 + gap) / 2.0)

    def test_too_much_waste_is_forbidden(self):
        assert cost_of_two(SQUARE, moved(SQUARE, x=15.1)) == np.inf

    @pytest.mark.parametrize(("errors", "level"), [(0.5, 0), (0.99, 0), (1.01, 1), (1.99, 1), (2.01, 2), (3.0, 2), (4.01, 3)])
    def test_each_coarser_level_costs_more_than_any_waste(self, errors, level):
        """e_n of two rectangles over each other is half their distance."""
        oblong = TriangleMesh(SQUARE.vertices * [2.0, 1.0, 1.0], SQUARE.triangles)
        cost = cost_of_two(oblong, moved(oblong, z=2.0 * errors * BOUNDS.error))
        assert cost == pytest.approx(0.5 + level * BOUNDS.max_texture_waste)

    def test_beyond_the_coarsest_level_it_is_forbidden(self):
        lifted = moved(SQUARE, z=2.0 * 3.0 * BOUNDS.error)
        assert np.isfinite(cost_of_two(SQUARE, lifted, coarsest=2))
        assert cost_of_two(SQUARE, lifted, coarsest=1) == np.inf

    @pytest.mark.parametrize(("degrees", "allowed"), [(20.0, True), (100.0, True), (118.0, True), (122.0, False), (160.0, False)])
    def test_normals_stay_within_their_bound(self, degrees, allowed):
        """The plane of a symmetric fold faces both halves at half the angle."""
        assert np.isfinite(cost_of_two(*folded(np.radians(degrees)))) == allowed

    def test_opposite_sides_never_merge(self):
        assert cost_of_two(SQUARE, TriangleMesh(SQUARE.vertices + [0.0, 0.0, 1e-3], SQUARE.triangles[:, ::-1])) == np.inf

    def test_merged_clusters_cost_what_a_cluster_of_all_costs(self):
        """Merging step by step forgets nothing that costs depend on."""
        primitives = from_mesh(bumpy_sphere(6))
        every = np.arange(len(primitives), dtype=np.int32)
        low, high = every[: len(every) // 2], every[len(every) // 2 :]
        stepwise = Clusters(primitives, every)
        for half in (low, high):
            while len(half) > 1:
                odd, half = half[len(half) // 2 * 2 :], half[: len(half) // 2 * 2]
                stepwise.merge(half[::2], half[1::2])
                half = np.concatenate([half[::2], odd])
        at_once = Clusters(primitives, (every >= len(low)).astype(np.int32))
        open_bounds = ClusterBounds(0.01, np.pi, 1e9)
        first = stepwise.costs(low[:1], high[:1], open_bounds, 99)
        np.testing.assert_allclose(first, at_once.costs(np.array([0]), np.array([1]), open_bounds, 99))


class TestMutualBest:
    """Pairs that are each other's best."""

    @given(st.integers(0, 2**32 - 1), st.integers(1, 60))
    def test_they_are_disjoint_and_the_cheapest_of_both_ends(self, seed, count):
        random = np.random.default_rng(seed)
        pairs = np.unique(np.sort(random.integers(0, 20, (count, 2)), axis=1), axis=0)
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
        cost = random.integers(0, 6, len(pairs)).astype(float)  # few values: many ties
        cost[random.random(len(pairs)) < 0.3] = np.inf
        best = mutual_best(pairs, cost, 20)
        ends = pairs[best].reshape(-1)
        assert len(np.unique(ends)) == len(ends)
        for pair in best:
            beside = np.isin(pairs, pairs[pair]).any(axis=1)
            assert cost[pair] == cost[beside].min()
        assert (len(best) > 0) == bool(np.isfinite(cost).any())


def clustered(primitives: Primitives, bounds: ClusterBounds, levels: int) -> list[np.ndarray]:
    """Labels (P,) of every level, each merged from the one before."""
    pairs, distances = neighbour_pairs(primitives.positions, 50)
    labels = [np.arange(len(primitives), dtype=np.int32)]
    for level in range(levels):
        labels.append(finish(merge_in_rounds(primitives, labels[-1], pairs, distances, bounds, level)))
    return labels[1:]


def least_axis(primitives: Primitives, members: np.ndarray) -> np.ndarray:
    """The direction (3,) in which the surface of `members` spreads least."""
    areas, middles = primitives.areas[members], primitives.positions[members].mean(axis=1)
    centred = middles - np.average(middles, axis=0, weights=areas)
    return np.linalg.eigh(np.einsum("p,pij->ij", areas, primitives.covariances[members] + centred[:, :, None] * centred[:, None]))[1][:, 0]


class TestRounds:
    """Rounds of mutual best pairs."""

    @pytest.mark.parametrize(("error", "level"), [(0.02, 0), (0.05, 0), (0.02, 2)])
    @pytest.mark.parametrize("mesh", [sphere(12), bumpy_sphere(11)], ids=["sphere", "bumpy"])
    def test_they_are_about_as_good_as_one_at_a_time(self, mesh, error, level):
        primitives = from_mesh(mesh)
        bounds = ClusterBounds(error, SIXTY, 8.0)
        pairs, distances = neighbour_pairs(primitives.positions, 50)
        every = np.arange(len(primitives), dtype=np.int32)
        rounds = finish(merge_in_rounds(primitives, every, pairs, distances, bounds, level))
        single = merge_one_at_a_time(primitives, pairs, bounds, level)
        assert rounds.max() + 1 <= 1.25 * (single.max() + 1)
        assert texture_waste(primitives, rounds) <= 1.25 * texture_waste(primitives, single)

    def test_levels_nest_and_need_fewer_clusters(self):
        primitives = from_mesh(bumpy_sphere())
        counts = []
        below = np.arange(len(primitives))
        for labels in clustered(primitives, BOUNDS, 4):
            count = int(labels.max()) + 1
            np.testing.assert_array_equal(np.unique(labels), np.arange(count))
            assert len(np.unique(np.stack([below, labels], axis=1), axis=0)) == below.max() + 1  # one owner each
            below = labels
            counts.append(count)
        assert (np.diff(counts) < 0).all()

    @pytest.mark.parametrize("mesh", [sphere(16), bumpy_sphere()], ids=["sphere", "bumpy"])
    def test_clusters_are_thin_and_face_one_way(self, mesh):
        """Extents are taken along fixed directions and miss relief between them; the cover that follows is exact."""
        primitives = from_mesh(mesh)
        bounds = ClusterBounds(0.05, SIXTY, 8.0)
        for level, labels in enumerate(clustered(primitives, bounds, 3)):
            thickness = []
            for members in (labels == number for number in range(labels.max() + 1)):
                across = least_axis(primitives, members)
                thickness.append(0.5 * np.ptp(primitives.positions[members] @ across) / (bounds.error * 2.0**level))
                assert np.abs(primitives.normals[members] @ across).min() >= np.cos(1.05 * SIXTY)
            assert np.median(thickness) <= 1.1
            assert max(thickness) <= 2.0

    def test_a_wide_cylinder_is_cut_where_the_angle_bound_says(self):
        """Without an error to heed, a cluster spans at most twice the bound: of 48 faces 7.5 degrees apart 17 fit in 120 degrees."""
        labels = clustered(from_mesh(cylinder(sides=48, cuts=2, length=1.0)), ClusterBounds(1.0, SIXTY, 8.0), 1)[0]
        assert int(np.ceil(48 / 17)) <= labels.max() + 1 <= 6

    def test_two_far_parallel_planes_stay_two(self):
        flat = sheet(5)
        both = from_mesh(merge([flat, moved(flat, z=10.0 * BOUNDS.error)]))
        labels = clustered(both, BOUNDS, 1)[0]
        np.testing.assert_array_equal(labels, np.repeat(labels[[0, 50]], 50))
        assert labels[0] != labels[50]

    def test_two_near_parallel_planes_become_one(self):
        flat = sheet(5)
        assert clustered(from_mesh(merge([flat, moved(flat, z=1.5 * BOUNDS.error)])), BOUNDS, 1)[0].max() == 0

    def test_what_no_pair_joins_stays_apart(self):
        primitives = from_mesh(sheet(2))
        alone = finish(merge_in_rounds(primitives, np.arange(8, dtype=np.int32), np.empty((0, 2), np.int32), np.empty(0), BOUNDS, 0))
        np.testing.assert_array_equal(alone, np.arange(8))
