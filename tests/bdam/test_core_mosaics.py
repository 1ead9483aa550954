"""Several elevation models become one field, or are refused with a sentence."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, TerrainField, check_heights, open_field
from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from tiff_writer import AREA_KEYS, POINT_KEYS, UTM_KEYS, map_tags, write_tiff

pytest.importorskip("tifffile")

SIDE = 12  # cells of a tile
STEP = 1.0 / SIDE  # degrees
GAPS = FieldSettings(allow_gaps=True)


def world(west: int, north: int, columns: int, rows: int) -> np.ndarray:
    """Heights (rows, columns) of a part of one large terrain, row 0 in the north; west and north are sample numbers."""
    y, x = north - np.arange(rows)[:, None], west + np.arange(columns)
    return (1000 + 13 * x + 7 * y + (x * y) % 11).astype(np.int16)


def write_point_tile(folder: Path, column: int, row: int, heights: np.ndarray | None = None) -> Path:
    """Write the tile at a degree of longitude and latitude; it has its edges in common with its neighbors."""
    if heights is None:
        heights = world(column * SIDE, (row + 1) * SIDE, SIDE + 1, SIDE + 1)
    tags = map_tags((STEP, STEP), (float(column), row + 1.0), POINT_KEYS)
    return write_tiff(folder / f"point_{column}_{row}.tif", heights, tags=tags)


def write_area_tile(folder: Path, column: int, row: int) -> Path:
    """Write the tile at a degree of longitude and latitude; it abuts its neighbors."""
    heights = world(column * SIDE, (row + 1) * SIDE - 1, SIDE, SIDE)
    tags = map_tags((STEP, STEP), (float(column), row + 1.0), AREA_KEYS)
    return write_tiff(folder / f"area_{column}_{row}.tif", heights, "deflate", 2, (16, 16), tags=tags)


def read_all(field: TerrainField) -> np.ndarray:
    return field.read(slice(0, field.shape[0]), slice(0, field.shape[1]))


@pytest.mark.parametrize(("write", "shared"), [(write_point_tile, 1), (write_area_tile, 0)])
def test_tiles_are_one_field_in_any_order(tmp_path, write, shared):
    paths = [write(tmp_path, column, row) for column in (5, 6, 7) for row in (-1, 0)]
    columns, rows = 3 * SIDE + shared, 2 * SIDE + shared
    expected = world(5 * SIDE, SIDE - 1 + shared, columns, rows)[::-1]
    for order in (paths, paths[::-1], paths[3:] + paths[:3]):
        field = open_field(order)
        assert field.shape == (rows, columns)
        assert np.array_equal(read_all(field), expected)
        assert field.mosaic.placement.first == pytest.approx((5.0 + (1 - shared) * STEP / 2.0, -1.0 + (1 - shared) * STEP / 2.0))
        assert check_heights(field) == () and field.warnings == ()
    single = open_field([write_tiff(tmp_path / "all.tif", expected[::-1].astype(np.int16), tags={
        **map_tags((STEP, STEP), (5.0, 1.0), POINT_KEYS if shared else AREA_KEYS)})])  # fmt: skip
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    assert np.allclose(open_field(paths).frame.to_local(x, y), single.frame.to_local(x, y), atol=1e-6)


@pytest.fixture(scope="module")
def mosaic(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mosaic")
    return open_field([write_point_tile(folder, column, row) for column in range(3) for row in range(2)])


@settings(max_examples=50)
@given(st.tuples(st.integers(0, 25), st.integers(0, 25)).map(sorted), st.tuples(st.integers(0, 37), st.integers(0, 37)).map(sorted))
def test_windows_across_tiles(mosaic, rows, columns):
    expected = world(0, 2 * SIDE, 37, 25)[::-1]
    assert np.array_equal(mosaic.read(slice(*rows), slice(*columns)), expected[slice(*rows), slice(*columns)])


def test_tiles_on_both_sides_of_180_degrees(tmp_path):
    heights = np.zeros((SIDE + 1, SIDE + 1), np.int16)
    field = open_field([write_point_tile(tmp_path, 179, 0, heights), write_point_tile(tmp_path, -180, 0, heights + 1)])
    assert field.shape == (SIDE + 1, 2 * SIDE + 1) and field.frame.origin == (180.0, 0.5)
    assert read_all(field)[0].tolist() == [0.0] * (SIDE + 1) + [1.0] * SIDE
    x, _ = field.frame.to_local(np.arange(2 * SIDE + 1), np.zeros(2 * SIDE + 1))
    assert np.allclose(np.diff(x), 111_320.0 * STEP, rtol=1e-3)


def test_common_samples_that_differ_are_counted_and_the_first_file_is_used(tmp_path):
    heights = world(SIDE, SIDE, SIDE + 1, SIDE + 1)
    heights[2:5, 0] += 9
    heights[7, 0] = -32768
    paths = [write_point_tile(tmp_path, 0, 0), write_point_tile(tmp_path, 1, 0, heights)]
    expected = world(0, SIDE, 2 * SIDE + 1, SIDE + 1).astype(np.float32)
    field = open_field(paths)
    assert np.array_equal(read_all(field), expected[::-1])
    (warning,) = check_heights(field)
    assert warning.startswith("3 heights on common edges of neighboring files differ")
    expected[2:5, SIDE] += 9
    other = open_field(paths[::-1])
    assert np.array_equal(read_all(other), expected[::-1]), "a hole is filled by the neighbor that knows the height"


def test_missing_tiles_are_refused_or_unknown(tmp_path):
    paths = [write_area_tile(tmp_path, column, row) for column, row in ((0, 0), (1, 1), (0, 1))]
    with pytest.raises(
        SettingsError, match=r"leave a gap with its south-west corner at x = 1\.04\d+, y = 0\.04\d+ degrees; add that file"
    ) as raised:
        open_field(paths)
    assert raised.value.settings == ("allow_gaps",)
    heights = read_all(open_field(paths, GAPS))
    assert np.array_equal(np.isnan(heights), np.pad(np.ones((SIDE, SIDE), bool), ((0, SIDE), (SIDE, 0))))
    separate = [write_area_tile(tmp_path, column, 0) for column in (0, 2)]
    with pytest.raises(SettingsError, match="leave a gap"):
        open_field(separate)
    assert np.isnan(read_all(open_field(separate, GAPS))).sum() == SIDE * SIDE


def test_one_missing_row_is_a_gap(tmp_path):
    tags = [map_tags((10.0, 10.0), (0.0, north), UTM_KEYS) for north in (0.0, -130.0)]
    paths = [write_tiff(tmp_path / f"{index}.tif", np.ones((12, 12), np.int16), tags=tag) for index, tag in enumerate(tags)]
    with pytest.raises(SettingsError, match=r"at x = 5, y = -125 meters"):
        open_field(paths)


def write_map(folder: Path, name: str, corner=(0.0, 0.0), pixel=(10.0, 10.0), keys=UTM_KEYS) -> Path:
    return write_tiff(folder / name, np.ones((12, 12), np.int16), tags=map_tags(pixel, corner, keys))


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"corner": (0.0, 0.0)}, "overlap by 12 by 12 heights, more than a common edge"),
        ({"corner": (100.0, 0.0)}, "overlap by 2 by 12 heights"),
        ({"corner": (110.0, 60.0)}, None),
        ({"corner": (123.0, 0.0)}, "lie between each other; resample one to the grid of the other"),
        ({"corner": (120.0, 0.0), "pixel": (10.0, 20.0)}, "have different resolutions .cells of 10 by 20 and 10 by 10"),
        (
            {"corner": (120.0, 0.0), "keys": (*UTM_KEYS[:15], 32633, *UTM_KEYS[16:])},
            "different projections .EPSG:32633, meters and EPSG:32632",
        ),
        ({"corner": (120.0, 0.0), "keys": AREA_KEYS}, "different projections .EPSG:4326, degrees and EPSG:32632, meters"),
        ({"corner": (1e9, 0.0)}, "the maximum is 1,048,576"),
    ],
)
def test_files_that_do_not_tile_one_grid(tmp_path, second, message):
    paths = [write_map(tmp_path, "first.tif"), write_map(tmp_path, "second.tif", **second)]
    if message is None:
        assert open_field(paths, GAPS).shape == (18, 23)
        return
    with pytest.raises(FarfieldError, match=message) as raised:
        open_field(paths, GAPS)
    assert str(paths[0]) in str(raised.value) and str(raised.value).endswith(".")


def test_rounded_positions_are_one_grid(tmp_path):
    """Headers of text have few digits."""
    paths = [write_map(tmp_path, "first.tif"), write_map(tmp_path, "second.tif", (120.02, -0.02), (10.0001, 10.0))]
    assert open_field(paths).shape == (12, 24)


def test_files_without_a_position_cannot_be_joined(tmp_path):
    for name in ("first.npy", "second.npy"):
        np.save(tmp_path / name, np.ones((9, 9)))
    with pytest.raises(FileError, match=r'second.npy" has no position, so it cannot be joined with other files'):
        open_field([tmp_path / "first.npy", tmp_path / "second.npy"])


def test_steps_and_units_of_several_files(tmp_path):
    feet = (*UTM_KEYS[:3], 5, *UTM_KEYS[4:], 4099, 0, 1, 9002)
    paths = [write_map(tmp_path, "meters.tif"), write_map(tmp_path, "feet.tif", (120.0, 0.0), keys=feet)]
    field = open_field(paths)
    assert field.height_step is None
    assert np.allclose(read_all(field)[0], [1.0] * 12 + [0.3048] * 12)
    assert open_field(paths[:1]).height_step == 1.0 and open_field(paths[1:]).height_step == 0.3048
