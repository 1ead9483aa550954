"""Elevation models as programs write them: both terrain tools read the same heights, holes and sizes, and name what they correct."""

import math
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.bdam.building.tiff_colors import TiffColors, check_colors
from farfield.addon.core.bdam.fields.terrain_field import open_field, warn_of_heights
from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.segment_cache import SegmentCache
from farfield.addon.core.files.tiffs import open_tiff
from tiff_writer import UTM_KEYS, map_tags, write_tiff

pytest.importorskip("tifffile")

ROWS, COLUMNS = 40, 44
CORNER = (500_000.0, 4_500_000.0)
HOLES = np.zeros((ROWS, COLUMNS), bool)
HOLES[10:20, 12:25] = True
PLACED = map_tags((10.0, 10.0), CORNER)
FOOT, SURVEY_FOOT = 0.3048, 1200.0 / 3937.0
METERS_PER_DEGREE = 111_320.0


def ramp(dtype=np.float32) -> np.ndarray:
    """Heights (ROWS, COLUMNS) from 100 to 221, row 0 in the north."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    return (100 + y + 2 * x - (x > 40)).astype(dtype)


def read_both(path: Path) -> tuple[np.ndarray, tuple[float, float], tuple[str, ...]]:
    """Return heights, row 0 in the north, the size of a cell in the local frame and the warnings that both tools agree on."""
    field = warn_of_heights(open_field([path]))
    heights = field.read(slice(0, field.shape[0]), slice(0, field.shape[1]))
    height_map = read_file(path)
    assert np.array_equal(height_map.heights, heights, equal_nan=True)
    offsets = np.array([0.5, -0.5])
    x, y = field.frame.to_local(field.shape[1] / 2 - 0.5 + offsets, field.shape[0] / 2 - 0.5 + offsets)
    cell = (x[0] - x[1], y[0] - y[1])
    assert height_map.pixel_size == pytest.approx(cell, rel=0.01)
    warnings = tuple(text for text in field.warnings if "has no position" not in text)
    assert height_map.warnings == warnings
    return heights[::-1], cell, tuple(text.replace(f'"{path}" ', "") for text in warnings)


def metadata(scale: float | None = None, offset: float | None = None, unit: str | None = None) -> dict[int, tuple]:
    """GDAL's metadata of a band."""
    items = {"SCALE": scale, "OFFSET": offset, "UNITTYPE": unit}
    texts = [
        f'  <Item name="{name}" sample="0" role="{name.lower()}">{value}</Item>\n' for name, value in items.items() if value is not None
    ]
    other = '  <Item name="SCALE" sample="1" role="scale">7</Item>\n  <Item name="AREA">role="scale"</Item>\n'
    return {42112: (2, f"<GDALMetadata>\n{other}{''.join(texts)}</GDALMetadata>")}


def test_gray_values_are_as_bright_as_the_image_looks(tmp_path):
    """Samples of an image may count from white, or be indices of colors; maps keep their numbers."""
    values = np.arange(256, dtype=np.uint8).reshape(16, 16)
    gray = np.sqrt(np.arange(256) / 255).repeat(3).reshape(256, 3)
    palette = tuple((65535 * gray.T).astype(int).ravel().tolist())
    photometric = {"black": {}, "white": {262: (3, (0,))}, "palette": {262: (3, (3,)), 320: (3, palette)}}
    paths = {name: write_tiff(tmp_path / f"{name}.tif", values, tags=tags) for name, tags in photometric.items()}
    found = {name: read_file(path).heights[::-1].ravel() for name, path in paths.items()}
    assert found["black"] == pytest.approx(np.arange(256) / 255)
    assert found["white"] == pytest.approx(1 - found["black"], abs=1e-6)
    assert found["palette"] == pytest.approx(gray[:, 0], abs=1 / 255)
    bits = {256: (3, (16,)), 258: (3, (1,)), 262: (3, (3,)), 320: (3, (0, 13107) * 3)}
    path = write_tiff(tmp_path / "bits.tif", np.packbits(values > 100, axis=1), tags=bits)
    assert read_file(path).heights[::-1].ravel() == pytest.approx(0.2 * (np.arange(256) > 100))
    map_of_classes = write_tiff(tmp_path / "map.tif", values, tags=photometric["palette"] | PLACED)
    assert np.array_equal(read_file(map_of_classes).heights[::-1].ravel(), np.arange(256))
    colors = TiffColors(open_tiff(paths["white"]), SegmentCache()).read(slice(0, 16), slice(0, 16))
    assert np.array_equal(colors[..., 0], 255 - values)


