"""Grids of directions interpolate smoothly everywhere, over the fold of the map as well."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.directions import fibonacci_sphere

GRIDS = [DirectionGrid(8), DirectionGrid(9), DirectionGrid(8, upper=True)]
names = ["even", "odd", "upper"]


@pytest.mark.parametrize("grid", GRIDS, ids=names)
def test_solid_angles_fill_the_sphere(grid):
    whole = 2.0 * np.pi if grid.upper else 4.0 * np.pi
    assert grid.solid_angles.sum() == pytest.approx(whole, rel=1e-12)
    even = fibonacci_sphere(100_000)
    even = even[even[:, 2] > 0.0] if grid.upper else even
    cells = np.clip(np.floor(0.5 * (grid.places(even) + 1.0) * grid.size), 0, grid.size - 1).astype(int)
    counts = np.bincount(cells[:, 1] * grid.size + cells[:, 0], minlength=len(grid))
    np.testing.assert_allclose(counts * whole / len(even), grid.solid_angles, rtol=0.05)


@pytest.mark.parametrize("grid", GRIDS, ids=names)
def test_a_grid_direction_is_its_own_tap(grid):
    numbers, weights = grid.taps(grid.directions)
    found = np.where(weights > 0.5, numbers, 0).sum(axis=1)
    np.testing.assert_array_equal(found, np.arange(len(grid)))
    np.testing.assert_allclose(weights.max(axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("grid", GRIDS, ids=names)
def test_interpolated_directions_are_near_the_direction(grid):
    wanted = fibonacci_sphere(4000)
    if grid.upper:
        wanted = wanted[wanted[:, 2] > 0.25]
    numbers, weights = grid.taps(wanted)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    assert weights.min() >= -1e-12
    mean = np.einsum("mt,mti->mi", weights, grid.directions[numbers])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((mean * wanted).sum(axis=1), -1.0, 1.0))).max() < 10.0  # half a cell


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_bordered_tiles_interpolate_as_taps_do(x, y, z):
    direction = np.array([[x, y, z]])
    if np.abs(direction).sum() < 1e-3:
        return
    for grid in GRIDS:
        values = grid.directions @ np.array([0.3, -0.7, 0.5])
        numbers, weights = grid.taps(direction)
        tile = grid.bordered(values)
        cell = 0.5 * (grid.places(direction)[0] + 1.0) * grid.size + 0.5
        low = np.minimum(np.floor(cell).astype(int), grid.size)
        right, up = cell - low
        around = tile[low[1] : low[1] + 2, low[0] : low[0] + 2]
        looked_up = (1 - up) * ((1 - right) * around[0, 0] + right * around[0, 1]) + up * (
            (1 - right) * around[1, 0] + right * around[1, 1]
        )
        assert looked_up == pytest.approx(float((values[numbers] * weights).sum()), abs=1e-9)


def test_below_the_horizon_counts_as_on_it():
    grid = DirectionGrid(8, upper=True)
    below = np.array([[0.6, 0.0, -0.8], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(grid.places(below)[0], grid.places(np.array([[1.0, 0.0, 0.0]]))[0], atol=1e-12)
    assert np.isfinite(grid.taps(below)[1]).all()
