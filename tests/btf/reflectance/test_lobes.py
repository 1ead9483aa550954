"""The lobe fit recovers lobes, the lobes are physically plausible, and disc lights are means over their discs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.btf.capture.observations import low_order_lights
from farfield.addon.core.btf.reflectance.disc_lights import DiscLights
from farfield.addon.core.btf.reflectance.lobe_fit import ROUGHNESS_FACTORS, CapturedRadiance, fit_lobes, fit_responses
from farfield.addon.core.btf.reflectance.lobes import Lobes, TexelSurface, specular_lobe
from farfield.addon.core.geometry.directions import DirectionGrid, fibonacci_sphere
from farfield.addon.core.jobs.progress import run_to_end
from synthetic_views import InMemoryView

VIEWS, LIGHTS = DirectionGrid(6), DirectionGrid(5)
SUNS = DiscLights(LIGHTS.directions, float(LIGHTS.solid_angles.mean()))
HEMISPHERE = DirectionGrid(96, upper=True)
COUNT = 60


def sphere_lobes(roughness: float = 0.4) -> Lobes:
    """Return random lobes of the texels of a sphere."""
    random = np.random.default_rng(4)
    surface = TexelSurface(fibonacci_sphere(COUNT).astype(np.float32), np.full(COUNT, roughness, np.float32))
    diffuse, f0 = random.uniform(0.1, 0.8, (COUNT, 3)), random.uniform(0.02, 0.3, (COUNT, 3))
    return Lobes(surface, diffuse.astype(np.float32), f0.astype(np.float32), random.uniform(0.0, 0.6, COUNT).astype(np.float32))


def render_views(lobes: Lobes, unseen: np.ndarray | None = None) -> list[InMemoryView]:
    """Return views of `lobes` with the texels that face them, except those in the mask `unseen`."""
    views = []
    for direction in VIEWS.directions:
        facing = lobes.surface.normals @ direction > 0.1
        rows = np.flatnonzero(facing if unseen is None else facing & ~unseen)
        views.append(InMemoryView(rows, lobes.radiance_on_grid(direction, SUNS, rows)))
    return views


def fit(views: list[InMemoryView], surface: TexelSurface, quad_indices: np.ndarray) -> Lobes:
    captured = CapturedRadiance(views, VIEWS, SUNS, np.ones((len(VIEWS), COUNT)), np.append(LIGHTS.solid_angles, 1.0))
    return run_to_end(fit_lobes(captured, surface, quad_indices))


def test_lobes_are_recovered():
    lobes = sphere_lobes()
    fitted = fit(render_views(lobes), lobes.surface, np.arange(COUNT) % 3)
    np.testing.assert_allclose(fitted.surface.roughness, 0.4)
    assert np.abs(fitted.diffuse - lobes.diffuse).mean() < 0.03
    assert np.abs(fitted.f0 - lobes.f0).mean() < 0.02
    direction = VIEWS.directions[7]
    rows = np.flatnonzero(lobes.surface.normals @ direction > 0.3)
    radiance, expected = (each.radiance_on_grid(direction, SUNS, rows) for each in (fitted, lobes))
    assert np.abs(radiance - expected).mean() < 0.05 * expected.mean()


@pytest.mark.parametrize("factor", ROUGHNESS_FACTORS)
def test_the_roughness_factor_is_recovered(factor):
    lobes = sphere_lobes(0.3)
    pbr_surface = replace(lobes.surface, roughness=lobes.surface.roughness / factor)
    fitted = fit(render_views(lobes), pbr_surface, np.arange(COUNT))
    np.testing.assert_allclose(fitted.surface.roughness, 0.3, rtol=1e-5)


def test_unseen_texels_follow_their_quad():
    lobes = sphere_lobes()
    uniform = replace(lobes, diffuse=np.full((COUNT, 3), 0.5, np.float32), f0=np.full((COUNT, 3), 0.1, np.float32))
    unseen = np.arange(COUNT) % 5 == 0
    fitted = fit(render_views(uniform, unseen), uniform.surface, np.arange(COUNT) // 20)
    np.testing.assert_allclose(fitted.diffuse[unseen], 0.5, atol=0.05)
    np.testing.assert_allclose(fitted.f0[unseen], 0.1, atol=0.03)


def test_coefficients_stay_within_zero_and_one():
    lobes = sphere_lobes()
    random = np.random.default_rng(0)
    noise = [InMemoryView(view.rows, random.uniform(-1.0, 40.0, view.values.shape).astype(np.float32)) for view in render_views(lobes)]
    fitted = fit(noise, lobes.surface, np.zeros(COUNT, int))
    for coefficients in (fitted.diffuse, fitted.f0, fitted.f90_minus_f0):
        assert np.isfinite(coefficients).all() and coefficients.min() >= 0.0 and coefficients.max() <= 1.0


def test_black_views_give_black_lobes():
    lobes = sphere_lobes()
    black = [InMemoryView(view.rows, np.zeros_like(view.values)) for view in render_views(lobes)]
    fitted = fit(black, lobes.surface, np.zeros(COUNT, int))
    assert max(fitted.diffuse.max(), fitted.f0.max(), fitted.f90_minus_f0.max()) < 1e-6


def disc_directions(center: np.ndarray, radius: float, count: int = 20_000) -> np.ndarray:
    """Return directions that are evenly distributed over a disc."""
    z = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - np.cos(radius))
    azimuths = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    tangent = np.cross(center, [0.3, 0.5, 0.8])
    tangent /= np.linalg.norm(tangent)
    circle = np.cos(azimuths)[:, None] * tangent + np.sin(azimuths)[:, None] * np.cross(center, tangent)
    return np.sqrt(1.0 - z**2)[:, None] * circle + z[:, None] * center


def test_diffuse_response_is_the_mean_over_the_disc():
    normals = fibonacci_sphere(40)
    for light in (0, 7, 18):
        disc = disc_directions(LIGHTS.directions[light], SUNS.radius)
        expected = np.maximum(normals @ disc.T, 0.0).mean(axis=1) / np.pi
        np.testing.assert_allclose(SUNS.diffuse_response(normals)[:, light], expected, atol=2e-3)


@pytest.mark.parametrize("roughness", [0.1, *(pytest.param(roughness, marks=pytest.mark.exhaustive) for roughness in (0.25, 0.4))])
def test_specular_response_is_the_mean_over_the_disc(roughness):
    normals = fibonacci_sphere(400)
    view = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    normals = normals[normals @ view > 0.5]
    roughnesses = np.full(len(normals), roughness)
    response = SUNS.specular_response(normals, view, roughnesses)
    for light in np.flatnonzero(LIGHTS.directions[:, 2] > 0.3):
        above = normals @ LIGHTS.directions[light] > 0.5
        disc = disc_directions(LIGHTS.directions[light], SUNS.radius)
        expected = specular_lobe(normals[above], view, disc, roughnesses[above])[0].mean(axis=1)
        assert np.abs(response[above, light] - expected).max() < 0.15 / float(LIGHTS.solid_angles.mean())


def test_a_smooth_surface_mirrors_the_radiance_of_the_sun():
    normal = np.array([[0.0, 0.0, 1.0]])
    suns = DiscLights(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 0.2)
    response = suns.specular_response(normal, np.array([0.0, 0.0, 1.0]), np.array([0.05]))
    np.testing.assert_allclose(response[0, 0], 1.0 / 0.2, rtol=0.01)
    assert response[0, 1] < 1e-3


@settings(max_examples=40)
@given(st.floats(0.05, 1.0), st.floats(0.05, 1.5), st.integers(0, 10_000))
def test_the_specular_lobe_is_reciprocal_and_conserves_energy(roughness, tilt, seed):
    random = np.random.default_rng(seed)
    normal = np.array([[0.0, 0.0, 1.0]])
    view = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    light = np.abs(random.normal(size=3)) + [0.0, 0.0, 0.05]
    light /= np.linalg.norm(light)
    forward = specular_lobe(normal, view, light[None], np.array([roughness]))[0][0, 0] / light[2]
    backward = specular_lobe(normal, light, view[None], np.array([roughness]))[0][0, 0] / view[2]
    assert forward == pytest.approx(backward, rel=1e-6)
    reflected = specular_lobe(normal, view, HEMISPHERE.directions, np.array([max(roughness, 0.3)]))[0][0]
    assert float(reflected @ HEMISPHERE.solid_angles) < 1.02


def test_the_dome_equals_suns_in_all_directions_for_a_white_surface():
    lobes = sphere_lobes()
    white = replace(
        lobes, diffuse=np.ones((COUNT, 3), np.float32), f0=np.zeros((COUNT, 3), np.float32), f90_minus_f0=np.zeros(COUNT, np.float32)
    )
    radiance = white.radiance_on_grid(VIEWS.directions[0], SUNS, np.arange(COUNT))
    np.testing.assert_allclose(radiance[:, -1], white.radiance_under_dome(VIEWS.directions[0]), rtol=1e-5)
    np.testing.assert_allclose(np.einsum("nlc,l->nc", radiance[:, :-1], LIGHTS.solid_angles), 1.0, rtol=0.06)


def test_radiance_under_lights_is_a_weighted_sum_over_the_suns():
    lobes, lights = sphere_lobes(), low_order_lights(LIGHTS)
    by_light = lobes.radiance_on_grid(VIEWS.directions[3], SUNS, np.arange(COUNT))
    expected = np.einsum("nlc,lm->nmc", by_light, lights)
    radiance = lobes.radiance_under_lights(lights, VIEWS.directions[3], SUNS, np.arange(1, COUNT))
    np.testing.assert_allclose(radiance, expected.reshape(COUNT, -1)[1:], rtol=2e-3, atol=2e-3)


def test_back_faces_reflect_like_front_faces():
    lobes = sphere_lobes()
    flipped = replace(lobes, surface=replace(lobes.surface, normals=-lobes.surface.normals))
    view, lights = VIEWS.directions[2], fibonacci_sphere(9)
    np.testing.assert_allclose(lobes.radiance_under_suns(view, lights), flipped.radiance_under_suns(view, lights), rtol=1e-5)
    assert fit_responses(lobes.surface, view, SUNS, np.arange(3)).shape == (3, 26, 5)