@pytest.mark.parametrize("photometric", [5, 6, 8])
def test_other_colors_are_no_heights_and_no_texture(tmp_path, photometric):
    values = np.zeros((16, 16, 4 if photometric == 5 else 3), np.uint8)
    path = write_tiff(tmp_path / "a.tif", values, tags={262: (3, (photometric,))})
    for check in (read_file, lambda path: check_colors(open_tiff(path))):
        with pytest.raises(FileError, match="has CMYK, Lab or YCbCr colors"):
            check(path)


@pytest.mark.parametrize("compression", ["none", "lzw", "deflate", "packbits", "zstd"])
def test_masked_cells_are_holes(tmp_path, compression):
    path = write_tiff(tmp_path / "map.tif", ramp(), compression, tags=PLACED, mask=~HOLES, big=compression == "lzw")
    heights, _, warnings = read_both(path)
    assert np.array_equal(np.isnan(heights), HOLES) and np.array_equal(heights[~HOLES], ramp()[~HOLES]) and warnings == ()


def test_masked_pixels_of_a_texture_are_transparent(tmp_path):
    colors = np.full((ROWS, COLUMNS, 3), 200, np.uint8)
    tiff = open_tiff(write_tiff(tmp_path / "map.tif", colors, "deflate", mask=~HOLES))
    pixels = TiffColors(tiff, SegmentCache()).read(slice(0, ROWS), slice(0, COLUMNS))
    assert np.array_equal(pixels[:, :, 3], np.where(HOLES, 0, 255)) and (pixels[:, :, :3] == 200).all()


def test_a_mask_in_a_file_of_its_own(tmp_path):
    path = write_tiff(tmp_path / "map.tif", ramp(), tags=PLACED)
    write_tiff(tmp_path / "map.tif.msk", np.where(HOLES, 0, 255).astype(np.uint8)).rename(tmp_path / "map.tif.msk")
    assert np.array_equal(np.isnan(read_both(path)[0]), HOLES)
    write_tiff(tmp_path / "map.tif.msk", np.zeros((9, 9), np.uint8))
    assert not np.isnan(read_both(path)[0]).any(), "a mask of another size is not the one of this image"


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32])
def test_transparent_cells_are_holes(tmp_path, dtype):
    bands = np.stack([ramp(dtype), np.where(HOLES, 0, 100).astype(dtype)], axis=2)
    heights, _, warnings = read_both(write_tiff(tmp_path / "a.tif", bands, "deflate", tags={**PLACED, 338: (3, (2,))}))
    assert np.array_equal(np.isnan(heights), HOLES) and warnings == ()
    heights, _, warnings = read_both(write_tiff(tmp_path / "b.tif", bands, "deflate", tags={**PLACED, 338: (3, (0,))}))
    assert not np.isnan(heights).any() and warnings == ("has 2 channels; the first one is used.",)


