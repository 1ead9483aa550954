"""Textures of packages: any number of the first increments of a tile is a JPEG file, and they are in the order of gain per byte."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import ImageError, SettingsError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.streaming.increments import decode_increments, encode_increments
from farfield.addon.core.texmesh.streaming.manifest import Manifest, Section
from farfield.addon.core.texmesh.streaming.textures.building import BuiltTextures, build_textures
from farfield.addon.core.texmesh.streaming.textures.coding import choose_factors
from farfield.addon.core.texmesh.streaming.textures.decoding import decode_textures
from farfield.addon.core.texmesh.streaming.textures.progressive_files import check_increment, decode_tile
from farfield.addon.core.texmesh.streaming.textures.queue import order_increments
from farfield.addon.core.texmesh.streaming.textures.settings import TextureSettings
from farfield.addon.core.texmesh.streaming.textures.texture_tiles import TextureSource, TileGrid, fill_unused, find_used_texels
from farfield.addon.core.texmesh.streaming.textures.visibility import measure_visibility
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh
from tests.shapes import sheet

SETTINGS = TextureSettings(tile_size=32, pixels=64, views=4)


def make_source(shape: tuple[int, int] = (70, 90), role: str = "base_color") -> TextureSource:
    mesh = sheet(8, lambda x, y: 0.3 * np.sin(3.0 * x) * y)
    uvs = 0.6 * mesh.vertices[:, :2] / np.abs(mesh.vertices[:, :2]).max()
    image = np.random.default_rng(3).integers(0, 255, (shape[0] // 4 + 1, shape[1] // 4 + 1, 3)).repeat(4, axis=0).repeat(4, axis=1)
    return TextureSource(role, image[: shape[0], : shape[1]].astype(np.uint8), build_textured_mesh(mesh, uvs[mesh.triangles]), (0,))


@pytest.fixture(scope="module")
def built() -> BuiltTextures:
    return run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS))


def test_bytes_add_up(built):
    assert built.increments.sizes.sum() == len(built.content)
    assert len(built.flips) == len(built.increments.sizes) + 1
    assert (np.diff(built.flips) <= 0.0).all()


def test_same_sources_give_same_bytes(built):
    again = run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS))
    assert again.content == built.content and again.textures == built.textures


def test_every_prefix_of_a_tile_decodes(built):
    ends = np.cumsum(built.increments.sizes)
    seen: dict[tuple[int, int], list[bytes]] = {}
    for index, end in enumerate(ends):
        content = built.content[end - built.increments.sizes[index] : end]
        check_increment(content, int(built.increments.scans[index]))
        key = (int(built.increments.textures[index]), int(built.increments.tiles[index]))
        parts = seen.setdefault(key, [])
        parts.append(content)
        texture = built.textures[key[0]]
        assert decode_tile(texture.headers[built.increments.headers[index]], parts).shape == (32, 32, 3)


def test_increments_come_by_falling_gain_per_byte():
    rng = np.random.default_rng(8)
    sizes = rng.integers(1, 50, (20, 6))
    errors = np.concatenate([np.ones((20, 1)), 1.0 - np.cumsum(rng.random((20, 6)) / 6.0, axis=1)], axis=1)
    queued = order_increments(sizes, errors)
    ends = np.concatenate([np.zeros((20, 1), int), np.cumsum(sizes, axis=1)], axis=1)
    bytes_of = ends[queued.rows, queued.first_scans + queued.scan_counts] - ends[queued.rows, queued.first_scans]
    assert (np.diff(queued.gains / bytes_of) <= 1e-12).all()
    for row in range(20):
        own = queued.rows == row
        assert queued.scan_counts[own].sum() == 6 and (np.diff(queued.first_scans[own]) > 0).all()
        assert queued.gains[own].sum() == pytest.approx(errors[row, 0] - errors[row, -1])


def test_scans_without_gain_are_left_out():
    queued = order_increments(np.array([[5, 5, 5, 0]]), np.array([[1.0, 0.5, 0.5, 0.6, 0.6]]))
    assert queued.first_scans.tolist() == [0] and queued.scan_counts.tolist() == [1]


def test_table_agrees_with_the_manifest(built):
    table = encode_increments(built.increments)
    manifest = Manifest(
        name="sheet",
        files={"mesh.bin": (0, ""), "textures.bin": (len(table) + len(built.content), "")},
        mirrors=(),
        bounds=((0.0,) * 3, (1.0,) * 3),
        uv_bounds=((0.0,) * 2, (1.0,) * 2),
        steps=(65535, 65535),
        levels=(),
        materials=(),
        textures=built.textures,
        increment_count=len(built.increments.sizes),
        increments=Section(0, len(table), 0),
        checksums=Section(0, 0, 0),
        first_increment=len(table),
        plan=(),
        time_limit=1.0,
        pixels=64.0,
    )
    found = decode_increments(table, manifest)
    np.testing.assert_array_equal(found.sizes, built.increments.sizes)


def test_all_increments_give_the_texture(built):
    source = make_source()
    found = decode_textures(built.textures, built.increments, built.content)[0]
    used = find_used_texels(source, TileGrid(90, 70, 32))[::-1][-70:, :90]
    difference = np.abs(found.astype(float) - source.image)[used]
    assert found.shape == source.image.shape and difference.mean() < 12.0
    first = decode_textures(built.textures, built.increments, built.content, 1)[0]
    assert np.abs(first.astype(float) - source.image)[used].mean() > difference.mean()


def test_gray_textures_have_one_component():
    source = make_source()
    gray = replace(source, image=np.repeat(source.image[..., :1], 3, axis=2), role="roughness")
    built = run_to_end(build_textures([gray], SETTINGS))
    assert len(built.textures[0].headers[0]) < 400
    assert (np.ptp(decode_textures(built.textures, built.increments, built.content)[0].astype(int), axis=2) == 0).all()


def test_tiles_take_as_few_bytes_as_the_error_allows():
    errors = np.array([[0.1, 0.2, 0.9], [0.1, 0.8, 0.9]])
    byte_counts = np.array([[100, 40, 30], [100, 90, 80]])
    assert choose_factors(errors, byte_counts, 0.31).tolist() == [1, 0]
    assert choose_factors(errors, byte_counts, 0.0).tolist() == [0, 0]
    assert choose_factors(errors, byte_counts, 9.0).tolist() == [2, 2]


def test_features_change_the_order():
    source = make_source()
    scales = np.where(source.mesh.vertices[:, 0] > 0.0, 20, 0).astype(np.int8)
    plain = run_to_end(build_textures([source], SETTINGS))
    weighted = run_to_end(build_textures([replace(source, feature_scales=scales)], replace(SETTINGS, feature_weight=10.0)))
    assert plain.increments.tiles.tolist() != weighted.increments.tiles.tolist()


def test_visibility_counts_all_pixels():
    source = make_source()
    grid = TileGrid(90, 70, 32)
    found = run_to_end(measure_visibility([source], [grid], 6, 64))[0]
    assert found.shape[:2] == (12, 12) and found.sum() == pytest.approx(1.0, abs=1e-5)
    assert not found[9:].any() and not found[:, 12:].any()


def test_repeating_textures_are_used_everywhere_they_repeat():
    source = make_source((64, 64))
    moved = replace(source, mesh=replace(source.mesh, uvs=source.mesh.uvs + [3.0, -2.0]))
    grid = TileGrid(64, 64, 32)
    np.testing.assert_array_equal(find_used_texels(source, grid), find_used_texels(moved, grid))
    far = replace(source, mesh=replace(source.mesh, uvs=source.mesh.uvs * 50.0))
    assert find_used_texels(far, grid).all()


def test_unused_texels_are_filled_smoothly():
    source = make_source((64, 64))
    grid = TileGrid(64, 64, 32)
    used = find_used_texels(source, grid)
    filled = fill_unused(source, grid, used)
    np.testing.assert_array_equal(filled[used], source.image[::-1][used])
    assert np.ptp(filled[~used]) <= np.ptp(source.image) and not used.all()


@settings(deadline=None, max_examples=8)
@given(st.integers(1, 70), st.integers(1, 70), st.sampled_from([16, 32, 48]))
def test_textures_of_any_size_can_be_sent(width, height, tile_size):
    source = make_source((height, width))
    built = run_to_end(build_textures([source], replace(SETTINGS, tile_size=tile_size, views=1)))
    assert decode_textures(built.textures, built.increments, built.content)[0].shape == (height, width, 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros((4, 4, 4), np.uint8)}, "three channels"),
        ({"image": np.zeros((4, 4, 3), np.float32)}, "8 bits"),
        ({"materials": (3,)}, "no triangle"),
    ],
)
def test_other_sources_are_refused(change, message):
    with pytest.raises(ImageError, match=message):
        run_to_end(build_textures([replace(make_source(), **change)], SETTINGS))


def test_tiles_must_consist_of_blocks():
    with pytest.raises(SettingsError):
        run_to_end(build_textures([make_source()], replace(SETTINGS, tile_size=20)))


def test_what_cannot_be_coded_is_refused():
    with pytest.raises(ImageError, match="role"):
        run_to_end(build_textures([make_source(role="height")], SETTINGS))
