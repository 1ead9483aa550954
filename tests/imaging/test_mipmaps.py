"""Mipmaps keep the mean of a texture, samples of smooth textures are exact, and images are resized by area."""

import numpy as np
import pytest

from farfield.addon.core.imaging.mipmaps import build_mipmaps, measure_footprints, resize_by_area, sample_mipmaps


@pytest.mark.parametrize("size", [(8, 16), (64, 64), (1, 8)])
def test_every_level_has_the_mean_of_the_texture(size):
    texture = np.random.default_rng(1).random((*size, 3)).astype(np.float32)
    mipmaps = build_mipmaps(texture)
    assert np.array_equal(mipmaps.level(0), texture) and mipmaps.level(len(mipmaps.sizes) - 1).shape == (1, 1, 3)
    for index in range(len(mipmaps.sizes)):
        assert np.abs(mipmaps.level(index).mean(axis=(0, 1)) - texture.mean(axis=(0, 1))).max() < 1e-5


@pytest.mark.parametrize("size", [(7, 5), (1, 1), (1030, 3)])
def test_odd_sizes_keep_a_constant_texture(size):
    mipmaps = build_mipmaps(np.full((*size, 2), 0.25, np.float32))
    assert (mipmaps.texels == 0.25).all() and tuple(mipmaps.sizes[-1]) == (1, 1)


def test_a_sample_of_one_texel_is_bilinear_and_a_large_one_is_the_mean():
    texture = np.random.default_rng(2).random((16, 32, 3)).astype(np.float32)
    mipmaps = build_mipmaps(texture)
    centers = (np.array([[3, 5], [31, 0]]) + 0.5) / [32, 16]
    assert np.abs(sample_mipmaps(mipmaps, centers, np.ones(2)) - texture[[5, 0], [3, 31]]).max() < 1e-5
    assert np.abs(sample_mipmaps(mipmaps, centers + 4.0, np.ones(2)) - texture[[5, 0], [3, 31]]).max() < 1e-4  # repeated
    between = sample_mipmaps(mipmaps, (np.array([[4.0, 5.5]])) / [32, 16], np.ones(1))
    assert np.abs(between - 0.5 * (texture[5, 3] + texture[5, 4])).max() < 1e-5
    assert np.abs(sample_mipmaps(mipmaps, centers, np.full(2, 1e3)) - texture.mean(axis=(0, 1))).max() < 1e-5


def test_trilinear_samples_are_continuous_in_the_footprint():
    mipmaps = build_mipmaps(np.random.default_rng(3).random((32, 32, 1)).astype(np.float32))
    uvs = np.full((200, 2), 0.37)
    colors = sample_mipmaps(mipmaps, uvs, np.geomspace(0.5, 64.0, 200))
    assert np.abs(np.diff(colors[:, 0])).max() < 0.05


def test_footprints_of_known_triangles():
    corners = np.array([[[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]]] * 3)
    uvs = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]] * 3) * [[[0.2, 0.2]], [[0.4, 0.1]], [[0.8, 0.0]]]
    # 100 texels: 2 per pixel in each direction; 4 and 1; 8 and none, limited by the anisotropy
    assert np.allclose(measure_footprints(corners, uvs, (100, 100)), [2.0, 2.0, 2.0])
    assert measure_footprints(corners[:1] * 0.0, uvs[:1], (100, 100)) == [1.0]


def test_resizing_by_area_keeps_means():
    image = np.random.default_rng(4).random((24, 24, 2)).astype(np.float32)
    assert np.abs(resize_by_area(image, 8) - image.reshape(8, 3, 8, 3, 2).mean(axis=(1, 3))).max() < 1e-6
    for size in (1, 5, 17, 24):
        resized = resize_by_area(image, size)
        assert resized.shape == (size, size, 2) and np.abs(resized.mean(axis=(0, 1)) - image.mean(axis=(0, 1))).max() < 1e-6


def test_halving_ends_at_the_smallest_side_that_is_asked_for():
    texture = np.random.default_rng(5).random((12, 20, 3)).astype(np.float32)
    complete = build_mipmaps(texture)
    for min_side, count in ((20, 1), (10, 2), (5, 3)):
        mipmaps = build_mipmaps(texture, min_side=min_side)
        assert len(mipmaps.sizes) == count
        assert all((mipmaps.level(index) == complete.level(index)).all() for index in range(count))
