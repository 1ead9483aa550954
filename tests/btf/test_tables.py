"""Looked up as the shader does, the tables give what the factors say."""

import numpy as np
import pytest

from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.tables import Tables, ViewTable, colour_basis, one_column_basis, tables_of, weight_images, weights_in
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.directions import fibonacci_sphere
from made_atlases import made_colour


def bilinear(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """`image` at `place` (x, y) in 0..1, as a texture unit reads it."""
    at = place[:2] * [image.shape[1], image.shape[0]] - 0.5
    low = np.floor(at).astype(int)
    right, up = at - low
    columns, rows = (np.clip([low[axis], low[axis] + 1], 0, image.shape[1 - axis] - 1) for axis in (0, 1))
    corners = image[np.ix_(rows, columns)]
    return (1 - up) * ((1 - right) * corners[0, 0] + right * corners[0, 1]) + up * ((1 - right) * corners[1, 0] + right * corners[1, 1])


def under_a_sun(tables: Tables, view: np.ndarray, light: np.ndarray, component: int) -> np.ndarray:
    cell = view * tables.views + 0.5
    low = np.floor(cell)
    right, up = cell - low
    total = np.zeros(4)
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (right if x else 1 - right) * (up if y else 1 - up)
        place = (low + [x, y]) * tables.tile_scale[:2] + light * tables.light_scale[:2] + tables.light_start[:2]
        total += weight * bilinear(tables.basis, place + [0.0, component * tables.step])
    return total


def in_views(table: ViewTable, view: np.ndarray, component: int) -> np.ndarray:
    return bilinear(table.image, view * table.scale[:2] + table.start[:2] + [0.0, component * table.step])


@pytest.mark.parametrize(("views", "lights"), [(DirectionGrid(4), DirectionGrid(3)), (DirectionGrid(3, True), DirectionGrid(5, True))])
def test_look_ups_give_the_interpolated_factors(views, lights):
    random = np.random.default_rng(0)
    colour = Factors(np.ones((1, 3), np.float32), random.random((len(views), 3, 3 * (len(lights) + 1)), np.float32), np.ones(1, bool))
    alpha = Factors(np.ones((1, 6), np.float32), random.random((len(views), 6, 1), np.float32), np.ones(1, bool))
    tables = tables_of(colour, alpha, views, lights)
    values = colour.basis.reshape(len(views), 3, len(lights) + 1, 3)
    for view, light in zip(fibonacci_sphere(40), fibonacci_sphere(40)[::-1] @ np.diag([1.0, -1.0, 1.0]), strict=True):
        (view_taps,), (view_weights,) = views.taps(view[None])
        (light_taps,), (light_weights,) = lights.taps(light[None])
        at_view, at_light = 0.5 * views.places(view[None])[0] + 0.5, 0.5 * lights.places(light[None])[0] + 0.5
        expected = np.einsum("v,l,vlc->c", view_weights, light_weights, values[view_taps][:, 1, light_taps])
        np.testing.assert_allclose(under_a_sun(tables, at_view, at_light, 1)[:3], expected, atol=1e-5)
        dome = in_views(tables.dome, at_view, 2)[:3]
        np.testing.assert_allclose(dome, view_weights @ values[view_taps, 2, -1], atol=1e-5)
        silhouette = [in_views(tables.alpha, at_view, component // 4)[component % 4] for component in range(6)]
        np.testing.assert_allclose(silhouette, view_weights @ alpha.basis[view_taps, :, 0], atol=1e-5)


@pytest.mark.parametrize("clusters", [1, 3])
def test_the_basis_comes_back_out_of_its_images(clusters):
    views, lights = DirectionGrid(4), DirectionGrid(3, upper=True)
    colour = made_colour(2, clusters)
    alpha = Factors(np.ones((2, 3), np.float32), np.random.default_rng(1).random((len(views), 3, 1), np.float32), np.ones(2, bool))
    tables = tables_of(colour, alpha, views, lights)
    assert (tables.clusters, tables.components) == (clusters, 5)
    np.testing.assert_array_equal(colour_basis(tables.basis, tables.dome.image, views, lights, clusters, 5), colour.basis)
    np.testing.assert_array_equal(one_column_basis(tables.alpha.image, views, 3), alpha.basis)


def test_every_cluster_has_a_column():
    views, lights = DirectionGrid(3), DirectionGrid(2)
    colour = made_colour(2, clusters=4, components=2, views=len(views), lights=len(lights))
    alpha = Factors(np.ones((2, 1), np.float32), np.ones((len(views), 1, 1), np.float32), np.ones(2, bool))
    tables = tables_of(colour, alpha, views, lights)
    own = [Factors(colour.weights, colour.basis[:, start : start + 2], colour.known) for start in range(0, 8, 2)]
    alone = [tables_of(each, alpha, views, lights) for each in own]
    np.testing.assert_array_equal(tables.basis, np.concatenate([each.basis for each in alone], axis=1))
    np.testing.assert_array_equal(tables.dome.image, np.concatenate([each.dome.image for each in alone], axis=1))
    assert tables.column == tables.dome.column == 0.25
    np.testing.assert_allclose(np.array(tables.tile_scale) * [4, 1, 1], alone[0].tile_scale)
    np.testing.assert_allclose(np.array(tables.dome.scale) * [4, 1, 1], alone[0].dome.scale)


@pytest.mark.parametrize("tallest", [2, 5, 100])
def test_weights_come_back_out_of_their_images(tallest):
    weights = np.arange(2 * 3 * 10, dtype=np.float32).reshape(2, 3, 10)
    images = weight_images(weights, tallest)
    assert [image.shape[0] for image in images] == {2: [2, 2, 2], 5: [4, 2], 100: [6]}[tallest]
    np.testing.assert_array_equal(weights_in(images, 2, 10), weights)


def test_blocks_of_four_weights_stand_above_each_other():
    weights = np.arange(2 * 3 * 6, dtype=np.float32).reshape(2, 3, 6)
    (image,) = weight_images(weights)
    np.testing.assert_array_equal(image[:2], weights[..., :4])
    np.testing.assert_array_equal(image[2:, :, :2], weights[..., 4:])
    assert (image[2:, :, 2:] == 0.0).all()