def test_further_images_are_named(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffWriter(tmp_path / "pages.tif") as writer:
        writer.write(ramp(), metadata=None)
        writer.write(ramp()[::2, ::2], metadata=None, subfiletype=1)
        writer.write(ramp() + 1.0, metadata=None)
    heights, _, warnings = read_both(tmp_path / "pages.tif")
    assert np.array_equal(heights, ramp()) and warnings == ("contains several images; the first one is used.",)


@pytest.mark.parametrize(
    ("items", "factor", "shift", "step"),
    [
        ({"scale": 0.1, "offset": 100}, 0.1, 100.0, 0.1),
        ({"scale": 0.1, "offset": 100.05}, 0.1, 100.05, None),
        ({"scale": -0.5}, -0.5, 0.0, 0.5),
        ({"unit": "ft"}, FOOT, 0.0, FOOT),
        ({"unit": "US survey foot", "scale": 0.01, "offset": 3}, 0.01 * SURVEY_FOOT, 3.0 * SURVEY_FOOT, 0.01 * SURVEY_FOOT),
        ({"unit": "Meter"}, 1.0, 0.0, 1.0),
        ({"unit": "cm"}, 0.01, 0.0, 0.01),
        ({"scale": 0.0, "offset": math.nan}, 1.0, 0.0, 1.0),
    ],
)
def test_scale_offset_and_unit_of_gdal(tmp_path, items, factor, shift, step):
    values = ramp(np.int16)
    values[3, 4] = -9999
    path = write_tiff(tmp_path / "map.tif", values, tags={**map_tags((10.0, 10.0), CORNER, no_data="-9999,0"), **metadata(**items)})
    heights, _, warnings = read_both(path)
    assert np.isnan(heights[3, 4]) and np.isnan(heights).sum() == 1 and warnings == ()
    assert np.allclose(np.delete(heights, 4, axis=1), factor * np.delete(values, 4, axis=1).astype(float) + shift, rtol=1e-6)
    assert open_field([path]).height_step == (None if step is None else pytest.approx(step))


def test_samples_with_a_scale_are_elevations(tmp_path):
    heights, _, _ = read_both(write_tiff(tmp_path / "map.tif", ramp(np.uint16), tags=metadata(0.1, -5.0)))
    assert np.allclose(heights, 0.1 * ramp() - 5.0)


def test_an_unknown_unit_is_named(tmp_path):
    heights, _, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags={**PLACED, **metadata(unit="el")}))
    assert np.array_equal(heights, ramp()) and warnings == ('has heights in the unknown unit "el"; they are taken as meters.',)


def keys(*rows: tuple[int, int]) -> tuple[int, ...]:
    """The tag of geo keys with these values."""
    return (1, 1, 0, len(rows), *(number for key, value in rows for number in (key, 0, 1, value)))


FEET_WARNING = "has positions in feet and heights without a unit; they are taken as meters."


@pytest.mark.parametrize(
    ("code", "unit"),
    [
        *((2263, SURVEY_FOOT), (2230, SURVEY_FOOT), (6539, SURVEY_FOOT), (3404, SURVEY_FOOT), (26741, SURVEY_FOOT), (32104, 1.0)),
        *((2223, FOOT), (2256, FOOT), (2992, FOOT), (6405, FOOT), (26914, 1.0), (27700, 1.0), (2193, 1.0), (5070, 1.0)),
        *((27291, 0.914398414616), (29371, 1.0000135965)),
    ],
)
def test_units_of_systems_by_their_code(tmp_path, code, unit):
    _, cell, warnings = read_both(
        write_tiff(tmp_path / "map.tif", ramp(), tags=map_tags((10.0, 10.0), CORNER, keys((1024, 1), (3072, code))))
    )
    assert cell == pytest.approx((10.0 * unit, 10.0 * unit)) and warnings == ((FEET_WARNING,) if unit in (FOOT, SURVEY_FOOT) else ())


def test_a_declared_vertical_unit_needs_no_warning(tmp_path):
    tags = map_tags((10.0, 10.0), CORNER, keys((1024, 1), (3072, 2263), (4096, 6360)))
    heights, _, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags=tags))
    assert np.allclose(heights, ramp() * SURVEY_FOOT, rtol=1e-6) and warnings == ()


