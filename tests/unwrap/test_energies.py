"""Energies of UV maps: gradients and Hessians against finite differences; Hessians are positive semidefinite."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_edges
from farfield.addon.core.unwrap.energies.boundary_barrier import BoundaryBarrier, overlaps_itself, self_intersects
from farfield.addon.core.unwrap.energies.newton import minimize
from farfield.addon.core.unwrap.energies.rest_shapes import compute_rest_shapes
from farfield.addon.core.unwrap.energies.shape_barrier import ShapeBarrier, min_height_to_base
from farfield.addon.core.unwrap.energies.stretch_energy import Expansion, StretchEnergy, compute_jacobians

STEP = 1e-6
TRIANGLE = np.array([[0, 1, 2]])
BALANCED = Expansion(0.3, 0.1)
seeds = st.integers(0, 2**32 - 1)


def finite_difference_gradient(function, uv: np.ndarray) -> np.ndarray:
    steps = STEP * np.eye(uv.size).reshape(-1, *uv.shape)
    return np.array([(function(uv + step) - function(uv - step)) / (2.0 * STEP) for step in steps])


def random_triangle(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random triangle in space (3, 3), and one in the UV map (3, 2), not flipped and not too thin."""
    random = np.random.default_rng(seed)
    uv = random.normal(size=(3, 2))
    while signed_areas(uv[None])[0] < 0.2:
        uv = random.normal(size=(3, 2))
    return random.normal(size=(3, 3)), uv


def stretch_energy(corners: np.ndarray, weight: float = 1.3, expansion: Expansion = BALANCED) -> StretchEnergy:
    return StretchEnergy(TRIANGLE, compute_rest_shapes(corners[None]), np.array([weight]), expansion)


def shape_barrier(weight: float, min_ratio: float, is_soft: bool) -> ShapeBarrier:
    return ShapeBarrier(TRIANGLE, np.array([0]), np.array([weight]), np.array([min_ratio]), is_soft)


@pytest.mark.parametrize("expansion", [Expansion(0.0, 0.0), BALANCED, Expansion(1.0, 0.0)])
@given(seed=seeds)
@settings(max_examples=40)
def test_stretch_gradient_matches_finite_differences(seed, expansion):
    corners, uv = random_triangle(seed)
    energy = stretch_energy(corners, expansion=expansion)
    expected = finite_difference_gradient(energy.value, uv)
    assert energy.gradients(uv)[0] == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("expansion", [Expansion(0.0, 0.0), BALANCED, Expansion(1.0, 0.0)])
@given(seed=seeds)
@settings(max_examples=40)
def test_stretch_hessian_is_the_projected_second_derivative(seed, expansion):
    corners, uv = random_triangle(seed)
    energy = stretch_energy(corners, expansion=expansion)
    exact = np.array([finite_difference_gradient(lambda at, index=index: energy.gradients(at)[0][index], uv) for index in range(6)])
    hessian = energy.hessians(uv)[0]
    eigenvalues = np.linalg.eigvalsh(hessian)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()
    if np.linalg.eigvalsh(exact).min() > -1e-6 * eigenvalues.max():
        assert hessian == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())
    direction = np.random.default_rng(seed).normal(size=6)
    assert direction @ hessian @ direction >= direction @ exact @ direction - 1e-4 * np.abs(exact).max() * 6.0


def test_an_isometry_reaches_the_lower_bound():
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    energy = stretch_energy(corners, 1.0)
    assert energy.value(corners[:, :2]) == pytest.approx(energy.lower_bound())
    assert energy.gradients(corners[:, :2]) == pytest.approx(np.zeros((1, 6)), abs=1e-12)
    assert energy.value(corners[:, [1, 0]]) == np.inf
    assert energy.distortion_excess(3.0 * corners[:, :2]) == pytest.approx(0.0)


