"""Lobes are what they were made from, and what they leave is nothing; broad suns are the mean over their discs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.btf.broad_suns import BroadSuns
from farfield.addon.core.btf.lobes import FACTORS, Lobes, Surface, features, fit_lobes, glossy_lobe
from farfield.addon.core.btf.photographs import broad_lights
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.directions import fibonacci_sphere
from farfield.addon.core.progress import finish
from known_views import Known

VIEWS, LIGHTS = DirectionGrid(6), DirectionGrid(5)
SUNS = BroadSuns(LIGHTS.directions, float(LIGHTS.solid_angles.mean()))
COUNT = 60


def made_lobes(roughness: float = 0.4) -> Lobes:
    """Lobes of the texels of a ball."""
    random = np.random.default_rng(4)
    surface = Surface(fibonacci_sphere(COUNT).astype(np.float32), np.full(COUNT, roughness, np.float32))
    diffuse, specular = random.uniform(0.1, 0.8, (COUNT, 3)), random.uniform(0.02, 0.3, (COUNT, 3))
    return Lobes(surface, diffuse.astype(np.float32), specular.astype(np.float32), random.uniform(0.0, 0.6, COUNT).astype(np.float32))


def seen_of(lobes: Lobes, unseen: np.ndarray | None = None) -> list[Known]:
    """What views see of `lobes`: texels that face them, and none of `unseen`."""
    views = []
    for direction in VIEWS.directions:
        facing = lobes.surface.normals @ direction > 0.1
        index = np.flatnonzero(facing if unseen is None else facing & ~unseen)
        views.append(Known(index, lobes.of_grid(direction, SUNS, index)))
    return views


def fitted(views: list[Known], surface: Surface, quads: np.ndarray) -> Lobes:
    weights = np.ones((len(VIEWS), COUNT))
    return finish(fit_lobes(views, surface, quads, VIEWS, SUNS, weights, np.append(LIGHTS.solid_angles, 1.0)))


def test_lobes_come_back_out_of_what_was_seen():
    lobes = made_lobes()
    found = fitted(seen_of(lobes), lobes.surface, np.arange(COUNT) % 3)
    np.testing.assert_allclose(found.surface.roughness, 0.4)
    assert np.abs(found.diffuse - lobes.diffuse).mean() < 0.03
    assert np.abs(found.specular - lobes.specular).mean() < 0.02
    direction = VIEWS.directions[7]
    rows = np.flatnonzero(lobes.surface.normals @ direction > 0.3)
    shown, meant = (each.of_grid(direction, SUNS, rows) for each in (found, lobes))
    assert np.abs(shown - meant).mean() < 0.05 * meant.mean()


@pytest.mark.parametrize("factor", FACTORS)
def test_the_roughness_that_suits_is_found(factor):
    lobes = made_lobes(0.3)
    given_surface = replace(lobes.surface, roughness=lobes.surface.roughness / factor)
    found = fitted(seen_of(lobes), given_surface, np.arange(COUNT))
    np.testing.assert_allclose(found.surface.roughness, 0.3, rtol=1e-5)


def test_texels_that_nobody_saw_take_after_their_quad():
    lobes = made_lobes()
    even = replace(lobes, diffuse=np.full((COUNT, 3), 0.5, np.float32), specular=np.full((COUNT, 3), 0.1, np.float32))
    unseen = np.arange(COUNT) % 5 == 0
    found = fitted(seen_of(even, unseen), even.surface, np.arange(COUNT) // 20)
    np.testing.assert_allclose(found.diffuse[unseen], 0.5, atol=0.05)
    np.testing.assert_allclose(found.specular[unseen], 0.1, atol=0.03)


def test_all_numbers_stay_within_what_surfaces_can_do():
    lobes = made_lobes()
    random = np.random.default_rng(0)
    noisy = [Known(each.index, random.uniform(-1.0, 40.0, each.values.shape).astype(np.float32)) for each in seen_of(lobes)]
    found = fitted(noisy, lobes.surface, np.zeros(COUNT, int))
    for part in (found.diffuse, found.specular, found.rim):
        assert np.isfinite(part).all() and part.min() >= 0.0 and part.max() <= 1.0


def test_nothing_seen_leaves_no_lobes():
    lobes = made_lobes()
    dark = [Known(each.index, np.zeros_like(each.values)) for each in seen_of(lobes)]
    found = fitted(dark, lobes.surface, np.zeros(COUNT, int))
    assert max(found.diffuse.max(), found.specular.max(), found.rim.max()) < 1e-6


def on_disc(middle: np.ndarray, radius: float, count: int = 20_000) -> np.ndarray:
    """Directions spread evenly over a disc."""
    z = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - np.cos(radius))
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.cross(middle, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(middle, across)
    return np.sqrt(1.0 - z**2)[:, None] * ring + z[:, None] * middle


def test_broad_suns_are_the_mean_over_their_discs():
    normals = fibonacci_sphere(40)
    for number in (0, 7, 18):
        disc = on_disc(LIGHTS.directions[number], SUNS.radius)
        expected = np.maximum(normals @ disc.T, 0.0).mean(axis=1) / np.pi
        np.testing.assert_allclose(SUNS.cosine(normals)[:, number], expected, atol=2e-3)


@pytest.mark.parametrize("roughness", [0.1, 0.25, 0.4])
def test_mirrored_broad_suns_are_the_mean_over_their_discs(roughness):
    normals = fibonacci_sphere(400)
    view = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    normals = normals[normals @ view > 0.5]
    rough = np.full(len(normals), roughness)
    shown = SUNS.mirrored(normals, view, rough)
    for number in np.flatnonzero(LIGHTS.directions[:, 2] > 0.3):
        above = normals @ LIGHTS.directions[number] > 0.5
        expected = glossy_lobe(normals[above], view, on_disc(LIGHTS.directions[number], SUNS.radius), rough[above])[0].mean(axis=1)
        assert np.abs(shown[above, number] - expected).max() < 0.15 / float(LIGHTS.solid_angles.mean())


def test_a_smooth_surface_mirrors_the_sun_as_it_is():
    normal = np.array([[0.0, 0.0, 1.0]])
    sun = BroadSuns(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 0.2)
    shown = sun.mirrored(normal, np.array([0.0, 0.0, 1.0]), np.array([0.05]))
    np.testing.assert_allclose(shown[0, 0], 1.0 / 0.2, rtol=0.01)
    assert shown[0, 1] < 1e-3


@settings(max_examples=40)
@given(st.floats(0.05, 1.0), st.floats(0.05, 1.5), st.integers(0, 10_000))
def test_the_glossy_lobe_is_the_same_both_ways_and_wins_no_light(roughness, tilt, seed):
    random = np.random.default_rng(seed)
    normal = np.array([[0.0, 0.0, 1.0]])
    view = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    light = np.abs(random.normal(size=3)) + [0.0, 0.0, 0.05]
    light /= np.linalg.norm(light)
    there = glossy_lobe(normal, view, light[None], np.array([roughness]))[0][0, 0] / light[2]
    back = glossy_lobe(normal, light, view[None], np.array([roughness]))[0][0, 0] / view[2]
    assert there == pytest.approx(back, rel=1e-6)
    grid = DirectionGrid(96, upper=True)
    sent = glossy_lobe(normal, view, grid.directions, np.array([max(roughness, 0.3)]))[0][0]
    assert float(sent @ grid.solid_angles) < 1.02


def test_the_dome_is_as_bright_as_all_white_suns_together():
    lobes = made_lobes()
    white = replace(
        lobes, diffuse=np.ones((COUNT, 3), np.float32), specular=np.zeros((COUNT, 3), np.float32), rim=np.zeros(COUNT, np.float32)
    )
    under = white.of_grid(VIEWS.directions[0], SUNS, np.arange(COUNT))
    np.testing.assert_allclose(under[:, -1], white.of_dome(VIEWS.directions[0]), rtol=1e-5)
    np.testing.assert_allclose(np.einsum("nlc,l->nc", under[:, :-1], LIGHTS.solid_angles), 1.0, rtol=0.06)


def test_sums_of_suns_are_sums():
    lobes, lights = made_lobes(), broad_lights(LIGHTS)
    rows = np.arange(COUNT)
    expected = np.einsum("nlc,lm->nmc", lobes.of_grid(VIEWS.directions[3], SUNS, rows), lights)
    found = lobes.under(lights, VIEWS.directions[3], SUNS, np.arange(1, COUNT))
    np.testing.assert_allclose(found, expected.reshape(COUNT, -1)[1:], rtol=2e-3, atol=2e-3)


def test_backs_shine_like_fronts():
    lobes = made_lobes()
    turned = replace(lobes, surface=replace(lobes.surface, normals=-lobes.surface.normals))
    lights = fibonacci_sphere(9)
    np.testing.assert_allclose(lobes.of_suns(VIEWS.directions[2], lights), turned.of_suns(VIEWS.directions[2], lights), rtol=1e-5)
    assert features(lobes.surface, VIEWS.directions[2], SUNS, np.arange(3)).shape == (3, 26, 5)
