"""Landscapes: gradients of noise, gullies along the gradient, and the same ground in all boxes."""

import numpy as np
import pytest
from scipy.ndimage import label

from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import landscapes
from farfield.addon.core.clipbox.terrains.caverns import CARVINGS, add_dripstone, carve
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.terrains.height_noise import Gullies, Heights, carve_gullies, resolve, simplex_noise, sum_octaves
from farfield.addon.core.clipbox.terrains.landscape_parts import Shape
from farfield.addon.core.clipbox.terrains.landscapes import LANDSCAPES, build_landscape, find_base, read_shape

STEP = 1e-3


def positions(count: int, spacing: float, origin: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """The coordinates (N, N) of a square grid."""
    x, y = (start + spacing * np.arange(count) for start in origin)
    return np.broadcast_arrays(x[:, None], y[None, :])


def gradient_errors(function) -> float:
    """The largest difference between gradients of a function of positions and differences of its heights, relative to the longest one."""
    x, y = positions(60, 0.13)
    heights = function(x, y)
    along_x = (function(x + STEP, y).height - function(x - STEP, y).height) / (2.0 * STEP)
    along_y = (function(x, y + STEP).height - function(x, y - STEP).height) / (2.0 * STEP)
    errors = np.maximum(np.abs(along_x - heights.gradient_x), np.abs(along_y - heights.gradient_y))
    return float(np.quantile(errors, 0.99) / heights.steepness.max())


def tilted(gradient_x: float, gradient_y: float, x: np.ndarray, y: np.ndarray) -> Heights:
    flat = np.zeros(x.shape, np.float32)
    return Heights((gradient_x * x + gradient_y * y).astype(np.float32), flat + np.float32(gradient_x), flat + np.float32(gradient_y))


class TestNoise:
    def test_gradients_are_derivatives(self):
        assert gradient_errors(lambda x, y: simplex_noise(x, y, 3)) < 0.01
        assert gradient_errors(lambda x, y: sum_octaves(x, y, 0.01, 4.0, 4, 3)) < 0.01

    def test_gradients_of_warped_noise_are_derivatives(self):
        assert gradient_errors(lambda x, y: landscapes.warp(lambda x, y: simplex_noise(x, y, 1), x, y, 0.01, 6.0, 0.5, 2)) < 0.02

    def test_noise_fills_its_range_evenly_around_0(self):
        height = simplex_noise(*positions(300, 0.37), 5).height
        assert abs(height.mean()) < 0.03 and 0.8 < height.max() <= 1.0 and -1.0 <= height.min() < -0.8

    def test_octaves_fade_where_samples_cannot_resolve_them(self):
        assert [resolve(wavelength, 1.0) for wavelength in (2.0, 3.0, 7.0, 100.0)] == [0.0, 0.0, 1.0, 1.0]
        shown = [resolve(wavelength, 1.0) for wavelength in np.linspace(3.0, 7.0, 9)]
        assert shown == sorted(shown) and np.abs(np.diff(shown)).max() < 0.2
        x, y = positions(40, 50.0)
        coarse, fine = (sum_octaves(x, y, spacing, 800.0, octaves, 1).height for spacing, octaves in ((50.0, 6), (0.1, 2)))
        np.testing.assert_allclose(coarse, fine, atol=0.3)
        assert not sum_octaves(x, y, 400.0, 800.0, 6, 1).height.any()


class TestGullies:
    GULLIES = Gullies(16.0, 1, 0.2, 0.5, 0.3)

    @pytest.mark.parametrize("gradient", [(0.7, 0.0), (0.0, -0.7), (0.5, 0.5)])
    def test_they_run_along_the_gradient(self, gradient):
        x, y = positions(120, 0.5)
        eroded = carve_gullies(tilted(*gradient, x, y), x, y, 0.5, self.GULLIES, 4)
        depth = (eroded.height - tilted(*gradient, x, y).height).astype(float)
        along_x, along_y = np.gradient(depth, 0.5)
        down, across = (np.abs(along_x * u + along_y * v).mean() for u, v in (gradient, (-gradient[1], gradient[0])))
        assert across > 2.5 * down

    def test_level_ground_has_none_and_steeper_ground_deeper_ones(self):
        x, y = positions(80, 0.5)
        depths = []
        for steepness in (0.0, 0.1, 1.0):
            ground = tilted(steepness, 0.0, x, y)
            depths.append(float(np.ptp(carve_gullies(ground, x, y, 0.5, self.GULLIES, 4).height - ground.height)))
        assert depths[0] == 0.0 and depths[2] > 2.0 * depths[1] > 0.0

    def test_they_fade_where_samples_cannot_resolve_them(self):
        x, y = positions(20, 8.0)
        ground = tilted(0.5, 0.2, x, y)
        np.testing.assert_array_equal(carve_gullies(ground, x, y, 8.0, self.GULLIES, 4).height, ground.height)


@pytest.mark.parametrize("name", LANDSCAPES)
class TestLandscapes:
    def test_coarse_boxes_show_the_ground_of_fine_ones(self, name):
        shape, (x, y) = read_shape(ClipboxSettings(terrain=name)), positions(24, 64.0)
        fine, coarse = (LANDSCAPES[name](x, y, spacing, shape).height for spacing in (1.0, 32.0))
        assert np.median(np.abs(fine - coarse)) < 0.12 * np.ptp(fine)

    def test_the_ground_is_where_densities_change_their_sign(self, name):
        source = ClipboxSettings(terrain=name, voxel_size=8.0)
        densities = build_landscape(source, None)(Grid((3, -5, -250), (4, 4, 500), 8.0)) > 0
        (x, y), shape = positions(4, 8.0, (28.0, -36.0)), read_shape(source)
        surface = 8.0 * (densities.sum(axis=2) - 250)
        assert np.abs(surface - LANDSCAPES[name](x, y, 8.0, shape).height + find_base(name, shape)).max() < 12.0

    def test_gradients_without_gullies_are_derivatives(self, name):
        shape, (x, y), step = Shape(0, 1.0, 0.0), positions(80, 13.0, (-1200.0, -1700.0)), 0.05
        heights, ground = LANDSCAPES[name](x, y, 1.0, shape), LANDSCAPES[name]
        along_x = (ground(x + step, y, 1.0, shape).height - ground(x - step, y, 1.0, shape).height) / (2.0 * step)
        along_y = (ground(x, y + step, 1.0, shape).height - ground(x, y - step, 1.0, shape).height) / (2.0 * step)
        errors = np.hypot(along_x - heights.gradient_x, along_y - heights.gradient_y)
        assert np.quantile(errors, 0.95) < 0.02 * heights.steepness.mean()

    def test_ruggedness_raises_mountains(self, name):
        x, y = positions(40, 200.0)
        low, high = (
            np.ptp(LANDSCAPES[name](x, y, 1.0, read_shape(ClipboxSettings(terrain=name, ruggedness=r))).height) for r in (0.5, 1.5)
        )
        assert high > 1.5 * low


@pytest.mark.parametrize("name", CARVINGS)
def test_caves_arches_and_roots_are_no_heights(name):
    grid = Grid((-70, -70, -20), (140, 140, 50), 3.0)
    solid = build_sampler(ClipboxSettings(terrain=name)).densities(grid) > 0
    below_rock = np.flip(np.cumsum(np.flip(solid, axis=2), axis=2), axis=2) > 0
    assert (below_rock & ~solid).any(axis=2).mean() > 0.02


def test_dripstone_grows_in_halls_under_thick_roofs_and_as_voxels_resolve_it():
    side = np.full((120, 120), 6.0)
    counts = []
    for roof, voxel_size in ((1.0, 1.0), (0.0, 1.0), (1.0, 4.0)):
        grid = Grid((0, 0, -20), (120, 120, 40), voxel_size)
        _, _, z = grid.coordinates()
        walls = np.broadcast_to(np.abs(z) - 6.0, grid.shape).astype(np.float32)
        hall = walls < 0
        add_dripstone(walls, grid, 0.0 * side, side, roof + 0.0 * side, 3)
        counts.append(float((walls > 0)[hall].mean()))
        assert (walls >= 0)[~hall].all()
    assert 0.005 < counts[0] < 0.2 and counts[1:] == [0.0, 0.0]


def test_rock_between_a_cave_and_the_air_is_thicker_than_a_voxel_or_open():
    depth = np.linspace(-1.0, 20.0, 200).astype(np.float32)  # Into a cliff, behind which there is a cave.
    for thickness in (0.5, 1.0, 1.5, 4.0, 8.0):
        solid = carve(depth, np.float32(thickness) - depth, 1.0) > 0
        assert solid.any() == (thickness > 2.0)


@pytest.mark.parametrize(
    ("name", "x", "y"),
    [
        ("mesas", -400, 700),
        ("mesas", 1200, 700),
        ("arches", 0, -900),
        ("karst", -800, 100),
        ("karst", 0, -900),
        ("alien", 400, -300),
        ("lava", -760, -1100),
    ],
)
def test_nothing_floats_above_the_ground(name, x, y):
    solid = build_sampler(ClipboxSettings(terrain=name)).densities(Grid((x, y, -80), (80, 80, 250), 1.0)) > 0
    components, _ = label(solid)
    outside = np.ones_like(solid)
    outside[1:-1, 1:-1, 1:-1] = False  # What leaves the window may reach the ground there.
    assert set(np.unique(components[solid])) <= set(np.unique(components[outside]))
