"""Noise, spheres and formulas. Densities must not depend on the grid that is sampled."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import noise
from farfield.addon.core.clipbox.terrains.formulas import Formula
from farfield.addon.core.clipbox.terrains.generators import BUILDERS, Sampler, build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.terrains.hashing import hash_lattice, uniform_random
from farfield.addon.core.clipbox.terrains.height_noise import Gullies, carve_gullies, sum_octaves
from farfield.addon.core.clipbox.terrains.spheres import (
    MAX_DISTANCE,
    SURFACE_MARGIN,
    SphereField,
    Spheres,
    csg_density,
    find_touching_spheres,
)
from farfield.addon.core.errors import GeometryError, SettingsError

PROCEDURAL = [name for name in BUILDERS if name not in ("heights", "volume", "forest")]
FIELD = SphereField(max_radius=12.0, class_count=3, spheres_per_cell=3, subtracted_fraction=0.4, max_height=20.0, seed=5)


def sampler(name, **changes):
    return build_sampler(ClipboxSettings(terrain=name, **changes))


@given(seed=st.integers(0, 2**32 - 1), start=st.floats(-1e6, 1e6))
def test_heights_do_not_depend_on_which_samples_are_computed_together(seed, start):
    places = start + 40.0 * np.random.default_rng(seed).random((2, 25))
    x, y = np.broadcast_arrays(places[0][:, None], places[1])
    gullies = Gullies(9.0, 2, 0.1, 0.8, 0.3)

    def compute(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        heights = carve_gullies(sum_octaves(x, y, 0.5, 20.0, 3, seed % 1000), x, y, 0.5, gullies, 7)
        return np.stack([heights.height, heights.gradient_x, heights.gradient_y])

    together = compute(x, y)  # Close to each other: more samples than points of the lattices.
    assert np.array_equal(compute(x[:, :1], y[:, :1]), together[:, :, :1])
    scattered = compute(np.append(x[:, :1], [[5e6]], axis=0), np.append(y[:, :1], [[-3e6]], axis=0))
    assert np.array_equal(scattered[:, :-1], together[:, :, :1])


@pytest.mark.parametrize("name", PROCEDURAL)
@pytest.mark.parametrize("voxel_size", [0.5, 4.0, 64.0])
def test_slabs_equal_parts_of_the_grid_to_the_bit(name, voxel_size):
    terrain = sampler(name)
    all_densities = terrain.densities(Grid((-7, 12, -9), (16, 15, 14), voxel_size))
    for low, high in (((3, 0, 0), (4, 15, 14)), ((0, 14, 0), (16, 15, 14)), ((0, 0, 6), (16, 15, 7)), ((2, 3, 4), (9, 8, 11))):
        part = terrain.densities(Grid(tuple(np.add((-7, 12, -9), low).tolist()), tuple(np.subtract(high, low).tolist()), voxel_size))
        assert part.tobytes() == all_densities[tuple(slice(*span) for span in zip(low, high, strict=True))].tobytes()


@pytest.mark.parametrize("name", PROCEDURAL)
def test_terrains_have_ground_and_air(name):
    solid = sampler(name).densities(Grid((-40, -40, -40), (80, 80, 80), 4.0)) > 0
    assert 0.02 < solid.mean() < 0.98


@pytest.mark.parametrize("name", ["cascades", "islands", "spheres"])
def test_the_seed_determines_the_terrain(name):
    grid = Grid((0, 0, -20), (24, 24, 40), 2.0)
    first, again, other = (sampler(name, seed=seed).densities(grid) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes() and first.tobytes() != other.tobytes()


def test_scale_enlarges_features():
    fine = sampler("cascades").densities(Grid((0, 0, 0), (12, 12, 12), 2.0))
    large = sampler("cascades", scale=4.0).densities(Grid((0, 0, 0), (12, 12, 12), 8.0))
    assert np.allclose(4.0 * fine.astype(np.float32), large, rtol=2e-3, atol=0.05)


class TestNoise:
    """Gradient noise on grids."""

    def test_noise_is_the_sum_over_eight_lattice_gradients(self):
        grid, wavelength = Grid((-5, 3, 7), (6, 5, 4), 1.0), 3.7
        values = noise.gradient_noise(grid, wavelength, 11)
        for index in np.ndindex(*grid.shape):
            position = np.array([grid.coordinates_along(axis)[index[axis]] for axis in range(3)]) / wavelength
            total = 0.0
            for corner in np.ndindex(2, 2, 2):
                lattice = np.floor(position).astype(np.int64) + corner
                offset = position - lattice
                weight = 1.0 - np.abs(offset)
                weight = weight**3 * (weight * (weight * 6.0 - 15.0) + 10.0)
                bits = hash_lattice(*lattice[:, None], 11)[0] & np.uint32(noise.GRADIENT_COUNT - 1)
                total += weight.prod() * noise._gradient_table()[:, bits] @ offset
            assert values[index] == pytest.approx(total, abs=1e-5)

    def test_noise_is_smooth_across_lattice_points_with_mean_zero(self):
        values = noise.gradient_noise(Grid((0, 0, 0), (96, 96, 96), 0.25), 4.0, 1)
        assert np.abs(np.diff(values, axis=0)).max() < 0.3 and abs(values.mean()) < 0.05 and values.std() > 0.2
        assert np.abs(np.diff(values, 2, axis=2)).max() < 0.1

    def test_unresolved_octaves_are_replaced_by_their_mean(self):
        coarse = noise.fbm(Grid((0, 0, 0), (4, 4, 4), 100.0), 64.0, 4, 0)
        assert (coarse == 0.0).all()
        ridged = noise.fbm(Grid((0, 0, 0), (4, 4, 4), 100.0), 64.0, 2, 0, ridged=True)
        fine = noise.fbm(Grid((0, 0, 0), (64, 64, 64), 5.0), 64.0, 2, 0, ridged=True)
        assert np.allclose(ridged, fine.mean(), atol=0.03)

    def test_distant_noise_does_not_repeat_near_noise(self):
        near, far = (noise.gradient_noise(Grid((x, 0, 0), (8, 8, 8), 1.0), 4.0, 0) for x in (0, 2**34))
        assert not np.allclose(near, far, atol=0.05)


@given(st.integers(-(2**60), 2**60), st.integers(-(2**60), 2**60), st.integers(0, 2**31))
def test_random_numbers_are_between_0_and_1(x, y, seed):
    bits = hash_lattice(np.array([x]), np.array([y]), np.array([3]), seed)
    assert bits.dtype == np.uint32 and 0.0 <= uniform_random(bits, 2)[0] < 1.0


class TestSpheres:
    """CSG of spheres."""

    def test_a_sphere_has_its_position_and_radius(self):
        grid = Grid((-10, -10, -10), (20, 20, 20), 1.0)
        densities = csg_density(grid, Spheres(np.array([[0.5, -1.0, 2.0]]), np.array([6.0]), np.array([False])))
        x, y, z = grid.coordinates()
        distance = np.sqrt((x - 0.5) ** 2 + (y + 1.0) ** 2 + (z - 2.0) ** 2)
        assert np.array_equal(densities > 0, distance < 6.0)
        near = np.abs(distance - 6.0) < 0.9
        assert np.allclose(densities[near], (6.0 - distance)[near], atol=0.1)

    def test_spheres_are_applied_in_order(self):
        grid = Grid((-10, -10, -10), (20, 20, 20), 1.0)
        centers, radii = np.zeros((3, 3)), np.array([9.0, 6.0, 3.0])
        solid = csg_density(grid, Spheres(centers, radii, np.array([False, True, False]))) > 0
        x, y, z = grid.coordinates()
        distance = np.sqrt(x**2 + y**2 + z**2)
        assert np.array_equal(solid, (distance < 3.0) | ((distance >= 6.0) & (distance < 9.0)))

    @settings(max_examples=40)
    @given(st.integers(0, 2**31), st.tuples(*[st.integers(1, 24)] * 3), st.integers(1, 80), st.sampled_from([3.0, 9.0]))
    def test_batches_equal_a_loop_over_spheres(self, seed, shape, count, max_radius):
        random = np.random.default_rng(seed)
        grid = Grid((-6, 2, -4), shape, 0.75)
        centers, radii = random.uniform(-9.0, 15.0, (count, 3)), random.uniform(0.2, 1.0, count) * max_radius
        subtractive = np.repeat(random.random(-(-count // 7)) < 0.5, 7)[:count]
        expected = np.full(shape, -MAX_DISTANCE)
        for center, radius, is_subtractive in zip(centers, radii, subtractive, strict=True):
            offsets = [coordinates - c for coordinates, c in zip(grid.coordinates(), center, strict=True)]
            values = (radius**2 - sum(offset**2 for offset in offsets)) / (2.0 * radius)
            in_window = np.ones(shape, bool)
            for offset in offsets:
                in_window = in_window & (np.abs(offset) <= radius + SURFACE_MARGIN * grid.voxel_size)
            combined = np.minimum(expected, -values) if is_subtractive else np.maximum(expected, values)
            expected = np.where(in_window, combined, expected)
        assert np.allclose(csg_density(grid, Spheres(centers, radii, subtractive)), expected, atol=1e-4)

    @settings(max_examples=30)
    @given(st.integers(-30, 30), st.integers(-30, 30), st.integers(-30, 30))
    def test_all_touching_spheres_are_found(self, x, y, z):
        small, large = Grid((x, y, z), (3, 4, 5), 1.0), Grid((x - 9, y - 9, z - 9), (21, 22, 23), 1.0)
        part = csg_density(small, find_touching_spheres(FIELD, small))
        all_densities = csg_density(large, find_touching_spheres(FIELD, large))
        assert part.tobytes() == all_densities[9:12, 9:13, 9:14].tobytes()

    def test_only_touching_spheres_are_found(self):
        grid = Grid((0, 0, 0), (8, 8, 8), 1.0)
        spheres = find_touching_spheres(FIELD, grid)
        nearest = np.clip(spheres.centers, 0.0, 8.0)
        assert len(spheres.radii) and (np.abs(spheres.centers - nearest).max(axis=1) <= spheres.radii + SURFACE_MARGIN).all()

    def test_settings_control_height_subtraction_and_count(self):
        grid = Grid((-60, -60, -90), (120, 120, 180), 1.0)
        single = {"sphere_radius": 10.0, "sphere_classes": 2, "sphere_count": 1, "sphere_height": 20.0}
        solid = sampler("spheres", **single, sphere_subtracted=0.0).densities(grid) > 0
        heights = np.flatnonzero(solid.any(axis=(0, 1))) - 90 + 0.5
        assert heights.min() > -30.0 and heights.max() < 30.0 and heights.max() > 15.0
        assert not (sampler("spheres", **single, sphere_subtracted=1.0).densities(grid) > 0).any()
        more = sampler("spheres", **(single | {"sphere_count": 3}), sphere_subtracted=0.0).densities(grid) > 0
        assert more.sum() > 1.5 * solid.sum()


class TestFormulas:
    """Formulas typed by the user."""

    @pytest.mark.parametrize(
        ("text", "expected"),
        [
            ("x + 2*y - z/4", 2.0 + 6.0 - 1.0),
            ("-x**2 + sqrt(y*y)", -4.0 + 3.0),
            ("x^2", 4.0),
            ("sin(pi/2) + cos(0)", 2.0),
            ("z % 3 + z // 3", 2.0),
            ("1 if x > y else 5", 5.0),
            ("where(x < y, 7, 8) + (x == 2)", 8.0),
            ("min(x, max(y, z))", 2.0),
            ("xor(5, 3) + bitand(6, 3) + bitor(4, 1)", 13.0),
            ("clip(10*x, 0, 7.5)", 7.5),
        ],
    )
    def test_formulas_are_evaluated(self, text, expected):
        assert Formula(text)(np.array(2.0), np.array(3.0), np.array(4.0)) == pytest.approx(expected)

    @pytest.mark.parametrize(
        "text",
        [
            "__import__('os').system('true')", "().__class__", "x.__class__", "open('a')", "eval('1')", "lambda: 1", "[x for x in (1,)]",
            "x if y else print(z)", "'a'*9", "b'a'", "f'{x}'", "x := 3", "sin", "sin(x, y)", "sin(*[x])", "sin(x=1)", "np.sin(x)", "w",
            "x; y", "import os", "", "  ", "(", "x and y", "not x", "1 < x < 2", "x is y", "x in y", "True", "None", "1j", "...", "x[0]",
            "{x}", "globals()", "sin.__self__", "min(x, y, key=z)", "9" * 400, "-" * 1500 + "x", "(" * 900 + "x" + ")" * 900, "x" * 3000,
        ],
    )  # fmt: skip
    def test_anything_but_arithmetic_is_rejected(self, text):
        with pytest.raises(SettingsError):
            Formula(text)

    def test_a_starred_argument_is_named(self):
        with pytest.raises(SettingsError, match=r'"\*x" is not allowed in the formula'):
            Formula("sin(*x)")

    @pytest.mark.parametrize("text", ["(x+y+z)**" * 180 + "x", "((x+y)*z)" + "**((x+y)*z)" * 150, "(" * 150 + "x+y" + "+x*y)*z" * 150])
    def test_long_formulas_need_few_arrays(self, text):
        coordinates = np.linspace(0.9, 1.1, 40)
        formula = Formula(text)
        tracemalloc.start()
        formula(coordinates[:, None, None], coordinates[None, :, None], coordinates[None, None, :])
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 8 * (8 * 40**3)

    def test_nan_is_air_and_infinity_is_clamped(self):
        densities = sampler("formula", formula="log(x) + 0*y").densities(Grid((-2, 0, 0), (4, 1, 1), 1.0)).ravel()
        assert (densities[:2] == -1.0).all() and np.isfinite(densities).all()
        assert (sampler("formula", formula="1/0").densities(Grid((0, 0, 0), (2, 2, 2), 1.0)) > 0).all()

    def test_tiny_densities_keep_their_sign(self):
        assert (sampler("formula", formula="1e-30").densities(Grid((0, 0, 0), (2, 2, 2), 1.0)) > 0).all()


class TestSampler:
    """Density functions with invalid results."""

    def test_results_are_broadcast_to_the_grid(self):
        densities = Sampler("plane", lambda grid: 5.0 - grid.coordinates()[2]).densities(Grid((0, 0, 0), (2, 2, 9), 1.0))
        assert (densities > 0).sum() == 2 * 2 * 5

    @pytest.mark.parametrize("result", [np.zeros((2, 3)), "ground", None, np.zeros(7)], ids=["sheet", "text", "none", "row"])
    def test_invalid_results_are_rejected(self, result):
        with pytest.raises(GeometryError, match='"other" failed'):
            Sampler("other", lambda _grid: result).densities(Grid((0, 0, 0), (4, 4, 4), 1.0))

    def test_errors_are_reported(self):
        with pytest.raises(GeometryError, match="division"):
            Sampler("other", lambda _grid: 1 // 0).densities(Grid((0, 0, 0), (4, 4, 4), 1.0))
