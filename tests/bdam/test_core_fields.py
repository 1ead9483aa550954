"""Elevation models by window: every format gives heights in meters at the right place, and holes stay holes."""

import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, TerrainField, check_heights, open_field
from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from terrain_files import write_png
from tiff_writer import AREA_KEYS, POINT_KEYS, UTM_KEYS, map_tags, write_tiff

pytest.importorskip("tifffile")

ROWS, COLUMNS = 40, 61
CORNER = (500_000.0, 5_000_000.0)
FEET_KEYS = (1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3076, 0, 1, 9003, 4099, 0, 1, 9002)


def terrain(rows: int = ROWS, columns: int = COLUMNS) -> np.ndarray:
    """Integer heights (rows, columns), row 0 in the north, all different."""
    y, x = np.mgrid[0:rows, 0:columns]
    return (7 * x - 11 * y + (x * y) % 5 + 500).astype(np.int16)


def read_all(field: TerrainField) -> np.ndarray:
    return field.read(slice(0, field.shape[0]), slice(0, field.shape[1]))


def write_asc(path: Path, values: np.ndarray, header: str, per_line: int | None = None, newline: str = "\n") -> Path:
    """Write an Arc ASCII grid with `per_line` numbers per line."""
    numbers = [f"{value:g}" for value in values.ravel()]
    step = per_line or values.shape[1]
    lines = [" ".join(numbers[start : start + step]) for start in range(0, len(numbers), step)]
    size = f"ncols {values.shape[1]}\nnrows {values.shape[0]}\n"
    path.write_bytes((size + header + "\n".join(lines) + "\n").replace("\n", newline).encode())
    return path


def write_hgt(path: Path, values: np.ndarray) -> Path:
    path.write_bytes(values.astype(">i2").tobytes())
    return path


def all_formats(folder: Path) -> dict[str, Path]:
    """The same heights in every format."""
    values = terrain()
    tags = map_tags((30.0, 30.0), CORNER)
    np.save(folder / "map.npy", values)
    np.save(folder / "columns.npy", np.asfortranarray(values.astype(np.float64)))
    return {
        "plain.tif": write_tiff(folder / "plain.tif", values, tags=tags),
        "tiled.tif": write_tiff(folder / "tiled.tif", values.astype(np.float32), "deflate", 3, (16, 16), tags=tags),
        "packed.tif": write_tiff(folder / "packed.tif", values.astype(np.int32), "lzw", 2, order=">", big=True, tags=tags),
        "lines.asc": write_asc(folder / "lines.asc", values, "xllcorner 5\nyllcorner 6\ncellsize 30\n"),
        "wrapped.asc": write_asc(folder / "wrapped.asc", values, "XLLCENTER 5\nYLLCENTER 6\nCELLSIZE 30\nNODATA_value -1\n", 7, "\r\n"),
        "map.npy": folder / "map.npy",
        "columns.npy": folder / "columns.npy",
    }


@pytest.fixture(scope="module")
def fields(tmp_path_factory):
    return {name: open_field([path]) for name, path in all_formats(tmp_path_factory.mktemp("formats")).items()}


@settings(max_examples=30)
@given(
    st.tuples(st.integers(0, ROWS), st.integers(0, ROWS)).map(sorted),
    st.tuples(st.integers(0, COLUMNS), st.integers(0, COLUMNS)).map(sorted),
)
def test_every_format_gives_the_same_windows(fields, rows, columns):
    expected = terrain()[::-1][slice(*rows), slice(*columns)]
    for name, field in fields.items():
        heights = field.read(slice(*rows), slice(*columns))
        assert heights.dtype == np.float32 and heights.shape == expected.shape, name
        assert np.array_equal(heights, expected), name


