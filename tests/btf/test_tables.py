"""Sampled as the shader does, the lookup tables give the interpolated factors."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.settings import MAX_IMAGE_SIDE, BtfSettings
from farfield.addon.core.btf.tables import (
    LookupTables,
    ViewTable,
    build_tables,
    pack_weights,
    unpack_color_basis,
    unpack_scalar_basis,
    unpack_weights,
)
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.directions import DirectionGrid, fibonacci_sphere
from farfield.addon.core.settings import describe
from random_textures import random_color_factors


def sample_bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Sample `image` at `uv` (x, y) in 0..1, as a texture unit does."""
    position = uv[:2] * [image.shape[1], image.shape[0]] - 0.5
    low = np.floor(position).astype(int)
    x, y = position - low
    columns, rows = (np.clip([low[axis], low[axis] + 1], 0, image.shape[1 - axis] - 1) for axis in (0, 1))
    corners = image[np.ix_(rows, columns)]
    return (1 - y) * ((1 - x) * corners[0, 0] + x * corners[0, 1]) + y * ((1 - x) * corners[1, 0] + x * corners[1, 1])


def sample_basis(tables: LookupTables, view: np.ndarray, light: np.ndarray, component: int) -> np.ndarray:
    cell = view * tables.views_per_side + 0.5
    low = np.floor(cell)
    x, y = cell - low
    total = np.zeros(4)
    for right, up in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (x if right else 1 - x) * (y if up else 1 - y)
        uv = (low + [right, up]) * tables.tile_scale[:2] + light * tables.light_scale[:2] + tables.light_offset[:2]
        total += weight * sample_bilinear(tables.basis, uv + [0.0, component * tables.component_step])
    return total


def sample_view_table(table: ViewTable, view: np.ndarray, component: int) -> np.ndarray:
    return sample_bilinear(table.image, view * table.scale[:2] + table.offset[:2] + [0.0, component * table.component_step])


@pytest.mark.parametrize(("views", "lights"), [(DirectionGrid(4), DirectionGrid(3)), (DirectionGrid(3, True), DirectionGrid(5, True))])
def test_sampling_gives_the_interpolated_factors(views, lights):
    random = np.random.default_rng(0)
    color = Factors(np.ones((1, 3), np.float32), random.random((len(views), 3, 3 * (len(lights) + 1)), np.float32), np.ones(1, bool))
    alpha = Factors(np.ones((1, 6), np.float32), random.random((len(views), 6, 1), np.float32), np.ones(1, bool))
    tables = build_tables(color, alpha, views, lights)
    values = color.basis.reshape(len(views), 3, len(lights) + 1, 3)
    for view, light in zip(fibonacci_sphere(40), fibonacci_sphere(40)[::-1] @ np.diag([1.0, -1.0, 1.0]), strict=True):
        (view_taps,), (view_weights,) = views.taps(view[None])
        (light_taps,), (light_weights,) = lights.taps(light[None])
        view_uv, light_uv = 0.5 * views.to_map(view[None])[0] + 0.5, 0.5 * lights.to_map(light[None])[0] + 0.5
        expected = np.einsum("v,l,vlc->c", view_weights, light_weights, values[view_taps][:, 1, light_taps])
        np.testing.assert_allclose(sample_basis(tables, view_uv, light_uv, 1)[:3], expected, atol=1e-5)
        dome = sample_view_table(tables.dome, view_uv, 2)[:3]
        np.testing.assert_allclose(dome, view_weights @ values[view_taps, 2, -1], atol=1e-5)
        silhouette = [sample_view_table(tables.alpha, view_uv, component // 4)[component % 4] for component in range(6)]
        np.testing.assert_allclose(silhouette, view_weights @ alpha.basis[view_taps, :, 0], atol=1e-5)


@pytest.mark.parametrize("clusters", [1, 3])
def test_the_basis_round_trips(clusters):
    views, lights = DirectionGrid(4), DirectionGrid(3, upper=True)
    color = random_color_factors(2, clusters)
    alpha = Factors(np.ones((2, 3), np.float32), np.random.default_rng(1).random((len(views), 3, 1), np.float32), np.ones(2, bool))
    tables = build_tables(color, alpha, views, lights)
    assert (tables.clusters, tables.components) == (clusters, 5)
    np.testing.assert_array_equal(unpack_color_basis(tables.basis, tables.dome.image, views, lights, clusters, 5), color.basis)
    np.testing.assert_array_equal(unpack_scalar_basis(tables.alpha.image, views, 3), alpha.basis)


def test_every_cluster_is_a_column_of_blocks():
    views, lights = DirectionGrid(3), DirectionGrid(2)
    color = random_color_factors(2, clusters=4, components=2, views=len(views), lights=len(lights))
    alpha = Factors(np.ones((2, 1), np.float32), np.ones((len(views), 1, 1), np.float32), np.ones(2, bool))
    tables = build_tables(color, alpha, views, lights)
    clusters = [Factors(color.weights, color.basis[:, start : start + 2], color.known) for start in range(0, 8, 2)]
    cluster_tables = [build_tables(factors, alpha, views, lights) for factors in clusters]
    np.testing.assert_array_equal(tables.basis, np.concatenate([single.basis for single in cluster_tables], axis=1))
    np.testing.assert_array_equal(tables.dome.image, np.concatenate([single.dome.image for single in cluster_tables], axis=1))
    assert tables.cluster_step == tables.dome.cluster_step == 0.25
    np.testing.assert_allclose(np.array(tables.tile_scale) * [4, 1, 1], cluster_tables[0].tile_scale)
    np.testing.assert_allclose(np.array(tables.dome.scale) * [4, 1, 1], cluster_tables[0].dome.scale)


@pytest.mark.parametrize("max_height", [2, 5, 100])
def test_weights_round_trip(max_height):
    weights = np.arange(2 * 3 * 10, dtype=np.float32).reshape(2, 3, 10)
    images = pack_weights(weights, max_height)
    assert [image.shape[0] for image in images] == {2: [2, 2, 2], 5: [4, 2], 100: [6]}[max_height]
    np.testing.assert_array_equal(unpack_weights(images, 2, 10), weights)


def test_blocks_of_four_weights_are_above_each_other():
    weights = np.arange(2 * 3 * 6, dtype=np.float32).reshape(2, 3, 6)
    (image,) = pack_weights(weights)
    np.testing.assert_array_equal(image[:2], weights[..., :4])
    np.testing.assert_array_equal(image[2:, :, :2], weights[..., 4:])
    assert (image[2:, :, 2:] == 0.0).all()


def test_tables_of_silhouettes_and_shadows_cannot_exceed_the_size_limit():
    """So the error about the table size names the settings of the color table only."""
    largest = {description.name: description.maximum for description in describe(BtfSettings)}
    names = ("views_per_side", "alpha_components", "shadows_per_side", "shadow_components")
    settings = BtfSettings(model="emission", lights_per_side=2, components=1, **{name: largest[name] for name in names})
    settings.check_table_size()
    for grid, components in ((settings.view_grid, settings.alpha_components), (settings.shadow_grid, settings.shadow_components)):
        assert -(-components // 4) * (grid.size + 2) <= MAX_IMAGE_SIDE
    with pytest.raises(SettingsError, match=r"1024 views, 1024 lights .* lookup table of 1156 x 18496 pixels") as raised:
        replace(settings, lights_per_side=32, components=16, shadows_per_side=0).check_table_size()
    assert raised.value.settings == ("views_per_side", "lights_per_side", "components")
