"""Textures of builds: images at the right places, holes, several images, and images that are refused."""

import numpy as np
import pytest
from PIL import Image

from farfield.addon.core.bdam.building.ground_images import place_images
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.textures.grid import TILE_SIZE
from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.geometry.reprojection import Utm
from farfield.addon.core.jobs.progress import run_to_end
from texture_builds import tile_uv
from tiff_writer import AREA_KEYS, UTM_KEYS, map_tags, write_tiff

SIZE, CELL = 49, 20.0
WEST, NORTH = 500_000.0, 5_200_000.0  # The position of the sample in the north-west.
LAMBERT_KEYS = UTM_KEYS[:-5] + (2154, *UTM_KEYS[-4:])
OTHER_UTM_KEYS = UTM_KEYS[:-5] + (32633, *UTM_KEYS[-4:])


def write_dem(folder, holes=False):
    heights = np.random.default_rng(0).uniform(0.0, 50.0, (SIZE, SIZE)).astype(np.float32)
    if holes:
        heights[10:25, 20:40] = np.nan
    tags = tags_at(WEST - 0.5 * CELL, NORTH + 0.5 * CELL, CELL)
    return write_tiff(folder / "dem.tif", heights, tags=tags)


def tags_at(west, north, step, keys=UTM_KEYS):
    """Tags of a map whose upper left corner is at a position."""
    return map_tags((step, step), (west, north), keys)


def gradient(rows, columns, dtype=np.uint8):
    """Red grows to the east and green to the north, sRGB-encoded; row 0 is in the north."""
    y, x = np.mgrid[0:rows, 0:columns]
    image = np.stack([(x + 0.5) / columns, (rows - y - 0.5) / rows, np.full((rows, columns), 0.5)], axis=-1)
    return np.round(image * np.iinfo(dtype).max).astype(dtype)


def build(folder, images, dem=None, **options):
    dem = write_dem(folder) if dem is None else dem
    field = open_field([dem], FieldSettings())
    settings = BdamSettings(**{"patch_size": "16", "executor": "serial", "texture_format": "raw"} | options)
    run_to_end(build_terrain(field, [dem], folder / "store", settings, images))
    return TerrainStore(folder / "store")


def sample(store, positions):
    """Return the texels (N, 4) uint8 of the finest level nearest to grid positions (N, 2); alpha 0 where there is no tile."""
    grid, colors = store.textures.grid, np.zeros((len(positions), 4), np.uint8)
    level = grid.level_count - 1
    tiles = np.minimum((positions * 2**level / grid.size).astype(int), np.array(grid.tile_counts(level)) - 1)
    for tile in np.unique(tiles, axis=0):
        of_tile = (tiles == tile).all(axis=1)
        number = int(store.textures.index.find(level, tile[None])[0])
        if number >= 0:
            texels = (tile_uv(grid, level, tuple(tile), positions[of_tile]) * TILE_SIZE).astype(int)
            pixels = store.textures.read(number)
            colors[of_tile, : pixels.shape[2]] = pixels[texels[:, 1], texels[:, 0]]
            if pixels.shape[2] == 3:
                colors[of_tile, 3] = 255
    return colors


def random_positions(count=400):
    return np.random.default_rng(7).uniform(0.5, SIZE - 1.5, (count, 2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["ground.png", "ground.tif", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("ground.jpg", "ground.webp"))]
)
def test_a_plain_image_covers_the_field(tmp_path, name):
    path, pixels = tmp_path / name, gradient(600, 500)
    if name.endswith("tif"):
        write_tiff(path, pixels)
    else:
        Image.fromarray(pixels).save(path, **({} if name.endswith("png") else {"quality": 98}))
    with build(tmp_path, [path]) as store:
        positions = random_positions()
        expected = 255.0 * positions / (SIZE - 1)
        assert np.abs(sample(store, positions)[:, :2] - expected).max() <= (3.0 if name.endswith(("tif", "png")) else 6.0)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [pytest.param(np.uint8, marks=pytest.mark.exhaustive), np.uint16])
