"""At baked directions, decoded textures are weights times basis; between them, they are interpolated."""

import numpy as np
import pytest

from farfield.addon.core.btf.factorization.lpca import LocalFactors
from farfield.addon.core.geometry.directions import fibonacci_sphere
from random_textures import LIGHTS, VIEWS, random_texture


@pytest.mark.parametrize("clusters", [1, 3])
def test_radiance_at_baked_directions_is_weights_times_basis(clusters):
    texture = random_texture(clusters=clusters)
    basis = texture.interpolate_basis(VIEWS.directions[[2, 9]], LIGHTS.directions[[4]])
    radiance = texture.radiance(basis[1, :, 0], VIEWS.directions[9], LIGHTS.directions[4])
    labels = texture.color.labels if clusters > 1 else np.zeros(28, int)
    baked_basis = texture.color.basis[9].reshape(clusters, 5, -1, 3)[:, :, 4]
    expected = texture.chromaticity * np.einsum("nk,nkc->nc", texture.color.weights, baked_basis[labels])
    np.testing.assert_allclose(radiance, np.maximum(expected, 0.0).reshape(4, 7, 3), rtol=1e-4, atol=1e-5)
    assert (expected < 0.0).any(), "the test needs values that are clamped"
    alpha = np.clip(texture.pbr_alpha + texture.alpha.weights @ texture.alpha.basis[9, :, 0], 0.0, 1.0)
    np.testing.assert_allclose(texture.coverage(VIEWS.directions[9]), alpha.reshape(4, 7), atol=1e-5)


def test_lobes_are_added_before_clamping():
    without_lobes, texture = random_texture(), random_texture(lobes=True)
    view, light = VIEWS.directions[5], LIGHTS.directions[2]
    basis = texture.interpolate_basis(view[None], light[None])[0, :, 0]
    expected = without_lobes.unclamped_radiance(basis, view, light) + texture.lobes.radiance_under_suns(view, light[None])[:, 0]
    np.testing.assert_allclose(texture.radiance(basis, view, light).reshape(-1, 3), np.maximum(expected, 0.0), rtol=1e-5, atol=1e-6)


def test_the_basis_is_interpolated_between_baked_directions():
    texture = random_texture()
    values = texture.color.basis.reshape(len(VIEWS), 5, len(LIGHTS) + 1, 3)[:, :, :-1]
    views, lights = fibonacci_sphere(30), np.abs(fibonacci_sphere(20))
    basis = texture.interpolate_basis(views, lights)
    assert basis.shape == (30, 5, 20, 3)
    for index in (3, 17):
        view_taps, view_weights = VIEWS.taps(views[index : index + 1])
        light_taps, light_weights = LIGHTS.taps(lights[index : index + 1])
        expected = np.einsum("v,l,vklc->kc", view_weights[0], light_weights[0], values[view_taps[0]][:, :, light_taps[0]])
        np.testing.assert_allclose(basis[index, :, index], expected, atol=1e-5)


def test_dense_weights_and_contributions_of_local_factors_give_the_same_product():
    factors = random_texture(clusters=3).color
    assert isinstance(factors, LocalFactors) and factors.clusters == 3
    values = factors.reconstruct(factors.basis[5])
    np.testing.assert_allclose(factors.dense_weights(slice(0, None)) @ factors.basis[5], values, rtol=1e-4, atol=1e-5)
    rows = np.array([3, 8, 20])
    contributions = [factors.component_contribution(rows, 5, component) for component in range(factors.components)]
    np.testing.assert_allclose(sum(contributions), values[rows], rtol=1e-4, atol=1e-5)