@pytest.fixture(scope="module")
def positioned(tmp_path_factory):
    """Fields with every kind of frame."""
    folder = tmp_path_factory.mktemp("positions")
    kinds = [
        map_tags((30.0, 30.0), CORNER),
        map_tags((10.0, 20.0), CORNER, FEET_KEYS),
        map_tags((0.01, 0.02), (-179.99, 80.0), POINT_KEYS),
    ]
    paths = [write_tiff(folder / f"{index}.tif", terrain(), tags=tags) for index, tags in enumerate(kinds)]
    return [open_field([path]) for path in [*paths, write_asc(folder / "map.asc", terrain(), "cellsize 30\n")]]


def test_steps_of_heights(fields):
    steps = {name: field.height_step for name, field in fields.items()}
    assert steps == {**dict.fromkeys(steps), "plain.tif": 1.0, "packed.tif": 1.0, "map.npy": 1.0}


class TestHoles:
    """Unknown heights are NaN."""

    @pytest.mark.parametrize("declared", [None, "-32767", "-9999"])
    def test_of_integers(self, tmp_path, declared):
        values = terrain()
        values[3, 4], values[5, 6], values[7, 8] = -32768, -32767, -9999
        field = open_field([write_tiff(tmp_path / "map.tif", values, tags=map_tags((30.0, 30.0), CORNER, no_data=declared))])
        holes = {(ROWS - 1 - row, column) for row, column in np.argwhere(np.isnan(read_all(field))).tolist()}
        expected = {None: {(3, 4), (5, 6)}, "-32767": {(3, 4), (5, 6)}, "-9999": {(3, 4), (7, 8)}}
        assert holes == expected[declared]

    def test_of_floats(self, tmp_path):
        values = terrain().astype(np.float32)
        values[0, :5] = np.nan, -3.4e38, 1e31, np.inf, -9999.0
        for declared, count in ((None, 4), ("-9999", 5), ("nan", 4), ("-3.4028234663852886e+38", 4), ("-1.7976931348623157e+308", 4)):
            path = write_tiff(tmp_path / "map.tif", values, "deflate", 3, tags=map_tags((30.0, 30.0), CORNER, no_data=declared))
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                heights = read_all(open_field([path]))
            assert np.isnan(heights[-1, :5]).sum() == np.isnan(heights).sum() == count

    def test_of_text_and_srtm(self, tmp_path):
        values = terrain()
        values[2, 3] = -9999
        default = open_field([write_asc(tmp_path / "a.asc", values, "cellsize 30\n")])
        declared = open_field([write_asc(tmp_path / "b.asc", values, "cellsize 30\nNODATA_value -1\n")])
        assert np.argwhere(np.isnan(read_all(default))).tolist() == [[ROWS - 3, 3]]
        assert not np.isnan(read_all(declared)).any()
        tile = np.ones((1201, 1201), np.int16)
        tile[0, 1] = -32768
        assert np.argwhere(np.isnan(read_all(open_field([write_hgt(tmp_path / "N01E002.hgt", tile)])))).tolist() == [[1200, 1]]

    def test_a_field_without_any_height_is_refused(self, tmp_path):
        path = write_tiff(tmp_path / "map.tif", np.full((9, 9), -32768, np.int16), tags=map_tags((30.0, 30.0), CORNER))
        with pytest.raises(FileError, match=r'map.tif" contains no known height: all are marked as missing'):
            check_heights(open_field([path]))
        values = np.full((9, 9), -32768, np.int16)
        values[0, 0] = 5
        assert check_heights(open_field([write_tiff(path, values, tags=map_tags((30.0, 30.0), CORNER))])) == ()


