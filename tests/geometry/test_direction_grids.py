"""Direction grids interpolate smoothly everywhere, including across the fold of the map."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.geometry.directions import DirectionGrid, fibonacci_sphere

GRIDS = [DirectionGrid(8), DirectionGrid(9), DirectionGrid(8, upper=True)]
NAMES = ["even", "odd", "upper"]


@pytest.mark.parametrize("grid", GRIDS, ids=NAMES)
def test_solid_angles_sum_to_the_sphere(grid):
    total = 2.0 * np.pi if grid.upper else 4.0 * np.pi
    assert grid.solid_angles.sum() == pytest.approx(total, rel=1e-12)
    samples = fibonacci_sphere(100_000)
    samples = samples[samples[:, 2] > 0.0] if grid.upper else samples
    cells = np.clip(np.floor(0.5 * (grid.to_map(samples) + 1.0) * grid.size), 0, grid.size - 1).astype(int)
    counts = np.bincount(cells[:, 1] * grid.size + cells[:, 0], minlength=len(grid))
    np.testing.assert_allclose(counts * total / len(samples), grid.solid_angles, rtol=0.05)


@pytest.mark.parametrize("grid", GRIDS, ids=NAMES)
def test_the_taps_of_a_grid_direction_are_itself(grid):
    indices, weights = grid.taps(grid.directions)
    strongest = np.where(weights > 0.5, indices, 0).sum(axis=1)
    np.testing.assert_array_equal(strongest, np.arange(len(grid)))
    np.testing.assert_allclose(weights.max(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("grid", GRIDS, ids=NAMES)
def test_interpolated_grid_directions_are_close_to_the_direction(grid):
    directions = fibonacci_sphere(4000)
    if grid.upper:
        directions = directions[directions[:, 2] > 0.25]
    indices, weights = grid.taps(directions)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    assert weights.min() >= -1e-12
    mean = np.einsum("mt,mti->mi", weights, grid.directions[indices])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((mean * directions).sum(axis=1), -1.0, 1.0))).max() < 10.0  # half a cell


@settings(max_examples=30)
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_padded_tiles_interpolate_like_taps(x, y, z):
    direction = np.array([[x, y, z]])
    if np.abs(direction).sum() < 1e-3:
        return
    for grid in GRIDS:
        values = grid.directions @ np.array([0.3, -0.7, 0.5])
        indices, weights = grid.taps(direction)
        tile = grid.pad(values)
        cell = 0.5 * (grid.to_map(direction)[0] + 1.0) * grid.size + 0.5
        low = np.minimum(np.floor(cell).astype(int), grid.size)
        t_x, t_y = cell - low
        corners = tile[low[1] : low[1] + 2, low[0] : low[0] + 2]
        lower = (1 - t_x) * corners[0, 0] + t_x * corners[0, 1]
        upper = (1 - t_x) * corners[1, 0] + t_x * corners[1, 1]
        assert (1 - t_y) * lower + t_y * upper == pytest.approx(float((values[indices] * weights).sum()), abs=1e-9)


def test_directions_below_the_horizon_are_moved_up_to_it():
    grid = DirectionGrid(8, upper=True)
    below = np.array([[0.6, 0.0, -0.8], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(grid.to_map(below)[0], grid.to_map(np.array([[1.0, 0.0, 0.0]]))[0], atol=1e-12)
    assert np.isfinite(grid.taps(below)[1]).all()
