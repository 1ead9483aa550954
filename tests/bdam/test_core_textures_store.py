"""The store of texture tiles names what is damaged, keeps the rest, and holds the errors that were promised."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.bdam.textures.grid import BORDER, STEP, TextureGrid
from farfield.addon.core.bdam.textures.plan import TexturePlan
from farfield.addon.core.bdam.textures.store import STRUCTURE_FILE, STRUCTURE_KIND, TILES_FILE, TextureStore, write_textures
from farfield.addon.core.bdam.textures.tile_blocks import decode_tile, encode_tile
from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.files.backups import backup_path, copy_to_backup
from farfield.addon.core.files.blocks import BlockReader, BlockWriter
from farfield.addon.core.imaging.coded_images import decode
from farfield.addon.core.jobs.progress import run_to_end
from texture_builds import build_textures, stretch_over_field, write_texture_store

GRID = TextureGrid(65, 65, 64, (2.0, 3.0), 2)


def write_store(folder, pixels, grid=GRID, **settings):
    return write_texture_store(folder, TexturePlan(grid, **settings), [stretch_over_field(pixels, grid.columns, grid.rows)])


@pytest.fixture(scope="module")
def pixels():
    image = np.random.default_rng(0).integers(0, 256, (90, 90, 4), np.uint8).repeat(8, 0).repeat(8, 1)
    image[..., 3] = 255
    image[100:200, 300:500, 3] = 0
    return image


@pytest.fixture(scope="module")
def stored(tmp_path_factory, pixels):
    return write_store(tmp_path_factory.mktemp("textures"), pixels)


@pytest.fixture
def store_folder(stored, tmp_path):
    for path in stored.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_damaged_tile_is_named_and_the_others_are_read(store_folder):
    path = store_folder / TILES_FILE
    content = bytearray(path.read_bytes())
    with TextureStore(store_folder) as store:
        start = len(content) // 2
        assert list(store.verify()) == []
    content[start] ^= 4
    path.write_bytes(content)
    with TextureStore(store_folder) as store:
        (damaged,) = store.verify()
        i, j = store.index.tiles[damaged]
        with pytest.raises(FileError, match=f"texture tile 1/{i}/{j} in .*{TILES_FILE}"):
            store.read(damaged)
        assert all(store.read(number).shape[:2] == (512, 512) for number in range(len(store)) if number != damaged)


@pytest.mark.slow
def test_any_damage_of_the_structure_is_found_when_the_store_is_opened_and_costs_nothing(store_folder):
    path = store_folder / STRUCTURE_FILE
    with TextureStore(store_folder) as store:
        assert store.damages == () and store.plan == TexturePlan(GRID)
        expected = store.index.tiles, store.errors
    for damaged in (path, backup_path(path)):
        content = damaged.read_bytes()
        for place in range(len(content)):
            damaged.write_bytes(content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :])
            with TextureStore(store_folder) as store:
                assert [damage.path for damage in store.damages] == [damaged]
                assert np.array_equal(store.index.tiles, expected[0]) and np.array_equal(store.errors, expected[1])
        damaged.write_bytes(content)


def test_a_store_whose_structure_and_backup_are_damaged_is_refused(store_folder):
    for path in (store_folder / STRUCTURE_FILE, backup_path(store_folder / STRUCTURE_FILE)):
        path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FileError, match=STRUCTURE_FILE):
        TextureStore(store_folder)


def test_files_that_do_not_belong_together_are_refused(store_folder):
    with BlockReader(store_folder / STRUCTURE_FILE, STRUCTURE_KIND) as reader:
        blocks = [reader.read(number, "") for number in range(len(reader))]
    for changed in (
        [blocks[0], *(block[: len(block) * 4 // 5] for block in blocks[1:5]), blocks[5]],
        [b"{}", *blocks[1:]],
        blocks[:5],
        [blocks[0]] * 6,
        [*blocks[:5], bytes(4)],
    ):
        with BlockWriter(store_folder / STRUCTURE_FILE, STRUCTURE_KIND) as writer:
            for block in changed:
                writer.append(block)
            writer.finish()
        copy_to_backup(store_folder / STRUCTURE_FILE)
        with pytest.raises(FileError, match=r"damaged|belong to different textures"):
            TextureStore(store_folder)


@pytest.mark.slow
def test_tiles_of_other_textures_are_refused(store_folder, tmp_path_factory, pixels):
    other = write_store(tmp_path_factory.mktemp("other"), pixels[::-1])
    for name in (TILES_FILE, backup_path(Path(TILES_FILE)).name):
        shutil.copy(other / name, store_folder / name)
    with pytest.raises(FileError, match="belong to different textures; build the terrain again"):
        TextureStore(store_folder)


def test_an_unfinished_build_is_not_a_store(tmp_path):
    build_textures(tmp_path, TexturePlan(GRID), [stretch_over_field(np.zeros((9, 9, 3), np.uint8), 65, 65)], max_tiles=2)
    with pytest.raises(FileError, match="0-0-0"):
        run_to_end(write_textures(tmp_path, TexturePlan(GRID), tmp_path))
    with pytest.raises(FileError):
        TextureStore(tmp_path)


def test_coded_images_are_ordinary_files(stored):
    with TextureStore(stored) as store:
        kinds = set()
        for number in range(len(store)):
            coded, tile = store.read_coded(number), store.read(number)
            assert np.array_equal(decode(coded.color), tile[..., :3])
            assert (coded.alpha is None) == (tile.shape[2] == 3)
            kinds.add(tile.shape[2])
            if coded.alpha is not None:
                assert np.array_equal(decode(coded.alpha)[..., 0], tile[..., 3])
        assert kinds == {3, 4}
        assert len(store.sizes) == len(store) == 5


@pytest.mark.parametrize("image_format", ["jpeg", "webp", "raw"])
def test_damaged_blocks_of_tiles_give_one_sentence(image_format):
    colors = np.random.default_rng(1).integers(0, 256, (16, 16, 3), np.uint8)
    alpha = np.arange(256, dtype=np.uint8).reshape(16, 16)
    block = encode_tile(colors, alpha, image_format, 90)
    assert np.array_equal(decode_tile(block, 256)[..., 3], alpha)
    for size in range(len(block)):
        with pytest.raises(FarfieldError):
            decode_tile(block[:size], 256)


def test_the_error_by_magnification_is_the_size_of_texels(stored):
    with TextureStore(stored) as store:
        assert np.allclose(store.errors, [64 / STEP * 3.0, 0, 0, 0, 0])
        assert np.array_equal(store.own_errors, store.errors)


@pytest.mark.slow
def test_the_error_by_features_is_zero_where_nothing_visible_disappears(tmp_path):
    """A fine pattern in one corner of the finest level, a coarser one in the opposite corner, one color elsewhere."""
    grid = TextureGrid(65, 65, 64, (2.0, 2.0), 3)
    pixels = np.full((4 * STEP, 4 * STEP, 3), 120, np.uint8)
    pixels[100:400:2, 100:400] = 200
    lines = 3 * STEP + np.arange(100, 400)
    pixels[np.ix_(lines, lines)] = np.where(np.arange(300) // 2 % 2, 120, 200)[:, None, None]
    store_folder = write_store(tmp_path, pixels, grid, image_format="raw", error="feature")
    with TextureStore(store_folder) as store:
        sizes = [grid.texel_meters(level) for level in range(3)]
        own = {tuple(tile): error for tile, error in zip(store.index.tiles[1:5].tolist(), store.own_errors[1:5], strict=True)}
        assert np.allclose([own[0, 0], own[1, 0], own[0, 1]], [sizes[1], 0.0, 0.0])
        assert np.isclose(own[1, 1], sizes[1])
        assert np.isclose(store.own_errors[0], sizes[0]), "lines of two texels are texels of the level above"
        tile = store.read(0)[BORDER:-BORDER, BORDER:-BORDER]
        assert (tile[5:20, 300:] == 120).all()


def test_one_color_needs_its_root_tile_only(tmp_path):
    store_folder = write_store(tmp_path, np.full((2 * STEP, 2 * STEP, 3), 99, np.uint8), error="feature")
    with TextureStore(store_folder) as store:
        assert (store.errors == 0.0).all()