class TestPositions:
    """Grid coordinates on the ground."""

    def test_of_areas_and_points_in_meters(self, tmp_path):
        for keys, shift in ((UTM_KEYS, 15.0), ((1, 1, 0, 2, 1024, 0, 1, 1, 1025, 0, 1, 2), 0.0)):
            field = open_field([write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((30.0, 30.0), CORNER, keys))])
            x, y = field.frame.to_local(np.array([0.0, 60.0, 0.5]), np.array([39.0, 0.0, -1.0]))
            assert np.allclose(x + field.frame.origin[0], CORNER[0] + shift + np.array([0.0, 1800.0, 15.0]), atol=1e-9)
            assert np.allclose(y + field.frame.origin[1], CORNER[1] - shift - np.array([0.0, 39 * 30.0, 40 * 30.0]), atol=1e-9)
            assert np.abs([x, y]).max() < 2000.0, "the origin lies near the data"
            assert all(number == int(number) for number in field.frame.origin)
            assert field.cell_size == 30.0
        assert open_field([write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((30.0, 30.0), CORNER))]).crs == "EPSG:32632, meters"

    def test_feet(self, tmp_path):
        field = open_field([write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((10.0, 20.0), CORNER, FEET_KEYS))])
        foot = 1200.0 / 3937.0
        x, y = field.frame.to_local(np.arange(3), np.arange(3))
        assert np.allclose(np.diff(x), 10.0 * foot) and np.allclose(np.diff(y), 20.0 * foot)
        assert x[0] + field.frame.origin[0] == pytest.approx((CORNER[0] + 5.0) * foot, abs=1e-9)
        assert np.allclose(read_all(field), terrain()[::-1] * 0.3048, rtol=1e-6)
        assert field.height_step == 0.3048 and field.cell_size == pytest.approx(foot * 200.0**0.5)

    def test_degrees(self, tmp_path):
        """Distances of neighbors are those on the ellipsoid, and the field is not resampled."""
        step = 1.0 / 1200.0
        tags = map_tags((step, step), (8.0, 47.0), POINT_KEYS)
        field = open_field([write_tiff(tmp_path / "map.tif", terrain(), tags=tags)])
        assert np.array_equal(read_all(field), terrain()[::-1])
        center = np.array([8.0 + 30 * step, 47.0 - 19.5 * step])
        assert np.allclose(field.frame.origin, center, atol=1e-6)
        x, y = field.frame.to_local(np.array([30.0, 31.0, 30.0]), np.array([19.5, 19.5, 20.5]))
        root = 1.0 - 0.00669437999014 * np.sin(np.radians(center[1])) ** 2
        assert np.hypot(x[1] - x[0], y[1] - y[0]) == pytest.approx(
            np.radians(step) * 6378137.0 / root**0.5 * np.cos(np.radians(center[1])), abs=1e-4
        )
        assert y[2] - y[0] == pytest.approx(np.radians(step) * 6378137.0 * (1.0 - 0.00669437999014) / root**1.5, abs=1e-3)
        area = open_field([write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((step, step), (8.0, 47.0), AREA_KEYS))])
        assert area.mosaic.placement.first == pytest.approx((8.0 + step / 2.0, 47.0 - 39.5 * step))

    @given(st.floats(-70.0, 130.0), st.floats(-50.0, 90.0))
    def test_to_grid_inverts_to_local(self, positioned, x, y):
        for field in positioned:
            assert np.allclose(field.frame.to_grid(*field.frame.to_local(x, y)), (x, y), atol=1e-6)

    def test_of_an_srtm_tile(self, tmp_path):
        tile = np.arange(1201 * 1201).reshape(1201, 1201).astype(np.int16)
        field = open_field([write_hgt(tmp_path / "s03w071.hgt", tile)])
        placement = field.mosaic.placement
        assert placement.first == (-71.0, -3.0) and placement.position(1200, 1200) == pytest.approx((-70.0, -2.0))
        assert (field.shape, field.height_step, field.crs) == ((1201, 1201), 1.0, "EPSG:4326, degrees")

    def test_of_text(self, tmp_path):
        header = "xll{0} 100\nyll{0} 200\ncellsize 30\n"
        corner, center = (
            open_field([write_asc(tmp_path / f"{kind}.asc", terrain(), header.format(kind))]) for kind in ("corner", "center")
        )
        assert corner.mosaic.placement.first == (115.0, 215.0) and center.mosaic.placement.first == (100.0, 200.0)
        degrees = write_asc(tmp_path / "degrees.asc", terrain(), "xllcorner 8\nyllcorner 46\ncellsize 0.001\n")
        field = open_field([degrees])
        assert field.mosaic.placement.is_geographic and "are taken as degrees" in field.warnings[0]
        (tmp_path / "degrees.prj").write_text('GEOGCS["WGS 84",DATUM["WGS_1984"],UNIT["degree",0.0174532925199433]]')
        assert open_field([degrees]).warnings == ()
        (tmp_path / "degrees.prj").write_text('PROJCS["x",GEOGCS["y",UNIT["degree",0.017]],UNIT["Foot_US",0.3048006096012192]]')
        assert open_field([degrees]).mosaic.placement.step == pytest.approx((0.0003048006096,) * 2)

    def test_south_up_maps(self, tmp_path):
        matrix = (30.0, 0.0, 0.0, 100.0, 0.0, 30.0, 0.0, 200.0, *(0.0,) * 7, 1.0)
        field = open_field([write_tiff(tmp_path / "map.tif", terrain(), tags={34264: (12, matrix)})])
        assert np.array_equal(read_all(field), terrain())
        assert field.mosaic.placement.first == (115.0, 215.0)

    def test_files_without_a_position_use_the_cell_size(self, tmp_path):
        np.save(tmp_path / "map.npy", terrain())
        field = open_field([tmp_path / "map.npy"], FieldSettings(cell_size=2.5))
        x, _ = field.frame.to_local(np.arange(2), np.zeros(2))
        assert x[1] - x[0] == field.cell_size == 2.5
        assert field.warnings[0].endswith("has no position on a map; its cells are taken as 2.5 m wide (Cell Size).")


