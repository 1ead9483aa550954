"""Energies of layouts: slopes and bends against finite differences, bends without a direction that goes down."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.unwrap.border_barrier import BorderBarrier, crosses_itself
from farfield.addon.core.unwrap.plane import signed_areas
from farfield.addon.core.unwrap.rest_shapes import rest_shapes
from farfield.addon.core.unwrap.shape_barrier import ShapeBarrier, least_ratios
from farfield.addon.core.unwrap.stretch_energy import StretchEnergy, jacobians

STEP = 1e-6
seeds = st.integers(0, 2**32 - 1)


def slope_of(function, layout: np.ndarray) -> np.ndarray:
    """Slope (V * 2,) of `function` by finite differences."""
    steps = STEP * np.eye(layout.size).reshape(-1, *layout.shape)
    return np.array([(function(layout + step) - function(layout - step)) / (2.0 * STEP) for step in steps])


def triangle(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random triangle in space (3, 3), and one in the plane (3, 2), upright and not too thin."""
    random = np.random.default_rng(seed)
    layout = random.normal(size=(3, 2))
    while signed_areas(layout[None])[0] < 0.2:
        layout = random.normal(size=(3, 2))
    return random.normal(size=(3, 3)), layout


def stretch(corners: np.ndarray, weight: float = 1.3) -> StretchEnergy:
    return StretchEnergy(np.array([[0, 1, 2]]), rest_shapes(corners[None]), np.array([weight]))


@given(seeds)
def test_the_slope_of_stretch_is_its_derivative(seed):
    corners, layout = triangle(seed)
    energy = stretch(corners)
    found = slope_of(energy.value, layout)
    assert energy.slope(layout)[0] == pytest.approx(found, rel=1e-4, abs=1e-5 * np.abs(found).max())


@given(seeds)
def test_the_bend_of_stretch_is_its_second_derivative_where_that_has_no_direction_down(seed):
    corners, layout = triangle(seed)
    energy = stretch(corners)
    found = np.array([slope_of(lambda at, number=number: energy.slope(at)[0][number], layout) for number in range(6)])
    bend = energy.bend(layout)[0]
    values = np.linalg.eigvalsh(bend)
    assert values.min() > -1e-9 * values.max()
    if np.linalg.eigvalsh(found).min() > -1e-6 * values.max():
        assert bend == pytest.approx(found, abs=1e-4 * np.abs(found).max())
    direction = np.random.default_rng(seed).normal(size=6)
    assert direction @ bend @ direction >= direction @ found @ direction - 1e-4 * np.abs(found).max() * 6.0


def test_an_isometry_has_the_least_stretch_there_is():
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    energy = stretch(corners, 1.0)
    assert energy.value(corners[:, :2]) == pytest.approx(energy.least())
    assert energy.slope(corners[:, :2]) == pytest.approx(np.zeros((1, 6)), abs=1e-12)
    assert energy.value(corners[:, [1, 0]]) == np.inf


@given(seeds)
def test_the_longest_step_ends_where_the_triangle_has_no_area(seed):
    corners, layout = triangle(seed)
    move = np.random.default_rng(seed + 1).normal(size=(3, 2))
    step = stretch(corners).longest_step(layout, move)
    if np.isfinite(step):
        assert signed_areas((layout + step * move)[None])[0] == pytest.approx(0.0, abs=1e-9 * (1.0 + step**2))
    before = np.linspace(0.0, min(step, 50.0), 40, endpoint=False)
    assert (signed_areas(layout + before[:, None, None] * move) > -1e-12).all()


def test_jacobians_carry_the_surface_into_the_layout():
    corners, layout = triangle(7)
    at = jacobians(rest_shapes(corners[None]), np.array([[0, 1, 2]]), layout)
    doubled = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert at.determinants[0] == pytest.approx(2.0 * signed_areas(layout[None])[0] / doubled)
    lengths = [np.linalg.norm(points[1] - points[0]) for points in (layout, corners)]
    first, second = np.linalg.svd(np.array([[at.xx[0], at.xy[0]], [at.yx[0], at.yy[0]]]))[1]
    assert second * lengths[1] <= lengths[0] * (1.0 + 1e-9)
    assert lengths[0] <= first * lengths[1] * (1.0 + 1e-9)


