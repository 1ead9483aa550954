"""Shadow boundaries are recovered, and they stay sharp between the captured light directions."""

import numpy as np
import pytest

from farfield.addon.core.btf.capture.shard_files import UNKNOWN, encode_visibility
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.reflectance.disc_lights import DiscLights
from farfield.addon.core.btf.reflectance.shadows import MAX_ANGLE, PENUMBRA_ANGLE, Shadows, compute_shadows
from farfield.addon.core.geometry.directions import DirectionGrid, fibonacci_sphere
from farfield.addon.core.jobs.progress import run_to_end

GRID = DirectionGrid(16)
COUNT = 300
NORMALS = fibonacci_sphere(COUNT)
CELL = float(np.sqrt(GRID.solid_angles.max()))


def half_space_visibility(walls: np.ndarray, grid: DirectionGrid = GRID) -> np.ndarray:
    """Return the encoded visibility (D, N) of texels that see the half space in the direction of their `walls` (N, 3)."""
    is_visible = grid.directions @ walls.T > 0.0
    return encode_visibility(is_visible.astype(np.float32), (~is_visible).astype(np.float32))


def tilted_walls() -> np.ndarray:
    walls = NORMALS + 0.8 * np.random.default_rng(0).normal(size=3)
    return walls / np.linalg.norm(walls, axis=1, keepdims=True)


def compute(visibility: np.ndarray, components: int = 12, normals: np.ndarray = NORMALS) -> Shadows:
    return run_to_end(compute_shadows(visibility, GRID, normals, components))


def test_a_wall_hides_the_lights_behind_it():
    walls = tilted_walls()
    shadows = compute(half_space_visibility(walls))
    lights = fibonacci_sphere(500)[:, [1, 2, 0]]  # between the directions of the grid
    height = np.arcsin(np.clip(walls @ lights.T, -1.0, 1.0))
    visibility = shadows.visibility(lights)
    far_from_edge = np.abs(height) > 0.5 * PENUMBRA_ANGLE + CELL
    assert np.abs(visibility - (height > 0.0))[far_from_edge].mean() < 0.02
    assert np.abs(visibility - (height > 0.0)).mean() < 0.06


def test_shadow_boundaries_are_sharp_between_two_grid_directions():
    """Angles are interpolated: the edge moves along with a light that moves between two directions, instead of cross-fading."""
    walls = np.tile([[0.0, 0.2, 1.0]], (COUNT, 1)) / np.linalg.norm([0.0, 0.2, 1.0])
    shadows = compute(half_space_visibility(walls), components=4)
    heights = np.linspace(-0.5, 0.5, 101)
    edge = np.array([1.0, 0.0, 0.0])
    lights = np.cos(heights)[:, None] * edge + np.sin(heights)[:, None] * walls[0]
    visibility = shadows.visibility(lights, slice(0, 1))[0]
    assert abs(heights[np.argmin(np.abs(visibility - 0.5))]) < 0.5 * CELL
    assert ((visibility > 0.05) & (visibility < 0.95)).mean() < 1.5 * PENUMBRA_ANGLE  # The heights cover one radian.


def test_unoccluded_texels_see_all_lights_and_enclosed_ones_none():
    for visible_count, expected in ((9.0, 1.0), (0.0, 0.0)):
        counts = np.full((len(GRID), COUNT), visible_count)
        visibility = encode_visibility(counts, 9.0 - counts)
        np.testing.assert_allclose(compute(visibility, 2).visibility(fibonacci_sphere(50)), expected, atol=1e-3)


def test_half_transparent_occluders_give_half_visibility():
    half = np.full((len(GRID), COUNT), 4.5)
    np.testing.assert_allclose(compute(encode_visibility(half, half), 2).visibility(fibonacci_sphere(50)), 0.5, atol=0.01)


def test_unknown_entries_have_little_influence():
    visibility = half_space_visibility(tilted_walls())
    is_unknown = np.random.default_rng(1).random(visibility.shape) < 0.2
    complete, with_gaps = compute(visibility), compute(np.where(is_unknown, UNKNOWN, visibility).astype(np.uint8))
    lights = fibonacci_sphere(200)
    assert np.abs(complete.visibility(lights) - with_gaps.visibility(lights)).mean() < 0.04


def test_mean_visibility_is_the_mean_over_the_disc():
    shadows = compute(half_space_visibility(tilted_walls()), components=16)
    suns = DiscLights(DirectionGrid(6).directions, 4.0 * np.pi / 36.0)
    mean_visibility = shadows.mean_visibility(suns)
    assert mean_visibility.shape == (COUNT, 36) and mean_visibility.min() >= 0.0 and mean_visibility.max() <= 1.0
    directions = fibonacci_sphere(4000)
    for light in (0, 9, 20):
        disc = directions[directions @ suns.directions[light] > np.cos(suns.radius)]
        assert np.abs(mean_visibility[:, light] - shadows.visibility(disc).mean(axis=1)).mean() < 0.03


def test_angles_are_clamped():
    angles = compute(half_space_visibility(tilted_walls())).angles
    decoded = angles.weights @ angles.basis[:, :, 0].T
    assert np.abs(decoded).max() < 1.5 * MAX_ANGLE


@pytest.mark.parametrize(("visible", "hidden", "byte"), [(9.0, 0.0, 254), (0.0, 3.0, 0), (0.0, 0.0, UNKNOWN), (3.0, 6.0, 85)])
def test_encoded_visibility_is_the_visible_fraction(visible, hidden, byte):
    assert encode_visibility(np.array([visible]), np.array([hidden]))[0] == byte


def test_nbytes_is_the_size_as_half_floats():
    angles = Factors(np.zeros((10, 3), np.float32), np.zeros((len(GRID), 3, 1), np.float32), np.ones(10, bool))
    assert Shadows(GRID, angles).nbytes == 2 * (30 + 3 * len(GRID))
