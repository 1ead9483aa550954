"""Textures of packages: each increment is an AVIF file of a tile, and states consist of some of them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import ImageError, SettingsError
from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.increments import decode_increments, encode_increments
from farfield.addon.core.packages.manifest import Manifest, Section
from farfield.addon.core.packages.planning import ErrorModel
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.textures.avif_files import decode_tile
from farfield.addon.core.packages.textures.best_state import Choice, choose_state, measure_error
from farfield.addon.core.packages.textures.building import BuiltTextures, build_textures
from farfield.addon.core.packages.textures.coding import COMPLETE, MISSING, VARIANTS, CodedTexture, code_texture, decode_textures
from farfield.addon.core.packages.textures.texture_errors import TextureErrors, values_of_bytes
from farfield.addon.core.packages.textures.texture_tiles import TextureSource, TileGrid, check_source, fill_unused, find_used_texels
from farfield.addon.core.packages.textures.tile_states import choose_states, order_tiles
from farfield.addon.core.packages.textures.visibility import FOOTPRINT_LEVELS, level_footprints, measure_visibility
from farfield.addon.core.packages.tile_pyramid import TilePyramid, sum_tiles
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh
from tests.shapes import sheet

pytestmark = pytest.mark.usefixtures("small_images")
SETTINGS, DENSITY = PackageSettings(tile_size=32, pixels=64), 67.0  # pixels per degree


def make_source(shape: tuple[int, int] = (70, 90), role: str = "base_color") -> TextureSource:
    mesh = sheet(8, lambda x, y: 0.3 * np.sin(3.0 * x) * y)
    uvs = 0.6 * mesh.vertices[:, :2] / np.abs(mesh.vertices[:, :2]).max()
    image = np.random.default_rng(3).integers(0, 255, (shape[0] // 4 + 1, shape[1] // 4 + 1, 3)).repeat(4, axis=0).repeat(4, axis=1)
    return TextureSource(role, image[: shape[0], : shape[1]].astype(np.uint8), build_textured_mesh(mesh, uvs[mesh.triangles]), (0,))


@pytest.fixture(scope="module")
def built(small_images) -> BuiltTextures:
    return run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS, DENSITY, 4))


@pytest.mark.slow
def test_bytes_add_up(built):
    assert built.increments.sizes.sum() == len(built.content)
    assert len(built.flips) == built.increments.state_count
    assert (np.diff(built.flips[:, 0]) <= 0.0).all()
    assert (np.diff(built.increments.measure_states(len(built.flips))) > 0).all()


@pytest.mark.slow
def test_same_sources_give_same_bytes(built):
    again = run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS, DENSITY, 4))
    assert again.content == built.content and again.textures == built.textures


@pytest.fixture(scope="module")
def coded(small_images) -> CodedTexture:
    source = make_source()
    grid = check_source(source, 32)
    visibility = run_to_end(measure_visibility([source], [grid], 4, 64))[0]
    return run_to_end(code_texture(source, grid, visibility, SETTINGS.quality, DENSITY))


def test_texture_coordinates_without_area_are_seen_at_the_smallest_footprint():
    source = make_source()
    mesh = replace(source.mesh, uvs=np.full_like(source.mesh.uvs, 0.5))
    with np.errstate(all="raise"):
        visibility = run_to_end(measure_visibility([replace(source, mesh=mesh)], [check_source(source, SETTINGS.tile_size)], 2, 64))[0]
    assert visibility[..., 0].sum() == pytest.approx(1.0) and not visibility[..., 1:].any()


@pytest.mark.slow
def test_every_increment_is_a_tile_by_itself(built):
    for index, part in enumerate(built.increments.split(built.content)):
        texture = built.textures[built.increments.textures[index]]
        pyramid = TilePyramid(texture.width, texture.height, texture.tile_size)
        side = pyramid.side(pyramid.locate(int(built.increments.tiles[index]))[0])
        assert decode_tile(texture.headers[built.increments.headers[index]], part, side).shape == (side, side, 3)


def test_best_state_is_at_least_as_good_as_others(coded):
    for price in (1e-9, 1e-6, 1e-4, 1.0):
        cost = sum(state_cost(coded, choice, price) for choice in choose_state([coded], price))
        for level in range(len(coded.sizes)):
            for variant in range(len(coded.sizes[level])):
                used = sum_tiles(coded.used.astype(int), level) > 0
                errors = np.where(used, sum_tiles(coded.errors[level, variant], level), 0.0)
                assert cost <= errors.sum() + price * coded.sizes[level][variant].sum() + 1e-12


def test_states_show_every_used_tile_once(coded):
    for price in (1e-9, 1e-5, 1.0):
        times = np.zeros(coded.used.shape, int)
        for choice in choose_state([coded], price):
            times[coded.pyramid.covered(choice.level, choice.row, choice.column)] += 1
        assert (times[coded.used] == 1).all() and (times <= 1).all()


def state_cost(coded, choice, price):
    covered = coded.pyramid.covered(choice.level, choice.row, choice.column)
    return coded.errors[choice.level, choice.variant][covered].sum() + price * state_size(coded, choice)


def state_size(coded, choice):
    return coded.sizes[choice.level][choice.variant, choice.row, choice.column]


def test_states_go_from_few_bytes_to_all_of_the_texture(coded):
    states = choose_states([coded])
    assert {choice.level for choice in states[0]} == {len(coded.sizes) - 1}
    shown = np.zeros(coded.used.shape, bool)
    for choice in states[-1]:
        assert choice.level == 0 and choice.variant == COMPLETE
        shown[choice.row, choice.column] = True
    np.testing.assert_array_equal(shown, coded.used)
    assert measure_error([coded], states[-1]) == pytest.approx(coded.errors[0, COMPLETE][coded.used].sum())
    sizes = [sum(state_size(coded, choice) for choice in state) for state in states]
    assert all(first < second for first, second in pairwise(sizes)) and len(states) > 4
    assert all(last >= 1.2 * first for first, last in zip(sizes, sizes[2:], strict=False))


def test_tiles_in_their_order_give_all_states(coded):
    states = choose_states([coded])
    ordered = order_tiles(states)
    for index, state in enumerate(states):
        is_in = (ordered.firsts <= index) & (index <= ordered.lasts)
        assert sorted(choice for choice, is_here in zip(ordered.choices, is_in, strict=True) if is_here) == sorted(state)
    assert len(set(ordered.choices)) == len(ordered.choices)
    keys = list(zip(ordered.firsts.tolist(), (-ordered.lasts).tolist(), strict=True))
    assert keys == sorted(keys)


def test_tiles_that_come_again_are_sent_again():
    first, second = Choice(0, 1, 0, 0, 0), Choice(0, 0, 0, 0, 0)
    ordered = order_tiles([[first], [second], [first]])
    assert ordered.choices == [first, second, first]
    assert ordered.firsts.tolist() == ordered.lasts.tolist() == [0, 1, 2]


def test_finer_levels_and_higher_qualities_have_smaller_errors(coded):
    sums = coded.errors.sum(axis=(2, 3))
    is_coded = np.isfinite(sums)
    assert is_coded[0].tolist() == [True, False, False, True, False, True, False]  # level 0 is not sharpened
    assert is_coded[1:3].all()  # one or two tiles of full size are used
    assert (is_coded[3:] == [True, True, True, True, False, False, False]).all()
    for is_sharpened in (False, True):
        of_kind = [index for index, variant in enumerate(VARIANTS) if variant.is_sharpened == is_sharpened]
        of_kind.sort(key=lambda index: VARIANTS[index].fraction)
        assert (np.diff(sums[1:3, of_kind]) < 0.0).all()
    assert sums[0, 0] > sums[0, 5] > sums[0, COMPLETE]
    assert (np.diff(sums[:, [0, COMPLETE]], axis=0) > 0.0).all()
    source = make_source()
    grid = check_source(source, 32)
    image = fill_unused(source, grid, find_used_texels(source, grid))
    visibility = run_to_end(measure_visibility([source], [grid], 4, 64))[0]
    judge = TextureErrors(source.role, build_mipmaps(image, values_of_bytes(source.role)), visibility, DENSITY)
    assert (sums[is_coded] < judge.measure(np.full_like(image, MISSING), 0)[0].sum()).all()  # before anything has come


@pytest.mark.slow
def test_sharpened_tiles_are_better_and_smaller_where_details_are_everywhere():
    noise = np.random.default_rng(2).normal(0.0, 30.0, (128, 128, 1))
    wave = 60.0 * np.sin(np.arange(128) / 10.0)[None, :, None] * np.ones((128, 1, 1))  # too long to be blurred by enlarging
    is_better = []
    for details in (noise, wave):
        image = np.clip(128.0 + details + np.zeros(3), 0, 255).astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
        source = replace(make_source((256, 256)), image=image)
        grid = check_source(source, 256)
        visibility = np.zeros((32, 32, FOOTPRINT_LEVELS), np.float32)
        visibility[..., np.flatnonzero(level_footprints() == 2.0)] = 1.0 / 32**2
        coded = run_to_end(code_texture(source, grid, visibility, SETTINGS.quality, DENSITY))
        errors, sizes = coded.errors[1].sum(axis=(1, 2)), coded.sizes[1].sum(axis=(1, 2))
        is_better.append(
            any(VARIANTS[index].is_sharpened for index in np.flatnonzero(errors < errors[COMPLETE]) if sizes[index] < sizes[COMPLETE])
        )
    assert is_better == [True, False]


@given(st.integers(1, 500), st.integers(1, 500), st.sampled_from([16, 32, 48, 64]))
def test_tiles_of_a_level_cover_the_texture_once(width, height, side):
    pyramid = TilePyramid(width, height, side)
    assert pyramid.shapes[-1] == (1, 1) and pyramid.side(0) == side
    for level in range(len(pyramid.shapes)):
        times = np.zeros(pyramid.shapes[0], int)
        for number in range(pyramid.starts[level], pyramid.starts[level + 1]):
            found = pyramid.locate(number)
            assert found[0] == level
            times[pyramid.covered(*found)] += 1
        assert (times == 1).all()
        np.testing.assert_array_equal(sum_tiles(np.ones(pyramid.shapes[0]), level).sum(), times.size)


@pytest.mark.slow
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
        errors=ErrorModel((), (0.1,) * len(built.flips), 2.0),
        state_pixels=(0.0,) * len(built.flips),
        time_limit=1.0,
        pixels=64.0,
    )
    found = decode_increments(table, manifest)
    np.testing.assert_array_equal(found.sizes, built.increments.sizes)


def test_last_state_is_the_texture(built):
    source = make_source()
    found = decode_textures(built.textures, built.increments, built.content)[0]
    used = find_used_texels(source, TileGrid(90, 70, 32))[::-1][-70:, :90]
    difference = np.abs(found.astype(float) - source.image)[used]
    assert found.shape == source.image.shape and difference.mean() < 12.0
    first = decode_textures(built.textures, built.increments, built.content, 0)[0]
    assert np.abs(first.astype(float) - source.image)[used].mean() > difference.mean()


def test_gray_textures_have_one_component():
    source = make_source()
    gray = replace(source, image=np.repeat(source.image[..., :1], 3, axis=2), role="roughness")
    built = run_to_end(build_textures([gray], SETTINGS, DENSITY, 4))
    assert len(built.textures[0].headers[0]) < 400
    assert (np.ptp(decode_textures(built.textures, built.increments, built.content)[0].astype(int), axis=2) == 0).all()


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


@pytest.mark.slow
@settings(deadline=None, max_examples=4)
@given(st.integers(1, 70), st.integers(1, 70), st.sampled_from([16, 32, 48]))
def test_textures_of_any_size_can_be_sent(width, height, tile_size):
    source = make_source((height, width))
    built = run_to_end(build_textures([source], replace(SETTINGS, tile_size=tile_size), DENSITY, 1))
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
        run_to_end(build_textures([replace(make_source(), **change)], SETTINGS, DENSITY, 4))


def test_tiles_must_consist_of_blocks():
    with pytest.raises(SettingsError):
        replace(SETTINGS, tile_size=20)


def test_what_cannot_be_coded_is_refused():
    with pytest.raises(ImageError, match="role"):
        run_to_end(build_textures([make_source(role="height")], SETTINGS, DENSITY, 4))


@pytest.mark.slow
def test_detail_that_no_image_shows_is_coded_once():
    source = make_source((256, 256))
    built = run_to_end(build_textures([source], replace(SETTINGS, tile_size=16, pixels=16), DENSITY, 4))
    pyramid = TilePyramid(256, 256, 16)
    levels = [pyramid.locate(int(number))[0] for number in built.increments.tiles]
    assert levels.count(0) == len({int(number) for number in built.increments.tiles if number < pyramid.starts[1]})
    assert 1 not in levels and max(levels) >= 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tile_size", "finest", "finer"),
    [
        (16, {COMPLETE}, {COMPLETE}),
        pytest.param(32, {COMPLETE}, {5, COMPLETE}, marks=pytest.mark.exhaustive),
        (64, {5, COMPLETE}, {0, 5, COMPLETE}),
    ],
)
def test_detail_finer_than_images_show_has_the_highest_quality_only_where_tiles_are_many(tile_size, finest, finer):
    source = make_source((256, 256))
    grid = check_source(source, tile_size)
    visibility = np.zeros((32, 32, FOOTPRINT_LEVELS), np.float32)
    visibility[..., np.flatnonzero(level_footprints() == 4.0)] = 1.0 / 32**2  # the texture halved twice
    coded = run_to_end(code_texture(source, grid, visibility, SETTINGS.quality, DENSITY))
    variants = {level: {variant for found, variant, _ in coded.tiles if found == level} for level in range(3)}
    assert variants[0] == finest and variants[1] == finer and {0, 1, 2, COMPLETE} <= variants[2]
    assert sum((level, variant) == (0, COMPLETE) for level, variant, _ in coded.tiles) == coded.used.sum()


@pytest.mark.parametrize("footprint", [pytest.param(1.0, marks=pytest.mark.exhaustive), 4.0])
def test_progress_of_coding_never_falls(footprint):
    source = make_source((128, 128))
    grid = check_source(source, 32)
    visibility = np.zeros((16, 16, FOOTPRINT_LEVELS), np.float32)
    visibility[..., np.flatnonzero(level_footprints() == footprint)] = 1.0 / 16**2
    fractions = [progress.fraction for progress in code_texture(source, grid, visibility, SETTINGS.quality, DENSITY)]
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and 0.9 < fractions[-1] <= 1.0


def test_visibility_of_sources_of_one_mesh_is_divided_by_material():
    mesh = make_source().mesh
    halves = replace(mesh, materials=(np.arange(len(mesh.triangles)) % 2).astype(np.int32))
    sources = [replace(make_source(), mesh=halves, materials=materials) for materials in ((0,), (1,), (0, 1))]
    first, second, both = run_to_end(measure_visibility(sources, [check_source(source, 32) for source in sources], 4, 64))
    np.testing.assert_allclose(first + second, both, atol=1e-7)
    assert 0.2 < first.sum() < 0.8 and both.sum() == pytest.approx(1.0)