def test_terms_of_a_triangle_that_is_stretched_in_the_map():
    """The singular values are 4 and 1; the area is 1."""
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    uv = corners[:, :2] * [4.0, 1.0]
    assert stretch_energy(corners, 1.0, Expansion(0.0, 0.0)).terms(uv) == pytest.approx((0.5 * (1.0 + 1.0 / 16.0), 4.0))
    assert stretch_energy(corners, 1.0, Expansion(1.0, 0.0)).terms(uv)[1] == pytest.approx(0.5 * 17.0)
    assert stretch_energy(corners, 1.0, Expansion(0.5, 0.2)).terms(uv)[1] == pytest.approx(2.0 + 0.25 * 17.0 + 0.1 * (17.0 - 10.0) ** 2)
    for size in (1.0, 5.0):
        assert stretch_energy(corners, 1.0).distortion_excess(size * uv) == pytest.approx(np.sqrt(17.0 * 17.0 / 16.0) / 2.0 - 1.0)


@given(seeds)
def test_the_maximum_step_ends_where_the_triangle_has_no_area(seed):
    corners, uv = random_triangle(seed)
    displacement = np.random.default_rng(seed + 1).normal(size=(3, 2))
    step = stretch_energy(corners).max_step(uv, displacement)
    if np.isfinite(step):
        assert signed_areas((uv + step * displacement)[None])[0] == pytest.approx(0.0, abs=1e-9 * (1.0 + step**2))
    shorter_steps = np.linspace(0.0, min(step, 50.0), 40, endpoint=False)
    assert (signed_areas(uv + shorter_steps[:, None, None] * displacement) > -1e-12).all()


def test_jacobians_map_the_surface_to_the_uv_map():
    corners, uv = random_triangle(7)
    jacobians = compute_jacobians(compute_rest_shapes(corners[None]), TRIANGLE, uv)
    double_area = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert jacobians.determinants[0] == pytest.approx(2.0 * signed_areas(uv[None])[0] / double_area)
    uv_length, length = (np.linalg.norm(positions[1] - positions[0]) for positions in (uv, corners))
    largest, smallest = np.linalg.svd(np.array([[jacobians.xx[0], jacobians.xy[0]], [jacobians.yx[0], jacobians.yy[0]]]))[1]
    assert smallest * length <= uv_length * (1.0 + 1e-9)
    assert uv_length <= largest * length * (1.0 + 1e-9)


@pytest.mark.parametrize("is_soft", [False, True])
@given(seed=seeds)
@settings(max_examples=40)
def test_shape_barrier_gradient_matches_finite_differences(seed, is_soft):
    _, uv = random_triangle(seed)
    ratio = min_height_to_base(uv[None])[0]
    barrier = shape_barrier(0.7, ratio * (1.4 if is_soft else 0.8), is_soft)
    expected = finite_difference_gradient(barrier.value, uv)
    (indices, gradients), (_, hessians) = barrier.gradients(uv), barrier.hessians(uv)
    assert set(indices) == {0}
    assert gradients.sum(axis=0) == pytest.approx(expected, rel=1e-4, abs=1e-5 * np.abs(expected).max())
    assert np.linalg.eigvalsh(hessians).min() > -1e-9 * np.abs(hessians).max()


def test_the_shape_barrier_sets_in_above_its_limit_and_is_infinite_at_it():
    thin = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.1]])
    assert min_height_to_base(thin[None])[0] == pytest.approx(0.1)
    values = [shape_barrier(1.0, limit, False).value(thin) for limit in (0.05, 0.07, 0.0999, 0.1001)]
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < values[1] < values[2] < values[3] == np.inf