@pytest.mark.parametrize("soft", [False, True])
@given(seed=seeds)
@settings(max_examples=40)
def test_the_slope_of_the_shape_barrier_is_its_derivative(seed, soft):
    _, layout = triangle(seed)
    ratio = least_ratios(layout[None])[0]
    barrier = ShapeBarrier(np.array([[0, 1, 2]]), np.array([0]), np.array([0.7]), np.array([ratio * (1.4 if soft else 0.8)]), soft)
    found = slope_of(barrier.value, layout)
    (numbers, slopes), (_, bends) = barrier.slopes(layout), barrier.bends(layout)
    assert set(numbers) == {0}
    assert slopes.sum(axis=0) == pytest.approx(found, rel=1e-4, abs=1e-5 * np.abs(found).max())
    assert np.linalg.eigvalsh(bends).min() > -1e-9 * np.abs(bends).max()


def test_the_shape_barrier_begins_above_its_bound_and_has_no_end_at_it():
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.1]])
    assert least_ratios(flat[None])[0] == pytest.approx(0.1)
    values = [
        ShapeBarrier(np.array([[0, 1, 2]]), np.array([0]), np.ones(1), np.array([bound]), False).value(flat)
        for bound in (0.05, 0.07, 0.0999, 0.1001)
    ]
    assert values[0] == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < values[1] < values[2] < values[3] == np.inf


def comb(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A border (8, 2) with two teeth, so far from each other."""
    layout = np.array([[0, 0], [3, 0], [3, 2], [1.5 + gap, 2], [1.5 + gap, 1], [1.5, 1], [1.5, 2], [0, 2]], float)
    return layout, np.stack([np.arange(8), (np.arange(8) + 1) % 8], axis=1)


def test_the_border_barrier_is_felt_within_its_reach_and_infinite_where_the_border_crosses_itself():
    values = [BorderBarrier(border, 0.2).value(layout) for layout, border in map(comb, (0.3, 0.15, 0.05, -0.1))]
    assert values[0] == 0.0
    assert 0.0 < values[1] < values[2] < values[3] == np.inf
    assert [crosses_itself(*comb(gap)) for gap in (0.3, 0.01, -0.1)] == [False, False, True]


def test_the_slope_of_the_border_barrier_is_its_derivative():
    layout, border = comb(0.1)
    layout = layout + 0.01 * np.random.default_rng(0).normal(size=layout.shape)
    barrier = BorderBarrier(border, 0.2)
    (vertices, slopes), (_, bends) = barrier.slopes(layout), barrier.bends(layout)
    total = np.zeros(layout.shape)
    np.add.at(total, vertices, slopes.reshape(-1, 3, 2))
    assert total.ravel() == pytest.approx(slope_of(barrier.value, layout), rel=1e-4, abs=1e-6)
    assert np.linalg.eigvalsh(bends).min() > -1e-9 * np.abs(bends).max()


def test_a_step_of_the_border_ends_where_it_comes_upon_itself():
    layout, border = comb(0.1)
    move = np.zeros_like(layout)
    move[3] = [-1.0, 0.0]  # beside the tooth's edge, whose line it meets
    layout[3, 1] = 1.8
    assert BorderBarrier(border, 0.2).longest_step(layout, move) == pytest.approx(0.1)


@given(seeds)
@settings(max_examples=30)
def test_crossings_are_found_wherever_they_are(seed):
    random = np.random.default_rng(seed)
    layout = random.normal(size=(24, 2)) * random.choice([0.2, 1.0, 5.0], size=(24, 1))
    border = np.stack([np.arange(24), (np.arange(24) + 1) % 24], axis=1)
    crossed = False
    for one in range(24):
        for other in range(one + 2, 24):
            if len({*border[one], *border[other]}) == 4:
                matrix = np.column_stack(
                    [layout[border[one, 1]] - layout[border[one, 0]], layout[border[other, 0]] - layout[border[other, 1]]]
                )
                at = np.linalg.solve(matrix, layout[border[other, 0]] - layout[border[one, 0]])
                crossed |= bool(((at >= 0.0) & (at <= 1.0)).all())
    assert crosses_itself(layout, border) == crossed
