"""Shadows come back as the angles that they were made from, sharp between the directions that were looked up."""

import numpy as np
import pytest

from farfield.addon.core.btf.broad_suns import BroadSuns
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.shadows import FARTHEST, PENUMBRA, Shadows, find_shadows
from farfield.addon.core.btf.shards import UNKNOWN, lit_bytes
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.directions import fibonacci_sphere
from farfield.addon.core.progress import finish

GRID = DirectionGrid(16)
COUNT = 300
NORMALS = fibonacci_sphere(COUNT)
CELL = float(np.sqrt(GRID.solid_angles.max()))


def half_lit(walls: np.ndarray, grid: DirectionGrid = GRID) -> np.ndarray:
    """Bytes (D, N) of texels each behind a wall: lit by what is on the side of `walls` (N, 3)."""
    return lit_bytes((grid.directions @ walls.T > 0.0).astype(np.float32), (grid.directions @ walls.T <= 0.0).astype(np.float32))


def slanting_walls() -> np.ndarray:
    walls = NORMALS + 0.8 * np.random.default_rng(0).normal(size=3)
    return walls / np.linalg.norm(walls, axis=1, keepdims=True)


def found(lit: np.ndarray, components: int = 12, normals: np.ndarray = NORMALS) -> Shadows:
    return finish(find_shadows(lit, GRID, normals, components))


def test_a_wall_shades_from_its_edge_on():
    walls = slanting_walls()
    shadows = found(half_lit(walls))
    lights = fibonacci_sphere(500)[:, [1, 2, 0]]  # between the directions of the grid
    height = np.arcsin(np.clip(walls @ lights.T, -1.0, 1.0))
    reached = shadows.reached(lights)
    clear = np.abs(height) > 0.5 * PENUMBRA + CELL
    assert np.abs(reached - (height > 0.0))[clear].mean() < 0.02
    assert np.abs(reached - (height > 0.0)).mean() < 0.06


def test_edges_stay_where_they_are_between_two_directions():
    """What is interpolated is the angle: a sun that moves from one direction to the next moves the edge along, and blends nothing."""
    walls = np.tile([[0.0, 0.2, 1.0]], (COUNT, 1)) / np.linalg.norm([0.0, 0.2, 1.0])
    shadows = found(half_lit(walls), components=4)
    heights = np.linspace(-0.5, 0.5, 101)
    edge = np.array([1.0, 0.0, 0.0])
    lights = np.cos(heights)[:, None] * edge + np.sin(heights)[:, None] * walls[0]
    reached = shadows.reached(lights, slice(0, 1))[0]
    assert abs(heights[np.argmin(np.abs(reached - 0.5))]) < 0.5 * CELL
    assert ((reached > 0.05) & (reached < 0.95)).mean() < 1.5 * PENUMBRA  # of one radian


def test_open_texels_are_always_reached_and_buried_ones_never():
    for parts, expected in ((9.0, 1.0), (0.0, 0.0)):
        lit = lit_bytes(np.full((len(GRID), COUNT), parts), np.full((len(GRID), COUNT), 9.0 - parts))
        np.testing.assert_allclose(found(lit, 2).reached(fibonacci_sphere(50)), expected, atol=1e-3)


def test_leaves_that_let_half_through_do_so():
    half = np.full((len(GRID), COUNT), 4.5)
    np.testing.assert_allclose(found(lit_bytes(half, half), 2).reached(fibonacci_sphere(50)), 0.5, atol=0.01)


def test_what_no_sun_knows_does_not_count():
    walls = slanting_walls()
    lit = half_lit(walls)
    gaps = np.random.default_rng(1).random(lit.shape) < 0.2
    known, filled = found(lit), found(np.where(gaps, UNKNOWN, lit).astype(np.uint8))
    lights = fibonacci_sphere(200)
    assert np.abs(known.reached(lights) - filled.reached(lights)).mean() < 0.04


def test_broad_suns_reach_as_their_discs_do_in_the_mean():
    walls = slanting_walls()
    shadows = found(half_lit(walls), components=16)
    suns = BroadSuns(DirectionGrid(6).directions, 4.0 * np.pi / 36.0)
    by_suns = shadows.reached_by(suns)
    assert by_suns.shape == (COUNT, 36) and by_suns.min() >= 0.0 and by_suns.max() <= 1.0
    turn = fibonacci_sphere(4000)
    for number in (0, 9, 20):
        disc = turn[turn @ suns.directions[number] > np.cos(suns.radius)]
        assert np.abs(by_suns[:, number] - shadows.reached(disc).mean(axis=1)).mean() < 0.03


def test_no_angle_is_beyond_the_farthest():
    values = found(half_lit(slanting_walls())).angles
    decoded = values.weights @ values.basis[:, :, 0].T
    assert np.abs(decoded).max() < 1.5 * FARTHEST


@pytest.mark.parametrize(("own", "hidden", "byte"), [(9.0, 0.0, 254), (0.0, 3.0, 0), (0.0, 0.0, UNKNOWN), (3.0, 6.0, 85)])
def test_bytes_say_the_share_of_what_is_there(own, hidden, byte):
    assert lit_bytes(np.array([own]), np.array([hidden]))[0] == byte


def test_bytes_are_half_floats():
    angles = Factors(np.zeros((10, 3), np.float32), np.zeros((len(GRID), 3, 1), np.float32), np.ones(10, bool))
    assert Shadows(GRID, angles).bytes == 2 * (30 + 3 * len(GRID))