def test_a_georeferenced_image_lies_at_its_position(tmp_path, dtype):
    pixels = gradient(400, 400, dtype)
    west, north, step = WEST + 200.0, NORTH - 100.0, 1.5  # 600 m wide and high
    path = write_tiff(tmp_path / "ground.tif", pixels, compression="deflate", predictor=2, tile=(128, 128), tags=tags_at(west, north, step))
    with build(tmp_path, [path]) as store:
        positions = random_positions()
        x, y = WEST + CELL * positions[:, 0], NORTH - CELL * (SIZE - 1 - positions[:, 1])
        u, v = (x - west) / 600.0, 1.0 - (north - y) / 600.0
        margin = 0.02
        is_inside = (np.minimum(u, v) > margin) & (np.maximum(u, v) < 1.0 - margin)
        is_outside = (np.minimum(u, v) < -margin) | (np.maximum(u, v) > 1.0 + margin)
        colors = sample(store, positions)
        assert (colors[is_inside, 3] == 255).all() and (colors[is_outside, 3] == 0).all()
        assert is_inside.sum() > 50 and is_outside.sum() > 50
        assert np.abs(colors[is_inside, :2] - 255.0 * np.stack([u, v], axis=1)[is_inside]).max() <= 3.0


def test_world_files_place_images_and_later_ones_lie_on_top(tmp_path):
    for name, west, color in (("west.png", WEST - CELL, 50), ("east.jpg", WEST + 400.0, 200)):
        Image.fromarray(np.full((250, 150, 3), color, np.uint8)).save(tmp_path / name)
        ending = {"png": "pgw", "jpg": "jgw"}[name[-3:]]
        lines = (4.0, 0.0, 0.0, -4.0, west + 2.0, NORTH + CELL - 2.0)
        (tmp_path / name).with_suffix(f".{ending}").write_text("\n".join(map(str, lines)), encoding="ascii")
    with build(tmp_path, [tmp_path / "west.png", tmp_path / "east.jpg"]) as store:
        positions = random_positions()
        east = CELL * positions[:, 0]
        reds = sample(store, positions)[:, 0]
        assert np.abs(reds[east < 395.0].astype(int) - 50).max() <= 1
        assert np.abs(reds[(east > 405.0) & (east < 990.0)].astype(int) - 200).max() <= 1


@pytest.mark.slow
def test_an_image_in_degrees_lies_on_a_field_in_utm(tmp_path):
    (west, east), (south, north) = Utm(32).unproject(np.array([WEST + 200.0, WEST + 700.0]), np.array([NORTH - 700.0, NORTH - 200.0]))
    tags = map_tags(((east - west) / 300, (north - south) / 300), (west, north), AREA_KEYS)
    path = write_tiff(tmp_path / "ground.tif", gradient(300, 300), "deflate", tile=(64, 64), tags=tags)
    with build(tmp_path, [path]) as store:
        positions = random_positions(2000)
        colors, meters = sample(store, positions), CELL * positions
        u, v = (meters[:, 0] - 200.0) / 500.0, (meters[:, 1] - (CELL * (SIZE - 1) - 700.0)) / 500.0
        margin = 0.02  # The square in degrees is turned and bent by up to this part of its side.
        is_inside = (np.minimum(u, v) > margin) & (np.maximum(u, v) < 1.0 - margin)
        assert is_inside.sum() > 300 and (colors[is_inside, 3] == 255).all()
        assert np.abs(colors[is_inside, :2] - 255.0 * np.stack([u, v], axis=1)[is_inside]).max() <= 255.0 * margin
        assert (colors[(np.minimum(u, v) < -margin) | (np.maximum(u, v) > 1.0 + margin), 3] == 0).all()


@pytest.mark.parametrize("image_format", ["jpeg", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("raw", "webp"))])
def test_texels_over_holes_are_transparent(tmp_path, image_format):
    Image.fromarray(gradient(600, 600)).save(tmp_path / "ground.png")
    dem = write_dem(tmp_path, holes=True)
    is_known = np.isfinite(open_field([dem]).read(slice(0, SIZE), slice(0, SIZE)))
    with build(tmp_path, [tmp_path / "ground.png"], dem, texture_format=image_format, fill_holes="none") as store:
        positions = random_positions(2000)
        alpha = sample(store, positions)[:, 3]
        low = positions.astype(int)
        corners = np.stack([is_known[low[:, 1] + y, low[:, 0] + x] for x in (0, 1) for y in (0, 1)])
        is_inside = np.abs(positions - np.rint(positions)).min(axis=1) > 0.1  # The nearest texel lies in the same cell.
        assert (alpha[is_inside & ~corners.any(axis=0)] == 0).all() and (alpha[is_inside & corners.all(axis=0)] == 255).all()
        assert (is_inside & ~corners.any(axis=0)).sum() > 50
        mixed = is_inside & corners.any(axis=0) & ~corners.all(axis=0)
        assert (alpha[mixed] > 0).all() and (alpha[mixed] < 255).all()