GUESSED = "has no coordinate reference system; its cells are so small that its coordinates are taken as degrees."


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ((), (GUESSED,)),
        (((1024, 1), (2048, 4326)), (GUESSED,)),
        (((2048, 4326),), ()),
        (((1024, 1), (3072, 4326)), ()),
        (((1024, 2), (2048, 32767)), ()),
    ],
)
def test_degrees_are_recognized(tmp_path, rows, expected):
    tags = map_tags((1 / 3600, 1 / 3600), (8.0, 60.0), keys(*rows))
    _, cell, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags=tags if rows else {33550: tags[33550], 33922: tags[33922]}))
    assert cell == pytest.approx((METERS_PER_DEGREE / 7200, METERS_PER_DEGREE / 3600), rel=0.01) and warnings == expected


def test_scans_with_local_coordinates_are_in_meters(tmp_path):
    tags = map_tags((0.01, 0.01), (-2.0, 3.0))
    _, cell, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags={33550: tags[33550], 33922: tags[33922]}))
    assert cell == pytest.approx((0.01, 0.01)) and warnings == ()


@pytest.mark.parametrize(("code", "latitude"), [(3857, 60.0), (3857, -45.0), (3395, 30.0), (3857, 0.0)])
def test_mercator_projections_have_their_true_size(tmp_path, code, latitude):
    north = 6378137.0 * math.asinh(math.tan(math.radians(latitude))) + 10.0 * ROWS / 2
    tags = map_tags((10.0, 10.0), (900_000.0, north), keys((1024, 1), (3072, code)))
    _, cell, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags=tags))
    assert cell == pytest.approx((10.0 * math.cos(math.radians(latitude)),) * 2, rel=1e-3)
    assert [text[:25] for text in warnings] == ["has a Mercator projection"] * (latitude != 0.0)


def test_web_mercator_by_its_name(tmp_path):
    tags = map_tags((10.0, 10.0), (900_000.0, 8_399_938.0), keys((1024, 1), (3072, 32767), (3076, 9001)))
    tags[34737] = (2, "WGS_1984_Web_Mercator_Auxiliary_Sphere|")
    _, cell, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(), tags=tags))
    assert cell == pytest.approx((5.0, 5.0), rel=1e-3)
    assert warnings == ("has a Mercator projection, which stretches it 2 times; its true size is used.",)


def test_the_origin_of_a_stretched_map_is_a_position_on_it(tmp_path):
    tags = map_tags((10.0, 10.0), (900_000.0, 8_400_000.0), keys((1024, 1), (3072, 3857)))
    field = open_field([write_tiff(tmp_path / "map.tif", ramp(), tags=tags)])
    assert field.frame.origin == (900_220.0, 8_399_800.0)
    x, y = field.frame.to_grid(0.0, 0.0)
    assert field.placement.position(float(x), float(y)) == pytest.approx(field.frame.origin)


@pytest.mark.parametrize("number", [-9999, -32767, -32768, -99999, -999, -10000, 32767])
def test_undeclared_voids_are_holes_and_are_named(tmp_path, number):
    values = ramp()
    values[HOLES] = number
    np.save(tmp_path / "map.npy", values)
    for path in (tmp_path / "map.npy", write_tiff(tmp_path / "map.tif", values, "deflate", tags=PLACED)):
        heights, _, warnings = read_both(path)
        assert np.array_equal(np.isnan(heights), HOLES)
        assert warnings == (f"has 130 heights of {number}, taken as unknown.",)


def test_undeclared_voids_are_compared_as_the_file_writes_them(tmp_path):
    values = ramp(np.int16)
    values[5, 6] = -9999
    tags = {**PLACED, **metadata(0.1, 100.0, "ft")}
    heights, _, warnings = read_both(write_tiff(tmp_path / "map.tif", values, tags=tags))
    assert np.argwhere(np.isnan(heights)).tolist() == [[5, 6]]
    assert warnings == ("has 1 height of -9999, taken as unknown.",)


