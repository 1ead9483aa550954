"""Decoded at the baked directions, relightable textures are weights times basis; in between, they are between."""

import numpy as np
import pytest

from farfield.addon.core.btf.lpca import LocalFactors
from farfield.addon.core.directions import fibonacci_sphere
from made_atlases import LIGHTS, VIEWS, made_atlas


@pytest.mark.parametrize("clusters", [1, 3])
def test_at_baked_directions_it_is_weights_times_basis(clusters):
    atlas = made_atlas(clusters=clusters)
    basis = atlas.seen_from(VIEWS.directions[[2, 9]], LIGHTS.directions[[4]])
    picture = atlas.picture(basis[1, :, 0], VIEWS.directions[9], LIGHTS.directions[4])
    labels = atlas.colour.labels if clusters > 1 else np.zeros(28, int)
    table = atlas.colour.basis[9].reshape(clusters, 5, -1, 3)[:, :, 4]
    expected = np.array(
        [tint * (weight @ table[label]) for tint, weight, label in zip(atlas.tints, atlas.colour.weights, labels, strict=True)]
    )
    np.testing.assert_allclose(picture, np.maximum(expected, 0.0).reshape(4, 7, 3), rtol=1e-4, atol=1e-5)
    assert (expected < 0.0).any(), "the cut at 0 must be seen"
    alpha = np.clip(atlas.plain + atlas.alpha.weights @ atlas.alpha.basis[9, :, 0], 0.0, 1.0)
    np.testing.assert_allclose(atlas.coverage(VIEWS.directions[9]), alpha.reshape(4, 7), atol=1e-5)


def test_lobes_come_on_top_before_the_cut():
    bare, atlas = made_atlas(), made_atlas(lobes=True)
    view, light = VIEWS.directions[5], LIGHTS.directions[2]
    basis = atlas.seen_from(view[None], light[None])[0, :, 0]
    expected = bare.uncut(basis, view, light) + atlas.lobes.of_suns(view, light[None])[:, 0]
    np.testing.assert_allclose(atlas.picture(basis, view, light).reshape(-1, 3), np.maximum(expected, 0.0), rtol=1e-5, atol=1e-6)


def test_between_the_baked_directions_it_is_between():
    atlas = made_atlas()
    values = atlas.colour.basis.reshape(len(VIEWS), 5, len(LIGHTS) + 1, 3)[:, :, :-1]
    view, light = fibonacci_sphere(30), np.abs(fibonacci_sphere(20))
    basis = atlas.seen_from(view, light)
    assert basis.shape == (30, 5, 20, 3)
    for number in (3, 17):
        view_taps, view_weights = VIEWS.taps(view[number : number + 1])
        light_taps, light_weights = LIGHTS.taps(light[number : number + 1])
        expected = np.einsum("v,l,vklc->kc", view_weights[0], light_weights[0], values[view_taps[0]][:, :, light_taps[0]])
        np.testing.assert_allclose(basis[number, :, number], expected, atol=1e-5)


def test_local_factors_spread_over_all_clusters_are_the_same_product():
    local = made_atlas(clusters=3).colour
    assert isinstance(local, LocalFactors) and local.clusters == 3
    np.testing.assert_allclose(local.spread(slice(0, None)) @ local.basis[5], local.applied(local.basis[5]), rtol=1e-4, atol=1e-5)
    rows = np.array([3, 8, 20])
    parts = sum(local.part(rows, 5, number) for number in range(local.components))
    np.testing.assert_allclose(parts, local.applied(local.basis[5])[rows], rtol=1e-4, atol=1e-5)
