"""What terrains are made of: noise, spheres, formulas. What they answer must not depend on who asks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.clipbox import noise, terrains
from farfield.addon.core.clipbox.formulas import Formula
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.hashing import fractions, hashed_lattice
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.spheres import AROUND, FAR, SphereField, Spheres, carved, spheres_touching
from farfield.addon.core.errors import GeometryError, SettingsError

WITHOUT_FILES = [name for name in terrains.NAMES if name not in ("heights", "volume", "forest")]
FIELD = SphereField(largest=12.0, classes=3, count=3, taken=0.4, height=20.0, seed=5)


def sampler(name, **given):
    return terrains.terrain_of(ClipboxSettings(terrain=name, **given))


@pytest.mark.parametrize("name", WITHOUT_FILES)
@pytest.mark.parametrize("voxel", [0.5, 4.0, 64.0])
def test_a_slab_is_a_part_of_the_whole_to_the_bit(name, voxel):
    terrain = sampler(name)
    whole = terrain.densities(Grid((-7, 12, -9), (16, 15, 14), voxel))
    for low, high in (((3, 0, 0), (4, 15, 14)), ((0, 14, 0), (16, 15, 14)), ((0, 0, 6), (16, 15, 7)), ((2, 3, 4), (9, 8, 11))):
        part = terrain.densities(Grid(tuple(np.add((-7, 12, -9), low).tolist()), tuple(np.subtract(high, low).tolist()), voxel))
        assert part.tobytes() == whole[tuple(slice(*span) for span in zip(low, high, strict=True))].tobytes()


@pytest.mark.parametrize("name", WITHOUT_FILES)
def test_there_is_ground_and_air(name):
    solid = sampler(name).densities(Grid((-40, -40, -40), (80, 80, 80), 4.0)) > 0
    assert 0.02 < solid.mean() < 0.98


@pytest.mark.parametrize("name", ["cascades", "islands", "spheres"])
def test_a_seed_gives_one_terrain_and_another_seed_another(name):
    grid = Grid((0, 0, -20), (24, 24, 40), 2.0)
    first, again, other = (sampler(name, seed=seed).densities(grid) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes() and first.tobytes() != other.tobytes()


def test_scale_makes_features_larger():
    fine = sampler("cascades").densities(Grid((0, 0, 0), (12, 12, 12), 2.0))
    large = sampler("cascades", scale=4.0).densities(Grid((0, 0, 0), (12, 12, 12), 8.0))
    assert np.allclose(4.0 * fine.astype(np.float32), large, rtol=2e-3, atol=0.05)


class TestNoise:
    """Gradient noise on grids."""

    def test_it_is_the_sum_over_eight_gradients(self):
        grid, length = Grid((-5, 3, 7), (6, 5, 4), 1.0), 3.7
        made = noise.gradient_noise(grid, length, 11)
        for index in np.ndindex(*grid.shape):
            place = np.array([grid.axis(axis)[index[axis]] for axis in range(3)]) / length
            total = 0.0
            for corner in np.ndindex(2, 2, 2):
                lattice = np.floor(place).astype(np.int64) + corner
                away = place - lattice
                fade = 1.0 - np.abs(away)
                fade = fade**3 * (fade * (fade * 6.0 - 15.0) + 10.0)
                bits = hashed_lattice(*lattice[:, None], 11)[0] & np.uint32(noise.DIRECTIONS - 1)
                total += fade.prod() * noise._gradients()[:, bits] @ away
            assert made[index] == pytest.approx(total, abs=1e-5)

    def test_it_is_smooth_across_lattice_points_and_about_zero(self):
        made = noise.gradient_noise(Grid((0, 0, 0), (96, 96, 96), 0.25), 4.0, 1)
        assert np.abs(np.diff(made, axis=0)).max() < 0.3 and abs(made.mean()) < 0.05 and made.std() > 0.2
        assert np.abs(np.diff(made, 2, axis=2)).max() < 0.1

    def test_waves_that_voxels_cannot_show_stand_with_their_mean(self):
        coarse = noise.fractal(Grid((0, 0, 0), (4, 4, 4), 100.0), 64.0, 4, 0)
        assert (coarse == 0.0).all()
        ridged = noise.fractal(Grid((0, 0, 0), (4, 4, 4), 100.0), 64.0, 2, 0, ridged=True)
        fine = noise.fractal(Grid((0, 0, 0), (64, 64, 64), 5.0), 64.0, 2, 0, ridged=True)
        assert np.allclose(ridged, fine.mean(), atol=0.03)

    def test_far_places_do_not_repeat_near_ones(self):
        near, far = (noise.gradient_noise(Grid((at, 0, 0), (8, 8, 8), 1.0), 4.0, 0) for at in (0, 2**34))
        assert not np.allclose(near, far, atol=0.05)


@given(st.integers(-(2**60), 2**60), st.integers(-(2**60), 2**60), st.integers(0, 2**31))
def test_hashes_are_fractions(x, y, seed):
    bits = hashed_lattice(np.array([x]), np.array([y]), np.array([3]), seed)
    assert bits.dtype == np.uint32 and 0.0 <= fractions(bits, 2)[0] < 1.0


class TestSpheres:
    """Spheres added and taken away."""

    def test_a_sphere_is_where_it_should_be(self):
        grid = Grid((-10, -10, -10), (20, 20, 20), 1.0)
        made = carved(grid, Spheres(np.array([[0.5, -1.0, 2.0]]), np.array([6.0]), np.array([False])))
        x, y, z = grid.axes()
        distance = np.sqrt((x - 0.5) ** 2 + (y + 1.0) ** 2 + (z - 2.0) ** 2)
        assert np.array_equal(made > 0, distance < 6.0)
        near = np.abs(distance - 6.0) < 0.9
        assert np.allclose(made[near], (6.0 - distance)[near], atol=0.1)

    def test_they_count_in_their_order(self):
        grid = Grid((-10, -10, -10), (20, 20, 20), 1.0)
        centres, radii = np.zeros((3, 3)), np.array([9.0, 6.0, 3.0])
        solid = carved(grid, Spheres(centres, radii, np.array([False, True, False]))) > 0
        x, y, z = grid.axes()
        distance = np.sqrt(x**2 + y**2 + z**2)
        assert np.array_equal(solid, (distance < 3.0) | ((distance >= 6.0) & (distance < 9.0)))

    @settings(max_examples=40)
    @given(st.integers(0, 2**31), st.tuples(*[st.integers(1, 24)] * 3), st.integers(1, 80), st.sampled_from([3.0, 9.0]))
    def test_many_count_as_one_after_the_other(self, seed, shape, count, largest):
        random = np.random.default_rng(seed)
        grid = Grid((-6, 2, -4), shape, 0.75)
        centres, radii = random.uniform(-9.0, 15.0, (count, 3)), random.uniform(0.2, 1.0, count) * largest
        taken = np.repeat(random.random(-(-count // 7)) < 0.5, 7)[:count]
        expected = np.full(shape, -FAR)
        for centre, radius, takes in zip(centres, radii, taken, strict=True):
            away = [along - c for along, c in zip(grid.axes(), centre, strict=True)]
            value = (radius**2 - sum(each**2 for each in away)) / (2.0 * radius)
            reached = np.ones(shape, bool)
            for each in away:
                reached = reached & (np.abs(each) <= radius + AROUND * grid.voxel)
            joined = np.minimum(expected, -value) if takes else np.maximum(expected, value)
            expected = np.where(reached, joined, expected)
        assert np.allclose(carved(grid, Spheres(centres, radii, taken)), expected, atol=1e-4)

    @settings(max_examples=30)
    @given(st.integers(-30, 30), st.integers(-30, 30), st.integers(-30, 30))
    def test_a_grid_finds_all_that_touch_it(self, x, y, z):
        small, large = Grid((x, y, z), (3, 4, 5), 1.0), Grid((x - 9, y - 9, z - 9), (21, 22, 23), 1.0)
        assert (
            carved(small, spheres_touching(FIELD, small)).tobytes()
            == carved(large, spheres_touching(FIELD, large))[9:12, 9:13, 9:14].tobytes()
        )

    def test_only_those_are_found_that_touch(self):
        grid = Grid((0, 0, 0), (8, 8, 8), 1.0)
        found = spheres_touching(FIELD, grid)
        nearest = np.clip(found.centres, 0.0, 8.0)
        assert len(found.radii) and (np.abs(found.centres - nearest).max(axis=1) <= found.radii + AROUND).all()

    def test_ranges_are_those_of_the_settings(self):
        grid = Grid((-60, -60, -90), (120, 120, 180), 1.0)
        plain = {"sphere_radius": 10.0, "sphere_classes": 2, "sphere_count": 1, "sphere_height": 20.0}
        solid = sampler("spheres", **plain, sphere_taken=0.0).densities(grid) > 0
        heights = np.flatnonzero(solid.any(axis=(0, 1))) - 90 + 0.5
        assert heights.min() > -30.0 and heights.max() < 30.0 and heights.max() > 15.0
        assert not (sampler("spheres", **plain, sphere_taken=1.0).densities(grid) > 0).any()
        more = sampler("spheres", **(plain | {"sphere_count": 3}), sphere_taken=0.0).densities(grid) > 0
        assert more.sum() > 1.5 * solid.sum()


class TestFormulas:
    """What users type."""

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
    def test_they_are_worked_out(self, text, expected):
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
    def test_nothing_but_mathematics_is_taken(self, text):
        with pytest.raises(SettingsError):
            Formula(text)

    def test_what_has_no_value_is_air_and_what_is_infinite_is_kept_within_bounds(self):
        made = sampler("formula", formula="log(x) + 0*y").densities(Grid((-2, 0, 0), (4, 1, 1), 1.0)).ravel()
        assert (made[:2] == -1.0).all() and np.isfinite(made).all()
        assert (sampler("formula", formula="1/0").densities(Grid((0, 0, 0), (2, 2, 2), 1.0)) > 0).all()

    def test_the_least_density_keeps_its_sign(self):
        assert (sampler("formula", formula="1e-30").densities(Grid((0, 0, 0), (2, 2, 2), 1.0)) > 0).all()


class TestRegistry:
    """Terrains of others."""

    @pytest.fixture
    def registered(self, monkeypatch):
        monkeypatch.setattr(terrains, "NAMES", terrains.NAMES)
        yield lambda function: terrains.register("other", "One from elsewhere", lambda _settings: function)
        terrains.NAMES.pop("other", None)

    def test_it_can_be_chosen(self, registered):
        registered(lambda grid: 5.0 - grid.axes()[2])
        assert (sampler("other").densities(Grid((0, 0, 0), (2, 2, 9), 1.0)) > 0).sum() == 2 * 2 * 5

    @pytest.mark.parametrize("answer", [np.zeros((2, 3)), "ground", None, np.zeros(7)], ids=["sheet", "word", "nothing", "row"])
    def test_what_it_answers_is_checked(self, registered, answer):
        registered(lambda _grid: answer)
        with pytest.raises(GeometryError, match='"other" fails'):
            sampler("other").densities(Grid((0, 0, 0), (4, 4, 4), 1.0))

    def test_what_it_raises_is_told(self, registered):
        registered(lambda _grid: 1 // 0)
        with pytest.raises(GeometryError, match="division"):
            sampler("other").densities(Grid((0, 0, 0), (4, 4, 4), 1.0))
