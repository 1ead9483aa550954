"""The texture quadtree shows the images: at every level, across tiles, at holes and at the border of the field."""

from functools import lru_cache

import numpy as np
import pytest

from farfield.addon.core.bdam.textures import resampling
from farfield.addon.core.bdam.textures.build import build_tiles, discard_pieces, list_tiles, missing_tiles, tile_path
from farfield.addon.core.bdam.textures.filtering import ENCODED, QUARTERS, encode_linear
from farfield.addon.core.bdam.textures.grid import BORDER, STEP, TILE_SIZE, TextureGrid, count_levels
from farfield.addon.core.bdam.textures.plan import TexturePlan, check_plan
from farfield.addon.core.bdam.textures.resampling import PlacedImage
from farfield.addon.core.bdam.textures.store import TextureStore, write_textures
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.images import sample_bilinear
from farfield.addon.core.jobs.progress import run_to_end
from texture_builds import ArraySource, build_textures, stretch_over_field, tile_uv, write_texture_store

SIZE = 64  # cells


def build(folder, pixels, *, columns=SIZE + 1, rows=SIZE + 1, levels=2, image_format="raw", images=None, **settings) -> TextureStore:
    """The store of an image that is stretched over a field, or of several `images`."""
    grid = TextureGrid(columns, rows, SIZE, (2.0, 2.0), levels)
    images = images or [stretch_over_field(pixels, columns, rows)]
    return TextureStore(write_texture_store(folder, TexturePlan(grid, image_format, **settings), images))


@lru_cache
def photograph(size, seed=0) -> np.ndarray:
    """Noise whose contrast grows with its scale, as in photographs, with hard edges."""
    generator = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(generator.standard_normal((3, size, size)))
    frequency = np.maximum(np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)), 1 / size)
    values = np.fft.irfft2(spectrum / frequency**1.3, s=(size, size))
    values = 118 + 40 * (0.8 * values[:1] + 0.2 * values[1:2]) / values.std() + np.arange(-1, 2)[:, None, None] * 15
    values[:, ::97] += 60
    return np.moveaxis(np.broadcast_to(values, (3, size, size)), 0, -1).clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def photographed(tmp_path_factory):
    """Opens the store of a photograph by the format of its tiles; each is built once."""
    opened = {}

    def open_store(image_format: str) -> TextureStore:
        if image_format not in opened:
            opened[image_format] = build(tmp_path_factory.mktemp(image_format), photograph(2 * STEP), image_format=image_format)
        return opened[image_format]

    yield open_store
    for store in opened.values():
        store.close()


def common_texels(store, number, direction):
    """The texels that a tile and its neighbor along x or y both hold, from each of the two; None without a neighbor."""
    neighbor = store.index.find(store.index.levels[number], store.index.tiles[[number]] + direction)[0]
    if neighbor < 0:
        return None
    first, second = store.read(int(number)), store.read(int(neighbor))
    opaque = [np.dstack([tile, np.full((TILE_SIZE, TILE_SIZE), 255, np.uint8)])[..., :4] for tile in (first, second)]
    return (opaque[0][:, STEP:], opaque[1][:, : 2 * BORDER]) if direction[0] else (opaque[0][STEP:], opaque[1][: 2 * BORDER])


def all_common_texels(store):
    pairs = [common_texels(store, number, direction) for number in range(len(store)) for direction in ((1, 0), (0, 1))]
    return [pair for pair in pairs if pair is not None]