def test_filled_holes_are_opaque(tmp_path):
    Image.fromarray(gradient(300, 300)).save(tmp_path / "ground.png")
    with build(tmp_path, [tmp_path / "ground.png"], write_dem(tmp_path, holes=True)) as store:
        assert (sample(store, random_positions())[:, 3] == 255).all()


def test_pixels_without_data_are_transparent_and_gray_becomes_rgb(tmp_path):
    pixels = np.full((100, 100), 90, np.uint8)
    pixels[:50] = 0
    path = write_tiff(tmp_path / "ground.tif", pixels, tags={42113: (2, "0")})
    with build(tmp_path, [path]) as store:
        positions = random_positions()
        colors = sample(store, positions)
        in_south = positions[:, 1] < 23.0
        assert (colors[in_south] == [90, 90, 90, 255]).all() and (colors[positions[:, 1] > 25.0, 3] == 0).all()


def place(folder, name, keys=UTM_KEYS, west=WEST, channels=3, **options):
    return write_tiff(folder / name, np.zeros((20, 20, channels), np.uint8), tags=tags_at(west, NORTH, 10.0, keys), **options)


def write_plain(folder, name):
    Image.fromarray(np.zeros((20, 20, 3), np.uint8)).save(folder / name)
    return folder / name


def write_rotated(folder):
    (folder / "rotated.pgw").write_text("1\n0.5\n0.5\n-1\n500000\n5200000", encoding="ascii")
    return write_plain(folder, "rotated.png")


def write_world_text(folder):
    (folder / "text.pgw").write_text("nothing", encoding="ascii")
    return write_plain(folder, "text.png")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: [place(folder, "a.tif", LAMBERT_KEYS)], "different projections .*EPSG:2154, meters and EPSG:32632"),
        (lambda folder: [place(folder, "a.tif", OTHER_UTM_KEYS)], "outside of the elevation model"),
        (lambda folder: [place(folder, "a.tif", west=WEST + 5e4)], "outside of the elevation model"),
        (lambda folder: [place(folder, "a.tif", channels=5)], "5 channels"),
        (lambda folder: [write_plain(folder, "a.png"), write_plain(folder, "b.png")], "no position.*world file"),
        (lambda folder: [write_rotated(folder)], "is rotated"),
        (lambda folder: [write_world_text(folder)], "no world file"),
        (lambda folder: [folder / "missing.png"], "does not exist"),
    ],
)
def test_images_that_do_not_fit_are_refused(tmp_path, make, message):
    with pytest.raises(FarfieldError, match=message):
        build(tmp_path, make(tmp_path))
    assert not any(path.is_dir() for path in tmp_path.iterdir())


def test_truncated_and_foreign_files_are_refused(tmp_path):
    path = write_plain(tmp_path, "a.png")
    path.write_bytes(path.read_bytes()[:20])
    (tmp_path / "b.png").write_text("no image", encoding="ascii")
    (tmp_path / "c.gif").write_bytes(b"GIF89a")
    tiff = place(tmp_path, "d.tif")
    tiff.write_bytes(tiff.read_bytes()[:-400])
    for name in ("a.png", "b.png", "c.gif", "d.tif"):
        with pytest.raises(FileError, match=name):
            build(tmp_path, [tmp_path / name])
    assert not any(path.is_dir() for path in tmp_path.iterdir())


def test_images_with_a_position_need_a_field_with_one(tmp_path):
    np.save(tmp_path / "dem.npy", np.random.default_rng(0).uniform(0.0, 9.0, (33, 33)))
    with pytest.raises(FileError, match="elevation model has none"):
        build(tmp_path, [place(tmp_path, "a.tif")], tmp_path / "dem.npy")


def test_further_images_of_a_file_are_named(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(tmp_path / "pages.tif") as writer:
        for _ in range(2):
            writer.write(gradient(20, 20), photometric="rgb", metadata=None)
    field = open_field([write_dem(tmp_path)])
    image = place_images([tmp_path / "pages.tif"], field.placement, field.shape)[0]
    assert [text.partition('" ')[2] for text in image.warnings] == ["contains several images; the first one is used."]