def test_numbers_among_other_heights_are_heights(tmp_path):
    """The bottom of the sea is deeper than 9,999 m in places; a plain may be at -999 m."""
    depths = np.linspace(-10_500.0, -9000.0, ROWS * COLUMNS).reshape(ROWS, COLUMNS).astype(np.float32)
    depths[HOLES] = -9999.0
    for values in (depths, depths + 9000.0):
        np.save(tmp_path / "map.npy", values)
        heights, _, warnings = read_both(tmp_path / "map.npy")
        assert np.array_equal(heights, values) and warnings == ()


def test_a_declared_number_is_the_only_one(tmp_path):
    values = ramp()
    values[HOLES], values[0, 0] = -9999, -1
    heights, _, warnings = read_both(write_tiff(tmp_path / "map.tif", values, tags=map_tags((10.0, 10.0), CORNER, no_data="-1")))
    assert np.argwhere(np.isnan(heights)).tolist() == [[0, 0]] and warnings == ()


SRTM_SHAPES = {
    "N47E011.hgt": (1201, 1201),
    "n38e050.SRTMGL1.hgt": (3601, 3601),
    "n61_e010_1arc.hgt": (3601, 1801),
    "S47W011.hgt": (7201, 7201),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.exhaustive if "S47" in name else ()) for name in SRTM_SHAPES])
def test_srtm_tiles_of_every_size(tmp_path, name):
    shape = SRTM_SHAPES[name]
    values = np.zeros(shape, ">i2")
    values[0], values[:, 0], values[3, 4] = 100, 200, 32767
    values.tofile(tmp_path / name)
    heights, _, warnings = read_both(tmp_path / name)
    assert np.argwhere(np.isnan(heights)).tolist() == [[3, 4]] and warnings == ("has 1 height of 32767, taken as unknown.",)
    assert np.array_equal(np.delete(heights, 4, axis=1), np.delete(values, 4, axis=1))
    placement = open_field([tmp_path / name]).placement
    last = placement.position(shape[1] - 1, shape[0] - 1)
    assert last == pytest.approx((placement.first[0] + 1.0, placement.first[1] + 1.0)) and abs(placement.first[1]) in (38, 47, 61)


ASCII_HEADER = "ncols 3\nnrows 2\nxllcorner 500000\nyllcorner 4500000\ncellsize 10\n"


@pytest.mark.parametrize(
    "text",
    [
        "\ufeff" + ASCII_HEADER + "NODATA_value -9999\n1.5 2 -9999\n4 5 6.25\n",
        ASCII_HEADER.upper() + "NODATA_VALUE -9999\nBYTEORDER LSBFIRST\n1.5 2 -9999\n4 5 6.25\n",
        "PROJECTION UTM\n" + ASCII_HEADER + "1.5 2 -9999\r\n4 5 6.25\r\n",
        ASCII_HEADER + "NODATA_value *\n1.5 2 *\n4 5 6.25\n",
        ASCII_HEADER + "NODATA_value null\n1.5 2 null\n4 5 6.25\n",
        ASCII_HEADER + "NODATA_value nan\n1.5 2 nan\n4 5 6.25",
        ASCII_HEADER + "NODATA: -1\n1.5 2 -1\n4 5 6.25\n",
        ASCII_HEADER + "1.5 2 -9999\n4 5 6.25\nCRS\nNOTES 1 2 3 4\n",
        "ncols 3\nnrows 2\nxllcenter 500005,0\nyllcenter 4500005,0\nxcellsize 10,0\nycellsize 10,0\nNODATA -9,0\n1,5 2 -9,0\n4 5 6,25",
    ],
)
def test_ascii_grids_of_many_programs(tmp_path, text):
    (tmp_path / "map.asc").write_bytes(text.encode())
    heights, cell, warnings = read_both(tmp_path / "map.asc")
    assert np.array_equal(heights, [[1.5, 2.0, np.nan], [4.0, 5.0, 6.25]], equal_nan=True)
    assert cell == (10.0, 10.0) and warnings == ()
    assert open_field([tmp_path / "map.asc"]).placement.first == (500_005.0, 4_500_005.0)


