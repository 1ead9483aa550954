"""Tiles as AVIF files with shared headers, and what viewers notice of their errors."""

import io
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from farfield.addon.core.errors import FileError
from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.packages.textures.avif_files import decode_tile, encode_tile, join_file, split_file
from farfield.addon.core.packages.textures.enlarging import blur_as_enlarged, enlarge, sharpen_for_enlarging
from farfield.addon.core.packages.textures.texture_errors import TextureErrors, average_blocks, encode_bytes, merge_resolutions, to_values
from farfield.addon.core.packages.textures.visibility import FOOTPRINT_LEVELS, level_footprints


def soft_image(side: int, seed: int = 0) -> np.ndarray:
    values = np.random.default_rng(seed).integers(0, 256, (4, 4, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(values).resize((side, side), Image.Resampling.BICUBIC))


def test_tile_survives_nearly():
    image = soft_image(64)
    header, payload = encode_tile(image, 90)
    assert np.abs(decode_tile(header, payload, 64).astype(int) - image).mean() < 2.0


def test_every_decoder_reads_the_file():
    header, payload = encode_tile(soft_image(64), 60)
    with Image.open(io.BytesIO(join_file(header, payload))) as image:
        assert image.format == "AVIF" and image.size == (64, 64)
        np.testing.assert_array_equal(np.asarray(image.convert("RGB")), decode_tile(header, payload, 64))


def test_joined_file_splits_into_the_same_parts():
    header, payload = encode_tile(soft_image(32), 50)
    assert split_file(join_file(header, payload)) == (header, payload)


def test_header_is_the_same_for_all_tiles_of_a_size():
    assert len({encode_tile(soft_image(64, seed), quality)[0] for seed in range(3) for quality in (10, 50, 95)}) == 1


def test_gray_tiles_stay_gray():
    gray = soft_image(32)[..., 0]
    header, payload = encode_tile(gray, 80)
    decoded = decode_tile(header, payload, 32).astype(int)
    assert (np.ptp(decoded, axis=2) == 0).all() and np.abs(decoded[..., 0] - gray).mean() < 2.0


def test_other_sizes_are_refused():
    header, payload = encode_tile(soft_image(32), 50)
    with pytest.raises(FileError):
        decode_tile(header, payload, 64)


@given(st.data())
def test_damage_is_refused_or_gives_a_tile(data):
    header, payload = encode_tile(soft_image(32), 50)
    content = bytearray(payload)
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    with suppress(FileError):
        assert decode_tile(header, bytes(content[: data.draw(st.integers(0, len(content)))]), 32).shape == (32, 32, 3)


@given(st.binary(max_size=200))
def test_other_files_are_refused(content):
    with pytest.raises(FileError):
        split_file(content)


def test_enlarged_images_keep_their_mean_and_are_smooth():
    image = np.array([[[0], [200]]], np.uint8).repeat(3, axis=2)
    np.testing.assert_array_equal(enlarge(image, 1)[0, :, 0], [0, 50, 150, 200])
    assert enlarge(image, 0) is image


@pytest.mark.parametrize("role", ["base_color", "normal", "roughness"])
def test_bytes_survive_as_values(role):
    image = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    np.testing.assert_array_equal(encode_bytes(role, to_values(role, image)), image)


def make_errors(role: str, image: np.ndarray, footprint: float) -> TextureErrors:
    shown = np.zeros((image.shape[0] // 8, image.shape[1] // 8, FOOTPRINT_LEVELS), np.float32)
    shown[..., np.abs(level_footprints() - footprint).argmin()] = 1.0 / shown[..., 0].size
    return TextureErrors(role, build_mipmaps(to_values(role, image)), shown, 67.0)


@pytest.mark.parametrize("role", ["base_color", "normal", "roughness"])
def test_same_texture_has_no_error_and_noise_has_less_from_afar(role):
    image = soft_image(128)
    noisy = np.clip(image + np.random.default_rng(1).normal(0.0, 25.0, image.shape), 0, 255).astype(np.uint8)
    near, far = make_errors(role, image, 1.0), make_errors(role, image, 8.0)
    assert near.measure(image, 0)[0].max() < 1e-6
    assert 0.0 < far.measure(noisy, 0)[0].sum() < 0.7 * near.measure(noisy, 0)[0].sum()


@pytest.mark.parametrize("role", ["base_color", "alpha", "normal"])
def test_errors_in_smaller_images_are_those_of_larger_footprints(role):
    image = soft_image(128)
    noisy = np.clip(image + np.random.default_rng(1).normal(0.0, 25.0, image.shape), 0, 255).astype(np.uint8)
    found = make_errors(role, image, 1.0).measure(noisy, 0).sum(axis=(1, 2))
    expected = [make_errors(role, image, footprint).measure(noisy, 0)[0].sum() for footprint in (1.0, 2.0, 4.0, 8.0)]
    np.testing.assert_allclose(found, expected)
    assert (np.diff(found) < 0.0).all()


def test_coarse_texture_is_as_good_from_afar():
    image = soft_image(128)
    coarse = encode_bytes("base_color", build_mipmaps(to_values("base_color", image)).level(2))
    sharpened = sharpen_for_enlarging(coarse[None])[0]
    errors = make_errors("base_color", image, 8.0)
    assert errors.measure(sharpened, 2)[0].sum() < min(0.02, 0.9 * errors.measure(coarse, 2)[0].sum())
    sharp = np.where(np.indices((128, 128)).sum(axis=0)[..., None] % 8 < 4, np.uint8(20), np.uint8(230)).repeat(3, axis=2)
    coarse = encode_bytes("base_color", build_mipmaps(to_values("base_color", sharp)).level(2))
    assert make_errors("base_color", sharp, 1.0).measure(coarse, 2)[0].sum() > 0.2


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_sharpened_tiles_are_the_texture_where_images_minify_it(levels):
    tiles = (0.6 * soft_image(64).reshape(2, 32, 64, 3)[:, :, :32] + 40.0).astype(np.uint8)
    for tile, sharpened in zip(tiles, sharpen_for_enlarging(tiles), strict=True):
        side = 1 << levels
        minified = enlarge(sharpened, levels).reshape(32, side, 32, side, 3).mean(axis=(1, 3))
        assert np.abs(minified - tile).max() <= 1.5
        assert np.abs(blur_as_enlarged(sharpened).astype(int) - tile).max() <= 1


def test_rare_resolutions_count_as_others():
    shown = np.zeros((2, 2, FOOTPRINT_LEVELS), np.float32)
    shown[0, :, level_footprints().tolist().index(1.0)] = 0.01
    shown[1, :, level_footprints().tolist().index(4.0)] = 0.49
    merged = merge_resolutions(shown, 5)
    assert list(merged) == [2] and merged[2].sum() == pytest.approx(1.0)
    assert list(merge_resolutions(np.zeros_like(shown), 5)) == [0]


def test_blocks_average_at_all_resolutions():
    values = np.arange(16.0 * 24.0).reshape(16, 24)
    np.testing.assert_allclose(average_blocks(values, 0, (2, 3)), values.reshape(2, 8, 3, 8).mean(axis=(1, 3)))
    np.testing.assert_allclose(average_blocks(values[:2, :3], 3, (2, 3)), values[:2, :3])
    np.testing.assert_allclose(average_blocks(values[:1, :2], 4, (2, 3)), [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