class TestImages:
    """Gray images as heights."""

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    def test_png(self, tmp_path, dtype):
        white = np.iinfo(dtype).max
        gray = np.linspace(0, white, ROWS * COLUMNS).astype(dtype).reshape(ROWS, COLUMNS)
        path = write_png(tmp_path / "map.png", gray)
        field = open_field([path], FieldSettings(image_height=200.0), lambda _: (gray[::-1] / white).astype(np.float32))
        assert np.allclose(read_all(field), 200.0 * gray[::-1] / white, rtol=1e-5)
        assert field.height_step == pytest.approx(200.0 / white)
        assert any("256 different heights; use an image with 16 bits" in warning for warning in field.warnings) == (dtype == np.uint8)

    def test_exr_has_no_steps(self, tmp_path):
        (tmp_path / "map.exr").write_bytes(b"\x76\x2f\x31\x01")
        field = open_field([tmp_path / "map.exr"], FieldSettings(image_height=1.0), lambda _: terrain().astype(np.float32))
        assert field.height_step is None and np.array_equal(read_all(field), terrain())

    def test_gray_tiff(self, tmp_path):
        for dtype, count in ((np.uint8, 2), (np.uint16, 1)):
            gray = terrain().astype(dtype)
            field = open_field([write_tiff(tmp_path / "map.tif", gray)], FieldSettings(image_height=50.0))
            assert np.allclose(read_all(field), 50.0 * gray[::-1] / np.iinfo(dtype).max, rtol=1e-6)
            assert len(field.warnings) == count