@pytest.mark.parametrize("word", ["nan", "null"])
def test_an_ascii_grid_may_begin_with_an_unknown_height(tmp_path, word):
    (tmp_path / "map.asc").write_text(f"ncols 2\nnrows 2\ncellsize 10\n{word} 2\n3 4\n")
    assert np.array_equal(read_both(tmp_path / "map.asc")[0], [[np.nan, 2.0], [3.0, 4.0]], equal_nan=True)


def test_an_unplaced_tiff_is_where_its_world_file_says(tmp_path):
    path = write_tiff(tmp_path / "map.tif", ramp(np.uint16))
    (tmp_path / "map.tfw").write_text("20\n0\n0\n-30\n500010\n4500000\n")
    heights, cell, warnings = read_both(path)
    assert np.array_equal(heights, ramp()) and cell == (20.0, 30.0) and warnings == ()
    assert open_field([path]).placement.first == (500_010.0, 4_500_000.0 - 39 * 30.0)
    (tmp_path / "map.prj").write_text(
        'PROJCS["x",GEOGCS["y",UNIT["degree",0.017]],UNIT["Foot_US",0.3048006096012192]],VERT_CS["z",UNIT["m",1]]'
    )
    assert read_both(path)[1] == pytest.approx((20.0 * SURVEY_FOOT, 30.0 * SURVEY_FOOT))


def test_gdal_keeps_what_a_format_cannot_hold_in_a_file_of_its_own(tmp_path):
    values = ramp(np.int16)
    values[3, 4] = -7
    path = write_tiff(tmp_path / "map.tif", values)
    wkt = 'PROJCS["x",GEOGCS["y",UNIT["degree",0.017]],UNIT["foot",0.3048]]'.replace('"', "&quot;")
    bands = '<PAMRasterBand band="1"><NoDataValue>-7</NoDataValue><Scale>0.1</Scale><UnitType>ft</UnitType></PAMRasterBand>'
    bands += '<PAMRasterBand band="2"><Offset>9</Offset></PAMRasterBand>'
    transform = "<GeoTransform>500000, 20, 0, 4500000, 0, -30</GeoTransform>"
    (tmp_path / "map.tif.aux.xml").write_text(f'<PAMDataset><SRS dataAxisToSRSAxisMapping="1,2">{wkt}</SRS>{transform}{bands}</PAMDataset>')
    heights, cell, warnings = read_both(path)
    assert np.argwhere(np.isnan(heights)).tolist() == [[3, 4]] and warnings == ()
    assert np.allclose(np.delete(heights, 4, axis=1), 0.1 * FOOT * np.delete(values, 4, axis=1), rtol=1e-6)
    assert cell == pytest.approx((20.0 * FOOT, 30.0 * FOOT))
    assert open_field([path]).placement.first == pytest.approx((500_010.0 * FOOT, (4_500_000.0 - 15.0 - 39 * 30.0) * FOOT))


def test_a_name_too_long_for_further_files(tmp_path):
    heights, _, _ = read_both(write_tiff(tmp_path / f"{'a' * 250}.tif", ramp(), tags=PLACED))
    assert np.array_equal(heights, ramp())


@pytest.mark.parametrize("name", ["text.tif", "N24E035.hgt", "empty.asc"])
def test_answers_of_servers_are_no_elevation_models(tmp_path, name):
    (tmp_path / name).write_text('{"errorMessage": "Invalid scene or product"}')
    for read in (read_file, lambda path: open_field([path])):
        with pytest.raises(FileError, match=name):
            read(tmp_path / name)


def test_utm_is_as_before(tmp_path):
    heights, cell, warnings = read_both(write_tiff(tmp_path / "map.tif", ramp(np.int16), tags=map_tags((10.0, 20.0), CORNER, UTM_KEYS)))
    assert np.array_equal(heights, ramp()) and cell == (10.0, 20.0) and warnings == ()