def with_holes(pixels, seed=1):
    """An image with alpha: half-transparent stripes, and large and small holes with other colors in them."""
    generator = np.random.default_rng(seed)
    size = len(pixels)
    alpha = np.full((size, size, 1), 255, np.uint8)
    alpha[:, size // 3 : size // 3 + 20] = 130
    for side in (3, 9, 30, 120):
        for row, column in generator.integers(0, size - side, (12, 2)):
            alpha[row : row + side, column : column + side] = 0
    return np.concatenate([np.where(alpha > 0, pixels, generator.integers(0, 256, 3)), alpha], 2).astype(np.uint8)


def test_every_byte_survives_linear_light():
    codes = np.arange(256)
    assert np.array_equal(encode_linear(LINEAR_OF_BYTE), codes)
    assert np.array_equal(ENCODED[4 * QUARTERS.astype(int)], codes)


@pytest.mark.slow
def test_one_color_stays_that_color_at_every_level(tmp_path):
    color = np.array([3, 97, 250], np.uint8)
    with build(tmp_path, np.broadcast_to(color, (700, 700, 3)), levels=3) as store:
        assert np.bincount(store.index.levels).tolist() == [1, 4, 16]
        assert all((store.read(number) == color).all() for number in range(len(store)))


def test_means_are_those_of_linear_light(tmp_path):
    pixels = np.zeros((2 * STEP, 2 * STEP, 3), np.uint8)
    pixels[::2, ::2] = pixels[1::2, 1::2] = 255
    with build(tmp_path, pixels) as store:
        finest, root = store.read(1), store.read(0)
        assert set(np.unique(finest)) == {0, 255}, "texels that lie on pixels are those pixels"
        assert (root[BORDER:-BORDER, BORDER:-BORDER] == 188).all(), "half of the light of white"


def test_a_coarse_texel_is_the_mean_of_all_pixels_below_it(photographed):
    means = LINEAR_OF_BYTE[photograph(2 * STEP)].reshape(STEP, 2, STEP, 2, 3).mean((1, 3))
    inner = photographed("raw").read(0)[BORDER:-BORDER, BORDER:-BORDER].astype(int)
    assert np.abs(inner - encode_linear(means)).max() <= 1


@pytest.mark.slow
def test_uv_leads_to_the_same_color_in_every_tile_of_a_level(tmp_path):
    """A ramp along x and y is linear, so that its interpolated colors tell where the texture says that a position is."""
    size = 1200
    ramp = np.zeros((size, size, 3), np.float32)
    centers = (np.arange(size) + 0.5) / size
    ramp[..., 0], ramp[..., 1] = centers, centers[:, None]
    with build(tmp_path, ramp, levels=3) as store:
        generator = np.random.default_rng(2)
        for number in range(len(store)):
            level, tile = int(store.index.levels[number]), store.index.tiles[number]
            side = SIZE / 2**level
            positions = (tile + generator.random((200, 2))) * side
            positions[:50, 0] = (tile[0] + generator.integers(0, 2, 50)) * side
            inner = ((positions > 0.1) & (positions < SIZE - 0.1)).all(axis=1)
            uv = tile_uv(store.grid, level, tile, positions)
            assert uv.min() > BORDER / TILE_SIZE - 1e-9 and uv.max() < 1 - BORDER / TILE_SIZE + 1e-9
            colors = sample_bilinear(LINEAR_OF_BYTE[store.read(number)].astype(np.float64), uv * TILE_SIZE)
            assert np.abs(colors[inner, :2] - positions[inner] / SIZE).max() < 0.006, "8 bits, and the halved texels"


def check_common_texels(store):
    pairs = all_common_texels(store)
    assert len(pairs) == 4
    for first, second in pairs:
        assert np.array_equal(first[..., 3], second[..., 3])
        is_known = first[..., 3] > 0
        assert np.array_equal(first[is_known], second[is_known])


@pytest.mark.parametrize("image_format", ["raw", "jpeg"])
def test_texels_that_two_tiles_hold_are_equal(photographed, image_format):
    check_common_texels(photographed(image_format))


@pytest.mark.parametrize("image_format", [pytest.param("raw", marks=pytest.mark.exhaustive), "jpeg"])
def test_texels_that_two_tiles_hold_are_equal_at_holes(tmp_path, image_format):
    pixels = with_holes(photograph(2 * STEP))
    pixels[STEP - 3 : STEP + 140, 200:400] = 0  # one row of the blocks that both tiles hold remains
    pixels[200:400, STEP - 3 : STEP + 140] = 0
    with build(tmp_path, pixels, image_format=image_format) as store:
        check_common_texels(store)


def test_common_texels_of_webp_tiles_differ_little(photographed):
    pairs = all_common_texels(photographed("webp"))
    differences = np.concatenate([np.abs(first.astype(int) - second).ravel() for first, second in pairs])
    assert differences.mean() <= 1.5 and np.percentile(differences, 99.9) <= 8


@pytest.mark.parametrize("image_format", ["jpeg", "webp"])
def test_coded_tiles_need_few_bytes(photographed, image_format):
    store = photographed(image_format)
    assert store.sizes.sum() <= 0.7 * (2 * STEP) ** 2
    i, j = store.index.tiles[2] * STEP
    inner = store.read(2)[BORDER:-BORDER, BORDER:-BORDER].astype(int)
    assert np.abs(inner - photograph(2 * STEP)[j : j + STEP, i : i + STEP]).mean() < 4.0


@pytest.mark.slow
def test_any_split_and_order_of_the_work_gives_the_same_bytes(tmp_path):
    pixels = with_holes(photograph(1000))
    with build(tmp_path, pixels, image_format="jpeg", error="feature") as store:
        plan = store.plan
    images = [stretch_over_field(pixels, SIZE + 1, SIZE + 1)]
    (tmp_path / "other").mkdir()
    generator = np.random.default_rng(0)
    for level in (1, 0):
        tiles = generator.permutation(list_tiles(plan.grid, level))
        assert len(missing_tiles(tmp_path / "other", plan.grid, level)) == len(tiles)
        for part in np.array_split(tiles, 3):
            build_tiles(tmp_path / "other", plan, level, part, images)
        assert len(missing_tiles(tmp_path / "other", plan.grid, level)) == 0
        discard_pieces(tmp_path / "other", level + 1)
    (tmp_path / "again").mkdir()
    run_to_end(write_textures(tmp_path / "other", plan, tmp_path / "again"))
    for path in (tmp_path / "store").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


@pytest.mark.slow
def test_an_interrupted_build_goes_on_and_repairs_what_is_damaged(tmp_path):
    pixels = photograph(600)
    build(tmp_path, pixels, levels=3).close()
    expected = (tmp_path / "store" / "textures.tiles").read_bytes()
    plan = TexturePlan(TextureGrid(SIZE + 1, SIZE + 1, SIZE, (2.0, 2.0), 3), "raw")
    images = [stretch_over_field(pixels, SIZE + 1, SIZE + 1)]
    folder = tmp_path / "interrupted"
    build_textures(folder, plan, images, max_tiles=8)
    damaged = tile_path(folder, 2, 1, 1)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    tile_path(folder, 2, 0, 0).with_suffix(".piece").unlink(missing_ok=True)
    build_textures(folder, plan, images)
    tile_path(folder, 1, 0, 0).unlink()  # whose pieces were deleted
    build_textures(folder, plan, images)
    (tmp_path / "again").mkdir()
    run_to_end(write_textures(folder, plan, tmp_path / "again"))
    assert (tmp_path / "again" / "textures.tiles").read_bytes() == expected


@pytest.mark.slow
def test_a_lone_faint_texel_is_known_up_to_the_root(tmp_path):
    pixels = np.zeros((4 * STEP, 4 * STEP, 4), np.uint8)
    pixels[1234, 987] = 80, 90, 100, 1
    with build(tmp_path, pixels, levels=3) as store:
        assert store.index.tiles.tolist() == [[0, 0], [0, 1], [1, 2]]
        root = store.read(0)
        row, column = BORDER + 1234 // 4, BORDER + 987 // 4
        assert root[row, column].tolist() == [80, 90, 100, 1] and root[..., 3].sum() == 1


@pytest.mark.slow
def test_a_texel_is_the_same_in_every_window_however_its_pixels_are_read(monkeypatch):
    monkeypatch.setattr(resampling, "STRIP_PIXELS", 5_000)
    monkeypatch.setattr(resampling, "encode_premultiplied", lambda image: image)  # floats show what bytes hide
    pixels = with_holes(photograph(1000))
    grid = TextureGrid(SIZE + 1, SIZE + 1, SIZE, (2.0, 2.0), 1)
    for image in (pixels, pixels[..., :3]):
        images = [stretch_over_field(image, SIZE + 1, SIZE + 1)]
        everything = resampling.resample(grid, 0, np.arange(STEP), np.arange(STEP), images)
        for start in (17, 101, 250):
            part = np.arange(start, start + 250)
            assert np.array_equal(resampling.resample(grid, 0, part, part, images), everything[start : start + 250, start : start + 250])


def test_holes_stay_holes_without_a_fringe(tmp_path):
    pixels = np.zeros((2 * STEP, 2 * STEP, 4), np.uint8)
    pixels[..., :3] = (200, 120, 40)
    pixels[..., 3] = 255
    pixels[300:500, 200:701] = 0
    with build(tmp_path, pixels) as store:
        for number in range(len(store)):
            tile = store.read(number)
            assert (tile[..., :3] == (200, 120, 40)).all(), "colors reach into the hole"
        root = store.read(0)[BORDER:-BORDER, BORDER:-BORDER, 3]
        assert (root[150:250, 100:350] == 0).all() and (root[150:250, 350] == 128).all()
        root[150:250, 100:351] = 255
        assert (root == 255).all()


@pytest.mark.slow
def test_tiles_without_a_known_texel_are_not_stored(tmp_path):
    pixels = np.full((2 * STEP, 2 * STEP, 4), 255, np.uint8)
    pixels[STEP:, STEP:, 3] = 0
    with build(tmp_path, pixels) as store:
        # The last one has a texel of its neighbors within reach of interpolation.
        assert store.index.find(1, np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).tolist() == [1, 2, 3, 4]
    pixels[STEP - 1 :, STEP - 1 :, 3] = 0
    (tmp_path / "other").mkdir()
    with build(tmp_path / "other", pixels) as store:
        assert store.index.find(1, np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).tolist() == [1, 2, 3, -1]
    pixels[STEP - 1 :, :, 3] = 0
    (tmp_path / "half").mkdir()
    with build(tmp_path / "half", pixels) as store:
        assert np.bincount(store.index.levels).tolist() == [1, 2]


def test_a_field_smaller_than_its_square_has_no_tiles_and_no_transparency_beyond_its_border(tmp_path):
    pixels = photograph(600)
    with build(tmp_path, pixels, columns=41, rows=24, levels=3) as store:
        assert np.bincount(store.index.levels).tolist() == [1, 2, 6]
        assert all(store.read(number).shape[2] == 3 for number in range(len(store))), "the border is opaque"
        number = int(store.index.find(2, np.array([[2, 1]]))[0])
        tile = store.read(number)
        last = tile[:, BORDER + STEP // 2]  # the field ends at column 40 of the columns 32 to 48 of this tile
        assert (tile[:, BORDER + STEP // 2 + 1 :] == last[:, None]).all()


def test_images_lie_side_by_side_and_upside_down(tmp_path, photographed):
    """Two images that are halves of one give what that one gives, whatever the direction of their rows and columns."""
    pixels = photograph(2 * STEP)
    half, step = STEP, SIZE / (2 * STEP)
    left = PlacedImage(ArraySource(pixels[::-1, :half]), (0.0, SIZE), (step, -step))
    right = PlacedImage(ArraySource(pixels[:, : half - 1 : -1]), (SIZE, 0.0), (-step, step))
    one = photographed("raw")
    with build(tmp_path, None, images=[left, right]) as two:
        assert len(one) == len(two)
        for number in range(len(one)):
            assert np.array_equal(one.read(number), two.read(number))


def test_later_images_lie_over_earlier_ones(tmp_path):
    below = stretch_over_field(np.full((10, 10, 3), 60, np.uint8), SIZE + 1, SIZE + 1)
    patch = np.full((8, 8, 4), (250, 0, 0, 128), np.uint8)
    above = PlacedImage(ArraySource(patch), (16.0, 16.0), (1.0, 1.0))
    with build(tmp_path, None, levels=1, images=[below, above]) as store:
        tile = store.read(0)
        assert tile.shape[2] == 3
        covered = BORDER + 20 * STEP // SIZE
        mixed = 128 / 255 * LINEAR_OF_BYTE[250] + 127 / 255 * LINEAR_OF_BYTE[60]
        assert tile[covered, covered].tolist() == [
            *encode_linear(np.float32([mixed, 127 / 255 * LINEAR_OF_BYTE[60]])),
            tile[covered, covered, 2],
        ]
        assert (tile[covered, -1] == 60).all() and tile[covered, covered, 0] > 60


def test_large_images_are_averaged_not_sampled(tmp_path):
    pixels = np.zeros((2100, 3000, 3), np.uint8)
    pixels[::2] = 255
    with build(tmp_path, pixels, levels=1) as store:
        assert np.abs(store.read(0)[2 * BORDER : -2 * BORDER].astype(int) - 188).max() <= 4, "apart from the first and the last pixels"


def test_unknown_values_of_float_images_are_holes(tmp_path):
    pixels = np.full((100, 100, 3), 0.25, np.float32)
    pixels[:50] = np.nan
    with build(tmp_path, pixels, levels=1) as store:
        tile = store.read(0)
        assert (tile[:200, :, 3] == 0).all() and (tile[-200:, :, 3] == 255).all()
        assert (tile[..., :3] == ENCODED[16384]).all()


@pytest.mark.parametrize(
    "pixel, depth, levels", [(8192 / 16384, 9, 6), (8192 / 16384, 3, 4), (8192 / 504, 9, 1), (8192 / 1000, 9, 2), (8192 / 1100, 9, 3)]
)
def test_the_finest_texels_are_as_small_as_pixels(pixel, depth, levels):
    assert count_levels(8192, depth, pixel) == levels


@pytest.mark.parametrize("settings", [{"quality": 0}, {"image_format": "gif"}, {"error": "none"}])
def test_plans_out_of_range_are_refused(settings):
    with pytest.raises(SettingsError):
        check_plan(TexturePlan(TextureGrid(9, 9, 8, (1.0, 1.0), 1), **settings))