def comb(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A boundary (8, 2) with two teeth at the distance `gap`, and its edges."""
    uv = np.array([[0, 0], [3, 0], [3, 2], [1.5 + gap, 2], [1.5 + gap, 1], [1.5, 1], [1.5, 2], [0, 2]], float)
    return uv, np.stack([np.arange(8), (np.arange(8) + 1) % 8], axis=1)


def test_the_boundary_barrier_sets_in_at_its_distance_and_is_infinite_at_an_intersection():
    values = [BoundaryBarrier(boundary, 0.2).value(uv) for uv, boundary in map(comb, (0.3, 0.15, 0.05, -0.1))]
    assert values[0] == 0.0
    assert 0.0 < values[1] < values[2] < values[3] == np.inf
    assert [self_intersects(*comb(gap)) for gap in (0.3, 0.01, -0.1)] == [False, False, True]


def test_boundary_barrier_gradient_matches_finite_differences():
    uv, boundary = comb(0.1)
    uv = uv + 0.01 * np.random.default_rng(0).normal(size=uv.shape)
    barrier = BoundaryBarrier(boundary, 0.2)
    (vertices, gradients), (_, hessians) = barrier.gradients(uv), barrier.hessians(uv)
    total = np.zeros(uv.shape)
    np.add.at(total, vertices, gradients.reshape(-1, 3, 2))
    assert total.ravel() == pytest.approx(finite_difference_gradient(barrier.value, uv), rel=1e-4, abs=1e-6)
    assert np.linalg.eigvalsh(hessians).min() > -1e-9 * np.abs(hessians).max()


def test_the_maximum_step_of_the_boundary_ends_at_contact():
    uv, boundary = comb(0.1)
    displacement = np.zeros_like(uv)
    displacement[3] = [-1.0, 0.0]  # towards the line of the opposite tooth's edge
    uv[3, 1] = 1.8
    assert BoundaryBarrier(boundary, 0.2).max_step(uv, displacement) == pytest.approx(0.1)


@given(seeds)
@settings(max_examples=30)
def test_self_intersections_equal_the_test_of_every_pair(seed):
    random = np.random.default_rng(seed)
    uv = random.normal(size=(24, 2)) * random.choice([0.2, 1.0, 5.0], size=(24, 1))
    boundary = np.stack([np.arange(24), (np.arange(24) + 1) % 24], axis=1)
    expected = False
    for first in range(24):
        for second in range(first + 2, 24):
            if len({*boundary[first], *boundary[second]}) == 4:
                (a, b), (c, d) = uv[boundary[first]], uv[boundary[second]]
                t = np.linalg.solve(np.column_stack([b - a, c - d]), c - a)
                expected |= bool(((t >= 0.0) & (t <= 1.0)).all())
    assert self_intersects(uv, boundary) == expected


class FlatEnergy:
    """An energy that is the same everywhere: its Hessian is singular."""

    def value(self, _uv: np.ndarray) -> float:
        return 1.0

    def gradient(self, uv: np.ndarray) -> np.ndarray:
        return np.zeros(uv.size)

    def hessian(self, uv: np.ndarray) -> sparse.csc_array:
        return sparse.csc_array((uv.size, uv.size))


def test_a_singular_hessian_ends_the_search_where_it_is():
    uv = np.arange(6.0).reshape(3, 2)
    assert np.array_equal(run_to_end(minimize(FlatEnergy(), uv, 1e-3, 5)), uv)


@pytest.mark.parametrize(("fan", "first", "expected"), [(290.0, 300.0, False), (320.0, 220.0, True)])
def test_triangles_around_a_vertex_overlap_if_they_fill_more_than_a_circle(fan, first, expected):
    """A fan, and a small triangle of 50 degrees that has only its apex in common with it: their boundaries do not intersect."""
    angles = np.radians([*np.linspace(0.0, fan, 13), first, first + 50.0])
    lengths = np.array([*np.ones(13), 0.2, 0.2])
    uv = np.concatenate([[[0.0, 0.0]], lengths[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])])
    triangles = np.array([*((0, k, k + 1) for k in range(1, 13)), (0, 14, 15)])
    assert not self_intersects(uv, boundary_edges(triangles))
    assert overlaps_itself(uv, triangles) == expected