class TestErrors:
    """One sentence for every file that is no elevation model."""

    def refuse(self, path: Path, message: str, read_image=None) -> None:
        with pytest.raises(FarfieldError, match=message) as raised:
            check_heights(open_field([path], read_image=read_image))
        text = str(raised.value)
        assert text.endswith(".") and str(path) in text and text.count(". ") == 0

    def test_no_elevation_models(self, tmp_path):
        (tmp_path / "text.tif").write_bytes(b"hello" * 100)
        (tmp_path / "notes.txt").write_bytes(b"hello")
        (tmp_path / "empty.tif").write_bytes(b"")
        (tmp_path / "text.asc").write_bytes(b"hello\n" * 100)
        (tmp_path / "text.npy").write_bytes(b"hello")
        np.save(tmp_path / "cube.npy", np.ones((3, 3, 3)))
        np.save(tmp_path / "complex.npy", np.ones((3, 3), complex))
        np.save(tmp_path / "objects.npy", np.array([[{}, {}], [{}, {}]], object))
        for name, message in {
            "missing.tif": "does not exist",
            "text.tif": "cannot be read as a TIFF file",
            "notes.txt": r"is no elevation model; its name must end in one of \.asc, ",
            "empty.tif": "is empty",
            "text.asc": "is no Arc ASCII grid: its header lacks",
            "text.npy": "cannot be read as a NumPy array",
            "cube.npy": "an array with 3 axes; heights have 2",
            "complex.npy": "samples of type complex128",
            "objects.npy": "cannot be read as a NumPy array",
        }.items():
            self.refuse(tmp_path / name, message)

    def test_color_and_palette_images(self, tmp_path):
        colors = np.zeros((9, 9, 3), np.uint8)
        self.refuse(write_tiff(tmp_path / "colors.tif", colors), "is a color image, no elevation model")
        palette = {262: (3, (3,)), 320: (3, (0,) * 768)}
        self.refuse(write_tiff(tmp_path / "palette.tif", colors[:, :, :1], tags=palette), "is an image with a palette, no elevation model")
        path = write_png(tmp_path / "palette.png", colors[:, :, 0])
        content = bytearray(path.read_bytes())
        content[25] = 3
        path.write_bytes(content)
        self.refuse(path, "is an image with a palette", lambda _: colors[:, :, 0])
        self.refuse(write_png(tmp_path / "map.png", colors[:, :, 0]), "which only Blender can read")

    def test_lines(self, tmp_path):
        self.refuse(write_tiff(tmp_path / "line.tif", terrain(1, 30)), "has 30 by 1 heights; terrain needs at least 2 along each side")
        np.save(tmp_path / "line.npy", terrain(30, 1))
        self.refuse(tmp_path / "line.npy", "has 1 by 30 heights")

    def test_maps_that_are_rotated_mirrored_or_in_strange_units(self, tmp_path):
        matrices = {"is rotated on the map": (30.0, 5.0, 5.0, -30.0), "is mirrored on the map": (-30.0, 0.0, 0.0, -30.0)}
        for message, (a, b, d, e) in matrices.items():
            matrix = (a, b, 0.0, 100.0, d, e, 0.0, 200.0, *(0.0,) * 7, 1.0)
            self.refuse(write_tiff(tmp_path / "map.tif", terrain(), tags={34264: (12, matrix)}), message)
        geocentric = (1, 1, 0, 1, 1024, 0, 1, 3)
        self.refuse(write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((1.0, 1.0), CORNER, geocentric)), "system or unit")
        for corner, pixel, message in (((8.0, 91.0), 0.1, "has latitudes from"), ((0.0, 50.0), 1.1, "covers 66 degrees of longitude")):
            self.refuse(write_tiff(tmp_path / "map.tif", terrain(), tags=map_tags((pixel, pixel), corner, POINT_KEYS)), message)

    def test_files_that_are_truncated_or_huge(self, tmp_path):
        path = write_asc(tmp_path / "map.asc", terrain(), "cellsize 30\n")
        path.write_bytes(path.read_bytes()[:-40])
        self.refuse(path, r"contains 2,4\d\d heights; according to its header it must have 2,440: it is truncated")
        (tmp_path / "huge.asc").write_text("ncols 9999999\nnrows 9999999\ncellsize 1\n1 2 3\n")
        self.refuse(tmp_path / "huge.asc", "cannot contain 9,999,999 by 9,999,999 heights in 45 bytes")
        (tmp_path / "words.asc").write_text("ncols 2\nnrows 2\ncellsize 1\n1 2 3 four\n")
        self.refuse(tmp_path / "words.asc", "something other than numbers")
        (tmp_path / "more.asc").write_text("ncols 2\nnrows 2\ncellsize 1\n1 2 3 4 5\n")
        self.refuse(tmp_path / "more.asc", "contains 5 heights; according to its header it must have 4: save it again")
        np.save(tmp_path / "map.npy", terrain())
        (tmp_path / "map.npy").write_bytes((tmp_path / "map.npy").read_bytes()[:-9])
        self.refuse(tmp_path / "map.npy", "cannot be read as a NumPy array: it is truncated")
        tile = write_hgt(tmp_path / "N01E001.hgt", np.ones((1201, 1200), np.int16))
        self.refuse(tile, "has 2,882,400 bytes; an SRTM tile has 2,884,802, 12,970,802, 25,934,402 or 103,708,802")
        self.refuse(
            write_hgt(tmp_path / "alps.hgt", np.ones((1201, 1201), np.int16)), 'the position of its south-west corner, as in "N46E008.hgt"'
        )
        single = dict.fromkeys((256, 257, 322, 323), (4, (2**14,)))
        self.refuse(
            write_tiff(tmp_path / "map.tif", terrain(), "deflate", 1, (48, 64), tags=single), "in parts of 512 MiB, .* save it with tiles"
        )

    def test_positions_that_are_no_numbers_or_too_far_away(self, tmp_path):
        for number in ("nan", "inf", "1e300"):
            self.refuse(
                write_asc(tmp_path / "map.asc", terrain(), f"xllcorner {number}\nyllcorner 0\ncellsize 30\n"), "too far away for its cells"
            )
        self.refuse(write_asc(tmp_path / "map.asc", terrain(), "cellsize nan\n"), "has cells of size nan; the size must be positive")
        (tmp_path / "map.asc").write_text("ncols nan\nnrows 2\ncellsize 1\n1 2 3 4\n")
        self.refuse(tmp_path / "map.asc", "declares an impossible size")

    def test_a_wrong_byte_anywhere_is_a_sentence_at_worst(self, tmp_path):
        generator = np.random.default_rng(8)
        for name, path in all_formats(tmp_path).items():
            content = path.read_bytes()
            header = 200 if path.suffix in {".npy", ".asc"} else 0
            positions = [*generator.integers(0, header or len(content), 40), *range(len(content) - 250, len(content), 5)]
            for position in positions:
                changed = bytearray(content)
                changed[position] ^= int(generator.integers(1, 256))
                (tmp_path / f"changed{path.suffix}").write_bytes(changed)
                try:
                    field = open_field([tmp_path / f"changed{path.suffix}"])
                    heights = field.read(slice(0, 2), slice(0, 2))
                    assert heights.shape == (2, 2), name
                except FarfieldError as error:
                    assert str(error).endswith(".")

    def test_settings(self, tmp_path):
        with pytest.raises(SettingsError, match="at least one elevation model; set Sources"):
            open_field([])
        for name in ("cell_size", "image_height"):
            for value in (0.0, -1.0, np.nan, np.inf):
                with pytest.raises(SettingsError, match="must be positive and finite") as raised:
                    open_field([tmp_path], FieldSettings(**{name: value}))
                assert raised.value.settings == (name,)


@pytest.mark.slow
def test_an_image_larger_than_the_cache_is_read_with_bounded_memory(tmp_path):
    values = np.random.default_rng(0).integers(0, 3000, (2048, 2048)).astype(np.int16)
    for path in (
        write_tiff(tmp_path / "map.tif", values, "deflate", 2, (128, 128), tags=map_tags((30.0, 30.0), CORNER)),
        write_tiff(tmp_path / "strips.tif", values, "deflate", 1, rows_per_strip=8, tags=map_tags((30.0, 30.0), CORNER)),
    ):
        tracemalloc.start()
        field = open_field([path], cache_bytes=1 << 20)
        for start in range(0, 2048, 256):
            assert np.array_equal(field.read(slice(start, start + 256), slice(0, 256)), values[::-1][start : start + 256, :256])
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 6 << 20, "a part of the image's 8 MB; 16 MB as heights"
