"""Terrains from files: known shapes have the right position and size for every file type, and unreadable files give error messages."""

import dataclasses
import gzip
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.clipbox.files import readers
from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.errors import FileError, SettingsError
from lib import environment
from terrain_files import FEET_KEYS, WGS84_KEYS, nifti, patch_bytes, write_geotiff, write_png, write_voxels

try:
    import bpy

    from farfield.addon.bridge.clipbox import sources
except ImportError:
    bpy = sources = None

READERS = readers.READERS if sources is None else sources.READERS
DEMS = sorted((environment.ROOT.parent / "shared" / "data" / "dem").glob("*.tif"))
METERS_PER_DEGREE = 111_320.0


def heights_of(path: Path, grid: Grid, **settings) -> np.ndarray:
    """The heights (X, Y) of the ground at the centers of a grid's columns."""
    terrain = ClipboxSettings(terrain="heights", source=str(path), **settings)
    heights = build_sampler(terrain, READERS).function(grid) + grid.coordinates()[2]
    assert np.ptp(heights, axis=2).max() < 1e-3, "the density is the height above the ground"
    return heights[:, :, 0]


def volume_of(path: Path, **settings):
    return build_sampler(ClipboxSettings(terrain="volume", source=str(path), **settings), READERS).function


def flat(columns: int, rows: int, voxel_size: float = 1.0) -> Grid:
    """A few layers of voxels, centered on the origin like the files."""
    return Grid((-columns // 2, -rows // 2, -1), (columns, rows, 4), voxel_size)


def cone(side: int) -> np.ndarray:
    """A cone (side, side) from 0 at the edge to 1 in the center."""
    offsets = np.arange(side) - (side - 1) / 2.0
    return np.maximum(0.0, 1.0 - np.hypot(offsets, offsets[:, None]) / (side / 2.0))


def ball(shape=(40, 44, 36), radius: float = 15.0) -> np.ndarray:
    """Bytes (X, Y, Z) that fall from 255 inside a centered ball to 0 outside, over 8 voxels; 127.5 on its surface."""
    voxels = np.indices(shape).astype(np.float64)
    center = (np.array(shape) - 1.0) / 2.0
    depth = radius - np.sqrt(((voxels - center[:, None, None, None]) ** 2).sum(axis=0))
    return np.clip(127.5 + 255.0 / 8.0 * depth, 0.0, 255.0).astype(np.uint8)


class TestHeights:
    """Height maps as volumes."""

    @pytest.mark.parametrize("voxel_size", [0.25, 1.0, 2.0, 8.0])
    def test_a_plane_is_a_plane_at_every_voxel_size(self, tmp_path, voxel_size):
        rows, columns = np.mgrid[0:128, 0:160]
        np.save(tmp_path / "plane.npy", 3.0 * columns - 2.0 * rows)  # row 0 in the north
        grid = flat(*((8, 8) if voxel_size > 4 else (40, 40)), voxel_size)
        x, y, _ = grid.coordinates()
        lowest = -2.0 * 127
        expected = 3.0 * (x + 79.5) - 2.0 * (63.5 - y) - lowest
        assert np.allclose(heights_of(tmp_path / "plane.npy", grid, source_size=160.0), expected[..., 0], atol=1e-3)

    def test_an_image_spans_the_source_height_times_the_scale(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(tmp_path / "cone.tif", np.round(cone(64) * 65535).astype(np.uint16))
        heights = heights_of(tmp_path / "cone.tif", flat(64, 64), source_size=64.0, source_height=30.0)
        assert np.allclose(heights, 30.0 * cone(64), atol=1e-3)
        twice = heights_of(tmp_path / "cone.tif", flat(64, 64, 2.0), source_size=64.0, source_height=30.0, scale=2.0)
        assert np.allclose(twice, 60.0 * cone(64), atol=2e-3)

    @pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
    @pytest.mark.skipif(bpy is None, reason="Blender reads images")
    def test_a_png_gives_its_gray_values(self, tmp_path, dtype):
        white = np.iinfo(dtype).max
        gradient = np.tile(np.linspace(0, white, 64).astype(dtype), (32, 1))
        gradient[:8] = 0  # a strip in the north
        path = write_png(tmp_path / "Höhen 樹.png", gradient)
        heights = heights_of(path, flat(64, 32), source_size=64.0, source_height=20.0)
        assert np.allclose(heights, 20.0 * gradient[::-1].T / white, atol=1e-4)

    def test_the_mean_of_colors_is_used_and_compression_changes_nothing(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        colors = np.random.default_rng(1).integers(0, 256, (24, 32, 3), np.uint8)
        tifffile.imwrite(tmp_path / "plain.tif", colors, photometric="rgb")
        tifffile.imwrite(tmp_path / "packed.tiff", colors, photometric="rgb", compression="zlib", predictor=True, tile=(16, 16))
        plain, packed = (read_file(tmp_path / name).heights for name in ("plain.tif", "packed.tiff"))
        assert np.allclose(plain, colors.mean(axis=2)[::-1] / 255.0, atol=1e-6)
        assert np.array_equal(plain, packed)

    def test_degrees_are_true_to_scale(self, tmp_path):
        pytest.importorskip("tifffile")
        pixel_width = METERS_PER_DEGREE * np.cos(np.radians(60.0)) / 100.0  # meters per pixel of a hundredth of a degree
        elevations = np.tile(500.0 + pixel_width * np.arange(200, dtype=np.float32), (100, 1))  # a slope of 45 degrees to the east
        path = write_geotiff(tmp_path / "slope.tif", elevations, (0.01, 0.01), (20.0, 60.5), WGS84_KEYS)
        grid = flat(64, 64)
        heights = heights_of(path, grid, source_size=200.0)  # as wide as deep: half the meters per degree, twice the degrees
        assert np.allclose(heights, (grid.coordinates_along(0) + 99.5)[:, None], atol=1e-2)
        south_north = np.tile(METERS_PER_DEGREE / 100.0 * np.arange(100, dtype=np.float32)[::-1, None], (1, 200))
        path = write_geotiff(tmp_path / "north.tif", south_north, (0.01, 0.01), (20.0, 60.5), WGS84_KEYS)
        heights = heights_of(path, grid, source_size=200.0)
        assert np.allclose(heights, (grid.coordinates_along(1) + 99.0)[None, :], atol=1e-2)

    @pytest.mark.parametrize(("keys", "meters"), [((), 1.0), (FEET_KEYS, 0.3048)])
    def test_units_of_a_projection_are_true_to_scale(self, tmp_path, keys, meters):
        pytest.importorskip("tifffile")
        elevations = np.tile(10.0 * meters * np.arange(100, dtype=np.float32), (100, 1))
        path = write_geotiff(tmp_path / "slope.tif", elevations, (10.0, 10.0), (4e5, 5e6), keys)
        grid = flat(40, 40)
        assert np.allclose(heights_of(path, grid, source_size=100.0), (grid.coordinates_along(0) + 49.5)[:, None], atol=1e-2)

    def test_integers_are_an_image_without_geotiff_tags_and_elevations_with_them(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        steps = np.arange(60, dtype=np.uint16).reshape(6, 10)
        tifffile.imwrite(tmp_path / "picture.tif", steps)
        assert read_file(tmp_path / "picture.tif").pixel_size is None
        assert read_file(write_geotiff(tmp_path / "map.tif", steps, (30.0, 30.0), (0.0, 0.0))).pixel_size == (30.0, 30.0)
        tifffile.imwrite(tmp_path / "floats.tif", steps.astype(np.float32))
        assert read_file(tmp_path / "floats.tif").pixel_size == (1.0, 1.0)

    def test_the_edge_continues_outside_the_map(self, tmp_path):
        np.save(tmp_path / "noise.npy", np.random.default_rng(3).random((16, 16)))
        inner, outer = flat(16, 16), flat(80, 80)
        heights = heights_of(tmp_path / "noise.npy", inner, source_size=16.0)
        around = heights_of(tmp_path / "noise.npy", outer, source_size=16.0)
        assert np.allclose(around, np.pad(heights, 32, mode="edge"), atol=1e-6)
        far = heights_of(tmp_path / "noise.npy", Grid((10**12, -(10**12), -1), (2, 2, 4), 1.0), source_size=16.0)
        assert np.allclose(far, heights[-1, 0], atol=1e-3)

    def test_missing_heights_are_replaced_by_the_lowest_one(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        known = np.arange(40, 104, dtype=np.float32).reshape(8, 8)
        maps = {"lowest.npy": known}
        for name, number, dtype in (("nan.npy", np.nan, np.float32), ("far.npy", -3.4e38, np.float32), ("short.npy", -32768, np.int16)):
            maps[name] = known.astype(dtype)
            maps[name][2, 3] = number
        maps["lowest.npy"][2, 3] = 40.0
        results = {}
        for name, values in maps.items():
            np.save(tmp_path / name, values)
            results[name] = heights_of(tmp_path / name, flat(8, 8), source_size=8.0)
        with_hole = known.astype(np.int16)
        with_hole[2, 3] = -9999
        tifffile.imwrite(tmp_path / "tag.tif", with_hole, extratags=[(42113, 2, 0, "-9999", True)], metadata=None)
        results["tag.tif"] = heights_of(tmp_path / "tag.tif", flat(8, 8), source_size=8.0)
        assert all(np.array_equal(heights, results["lowest.npy"]) for heights in results.values())
        assert results["lowest.npy"].min() == 0.0

    def test_coarse_voxels_use_the_mean_of_their_pixels(self, tmp_path):
        np.save(tmp_path / "board.npy", 100.0 * (np.indices((256, 256)).sum(axis=0) % 2))
        heights = heights_of(tmp_path / "board.npy", flat(16, 16, 8.0), source_size=256.0)
        assert np.allclose(heights, 50.0)
        assert np.ptp(heights_of(tmp_path / "board.npy", flat(16, 16, 1.0), source_size=256.0)) == 100.0

    @pytest.mark.skipif(not DEMS, reason="the elevation models in ../shared/data/dem are missing")
    @pytest.mark.parametrize("path", DEMS, ids=lambda path: path.stem)
    def test_a_real_elevation_model(self, path):
        pytest.importorskip("tifffile")
        source = read_file(path)
        side = METERS_PER_DEGREE / 1200.0
        assert source.heights.shape == (1201, 1201) and source.warnings == ()
        assert source.pixel_size[1] == pytest.approx(side)
        assert source.pixel_size[0] == pytest.approx(side * np.cos(np.radians(int(path.stem[1:3]) + 0.5)), rel=1e-4)
        valid = source.heights[np.isfinite(source.heights)]
        assert valid.min() > -500.0
        size = 1201.0 * side  # so that scene units are meters
        ground = heights_of(path, Grid((-300, -300, 0), (600, 600, 1), 200.0), source_size=size)
        assert ground.min() >= 0.0
        assert 0.9 * np.ptp(valid) < ground.max() <= np.ptp(valid)
        coarse = heights_of(path, Grid((-40, -60, 0), (80, 120, 1), 1000.0), source_size=size)
        fine = heights_of(path, Grid((-400, -600, 0), (800, 1200, 1), 100.0), source_size=size)
        assert np.abs(coarse - fine.reshape(80, 10, 120, 10).mean(axis=(1, 3))).mean() < 0.02 * np.ptp(valid)


class TestVolume:
    """Voxel models."""

    @pytest.mark.parametrize("name", ["ball.npy", "ball.raw", "ball.nii", "ball.nii.gz"])
    def test_a_ball_is_a_ball_from_every_file_type(self, tmp_path, name):
        densities = volume_of(write_voxels(tmp_path / name, ball()), source_size=88.0)  # 2 scene units per voxel
        grid = Grid((-50, -50, -10), (100, 100, 100), 1.0)
        values = densities(grid)
        x, y, z = grid.coordinates()
        depth = 30.0 - np.sqrt(x**2 + y**2 + (z - 36.0) ** 2)
        near = np.abs(depth) < 4.0
        assert np.abs(values - depth)[near].max() < 0.5
        assert np.abs(depth[(values > 0) != (depth > 0)]).max(initial=0.0) < 0.1
        assert (values[~near & (depth < 0)] < 0).all()

    def test_all_file_types_give_the_same_densities(self, tmp_path):
        grid = Grid((-30, -30, -5), (60, 60, 60), 0.9)
        paths = [write_voxels(tmp_path / f"ball.{ending}", ball()) for ending in ("npy", "raw", "nii", "nii.gz")]
        values = [volume_of(path, source_size=44.0)(grid) for path in paths]
        assert all(np.array_equal(densities, values[0]) for densities in values)

    @pytest.mark.parametrize("order", ["<", ">"])
    @pytest.mark.parametrize("dtype", ["u1", "i1", "i2", "u2", "i4", "u4", "f4", "f8"])
    def test_every_nifti_type_is_read(self, tmp_path, order, dtype):
        values = np.random.default_rng(2).integers(0, 100, (3, 4, 5)).astype(dtype)
        (tmp_path / "block.nii").write_bytes(nifti(values, order))
        assert np.array_equal(read_file(tmp_path / "block.nii").values, values)

    def test_nifti_values_are_scaled_as_the_header_declares(self, tmp_path):
        values = np.arange(60, dtype=np.int16).reshape(3, 4, 5)
        (tmp_path / "block.nii").write_bytes(nifti(values, scale=0.5, offset=-7.0, sizes=(1.0, 1.0, 2.5)))
        source = read_file(tmp_path / "block.nii")
        assert np.array_equal(source.values, values * 0.5 - 7.0)
        assert source.spacing == (1.0, 1.0, 2.5)
        # 3 by 4 by 12.5 voxels: the longest side of the model is its height, 12.5
        assert volume_of(tmp_path / "block.nii", source_size=12.5)(Grid((0, 0, 11), (1, 1, 3), 1.0)).ravel()[-1] < 0

    def test_axes_are_x_y_z_and_the_model_stands_on_the_ground(self, tmp_path):
        solid = np.ones((2, 4, 8), bool)
        np.save(tmp_path / "solid.npy", solid)
        is_solid = volume_of(tmp_path / "solid.npy", source_size=8.0)(Grid((-3, -4, -2), (6, 8, 12), 1.0)) > 0
        assert np.array_equal(np.argwhere(is_solid).min(axis=0) + (-3, -4, -2), (-1, -2, 0))
        assert np.array_equal(np.argwhere(is_solid).max(axis=0) + (-3, -4, -2), (0, 1, 7))
        assert is_solid.sum() == solid.sum()

    def test_the_threshold_is_the_mean_of_the_range_and_nan_is_empty(self, tmp_path):
        values = np.full((4, 4, 4), 10.0)
        values[2:] = 30.0
        np.save(tmp_path / "halves.npy", values)
        densities = volume_of(tmp_path / "halves.npy", source_size=4.0)
        assert densities(Grid((-2, 0, 1), (4, 1, 1), 1.0)).ravel() == pytest.approx([-1 / 3, -1 / 3, 1 / 3, 1 / 3])
        values[3] = np.nan
        np.save(tmp_path / "with_hole.npy", values)
        assert list(volume_of(tmp_path / "with_hole.npy", source_size=4.0)(Grid((-2, 0, 1), (4, 1, 1), 1.0)).ravel() > 0) == [0, 0, 1, 0]

    def test_the_surroundings_of_a_model_are_empty(self, tmp_path):
        densities = volume_of(write_voxels(tmp_path / "full.npy", np.ones((8, 8, 8), bool)), source_size=8.0)
        assert (densities(Grid((10**9, 0, 0), (4, 4, 4), 1.0)) < 0).all()
        around = densities(Grid((-8, -8, -4), (16, 16, 16), 1.0)) > 0
        assert around.sum() == 512

    def test_coarse_voxels_preserve_the_solid_fraction(self, tmp_path):
        crumbs = np.random.default_rng(4).random((64, 64, 64)) < 0.9
        densities = volume_of(write_voxels(tmp_path / "crumbs.npy", crumbs), source_size=64.0)
        far = densities(Grid((-3, -3, 1), (6, 6, 6), 8.0))
        assert (far > 0).all(), "single holes are too small to resolve"
        assert np.ptp(far) < 0.2 * np.ptp(densities(Grid((-30, -30, 2), (60, 60, 60), 1.0)))


def file_terrains(folder: Path) -> dict[str, ClipboxSettings]:
    np.save(folder / "hills.npy", np.random.default_rng(5).random((90, 70)) * 9.0)
    model = write_voxels(folder / "model.raw", ball((33, 21, 27), 9.0))
    np.save(folder / "real.npy", np.random.default_rng(6).normal(size=(33, 21, 27)))
    return {
        "heights": ClipboxSettings(terrain="heights", source=str(folder / "hills.npy"), source_size=70.0),
        "bytes": ClipboxSettings(terrain="volume", source=str(model), source_size=50.0),
        "reals": ClipboxSettings(terrain="volume", source=str(folder / "real.npy"), source_size=50.0, scale=1.3),
        "forest": ClipboxSettings(terrain="forest", source=str(model), plant_size=25.0, forest_hills=6.0),
    }


@pytest.mark.parametrize("voxel_size", [0.3, 1.0, 3.7, 16.0])
@pytest.mark.parametrize("name", ["heights", "bytes", "reals", "forest"])
def test_densities_do_not_depend_on_the_grid(tmp_path, name, voxel_size):
    function = build_sampler(file_terrains(tmp_path)[name]).function
    all_densities = function(Grid((-17, -20, -6), (40, 37, 33), voxel_size))
    generator = np.random.default_rng(7)
    for _ in range(20):
        low = generator.integers(0, all_densities.shape)
        high = np.minimum(low + generator.integers(1, 20, 3), all_densities.shape)
        origin = tuple((low + (-17, -20, -6)).tolist())
        part = function(Grid(origin, tuple((high - low).tolist()), voxel_size))
        assert np.array_equal(part, all_densities[tuple(slice(a, b) for a, b in zip(low, high, strict=True))])
        assert part.dtype == np.float32


def test_settings_offer_all_terrains_from_files():
    choices = next(field.metadata["choices"] for field in dataclasses.fields(ClipboxSettings) if field.name == "terrain")
    assert {"heights", "volume", "forest"} <= set(choices)


class TestErrors:
    """Error messages for unreadable files."""

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("missing.npy", None, 'The file ".*missing.npy" does not exist; check the path'),
            ("notes.txt", b"hello", "its name must end in one of .*.nii.gz, .*.npy"),
            ("empty.nii", b"", 'The file ".*empty.nii" is empty'),
            ("short.npy", b"\x93NUMPY\x01\x00v\x00{'descr'", "cannot be read as a NumPy array"),
            ("archive.npy", b"PK\x03\x04" + bytes(20), "cannot be read as a NumPy array"),
            ("pickle.npy", np.array([{}, {}], object), "not an array of numbers"),
            ("line.npy", np.arange(5.0), "an array with 1 axes; heights have 2, voxels 3"),
            ("complex.npy", np.ones((4, 4), complex), "samples of type complex128"),
            ("nothing.npy", np.full((4, 4), np.nan), "contains no valid height"),
            ("flat.npy", np.ones((4, 4, 4)), "the same value everywhere, 1"),
            ("nothing3.npy", np.full((4, 4, 4), np.nan), "contains no valid number"),
            ("empty.npy", np.ones((0, 4, 4)), "cannot be read|contains no samples"),
            ("skull.raw", b"12345678", 'must contain its shape and type, as in "skull_256x256x178_uint8.raw"'),
            ("skull_2x2x3_uint8.raw", b"12345678", "has 8 bytes; according to its name it must have 12"),
            ("skull_9999x9999x9999_uint16.raw", b"12345678", "needs 1,862.1 GiB of memory for its samples; the maximum is 2 GiB"),
            ("skull_0x2x3_uint8.raw", b"12345678", "contains no samples"),
            ("text.nii", b"hello" * 100, "is not a NIfTI-1 file"),
            ("text.nii.gz", b"hello" * 100, "is not a complete gzip file"),
            ("cut.nii.gz", gzip.compress(nifti(np.ones((9, 9, 9), "f8")), mtime=0)[:-20], "is not a complete gzip file"),
            ("cut.nii", nifti(np.ones((3, 3, 3), "u1"))[:-1], "is truncated: it contains 26 bytes of voxels instead of 27"),
            ("type.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 70, "<h", 32), "unsupported NIfTI type 32"),
            ("series.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 40, "<5h", 4, 3, 3, 3, 5), "contains a series of volumes"),
            ("shape.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 40, "<2h", 3, -3), "invalid header: its voxels have no shape"),
            ("begin.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 108, "<f", np.nan), "its voxels would begin at byte nan"),
            ("pair.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 344, "4s", b"ni1"), "is not a NIfTI-1 file"),
            ("large.nii", patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 40, "<4h", 3, 9999, 9999, 9999), "needs 931.0 GiB of memory"),
            ("text.tif", b"hello" * 100, "cannot be read as a TIFF file"),
        ],
        ids=lambda value: value if isinstance(value, str) else type(value).__name__,  # the same in every process
    )
    def test_bad_files(self, tmp_path, name, content, message):
        path = tmp_path / name
        if isinstance(content, np.ndarray):
            np.save(path, content)
        elif content is not None:
            path.write_bytes(content)
        terrain = "volume" if path.suffix in {".raw", ".nii", ".gz"} or name in {"flat.npy", "nothing3.npy", "empty.npy"} else "heights"
        with pytest.raises(FileError, match=message) as raised:
            build_sampler(ClipboxSettings(terrain=terrain, source=str(path)))
        assert str(raised.value).endswith(".") and str(path) in str(raised.value)

    def test_no_file(self):
        with pytest.raises(SettingsError, match="needs a file; set Source"):
            build_sampler(ClipboxSettings(terrain="heights"))

    def test_what_is_no_file_is_named(self, tmp_path):
        (tmp_path / "folder.npy").mkdir()
        with pytest.raises(FileError, match=r'folder.npy" is a folder; give the path of a file'):
            read_file(tmp_path / "folder.npy")
        if hasattr(os, "mkfifo"):
            os.mkfifo(tmp_path / "pipe.npy")
            with pytest.raises(FileError, match=r'pipe.npy" is a device or a pipe'):
                read_file(tmp_path / "pipe.npy")
        for name in ("\udcff.npy", "a\0.npy"):
            with pytest.raises(FileError, match="is not valid UTF-8 text"):
                build_sampler(ClipboxSettings(terrain="heights", source=str(tmp_path / name)))

    def test_heights_are_not_voxels(self, tmp_path):
        np.save(tmp_path / "map.npy", np.eye(4))
        np.save(tmp_path / "model.npy", np.ones((4, 4, 4), bool))
        with pytest.raises(FileError, match='contains heights, not voxels; use the terrain "heights"'):
            build_sampler(ClipboxSettings(terrain="volume", source=str(tmp_path / "map.npy")))
        with pytest.raises(FileError, match='contains voxels, not heights; use the terrain "volume"'):
            build_sampler(ClipboxSettings(terrain="heights", source=str(tmp_path / "model.npy")))

    def test_a_tiff_without_its_library(self, tmp_path, monkeypatch):
        (tmp_path / "map.tif").write_bytes(b"II*\0")
        monkeypatch.setitem(sys.modules, "tifffile", None)
        with pytest.raises(FileError, match="needs the Python package tifffile, which is missing"):
            read_file(tmp_path / "map.tif")

    def test_tiffs_that_are_truncated_or_have_an_unsupported_compression(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(tmp_path / "map.tif", cone(64).astype(np.float32), metadata=None)
        content = (tmp_path / "map.tif").read_bytes()
        (tmp_path / "cut.tif").write_bytes(content[:-100])
        with pytest.raises(FileError, match="is truncated"):
            read_file(tmp_path / "cut.tif")
        compression_tag = b"\x03\x01\x03\x00\x01\x00\x00\x00\x01\x00"  # tag 259, one short integer, 1 for none
        assert content.count(compression_tag) == 1
        (tmp_path / "packed.tif").write_bytes(content.replace(compression_tag, compression_tag[:-2] + b"\x51\xc3"))  # 50001, WebP
        with pytest.raises(FileError, match="save it with deflate"):
            read_file(tmp_path / "packed.tif")

    @pytest.mark.slow
    @pytest.mark.skipif(bpy is None, reason="Blender reads these files")
    def test_files_that_blender_cannot_read(self, tmp_path):
        before = len(bpy.data.images)
        for name, message in (("text.png", "cannot be read as an image"), ("text.vdb", "cannot be read: not a VDB file")):
            (tmp_path / name).write_bytes(b"hello")
            with pytest.raises(FileError, match=message):
                read_file(tmp_path / name, READERS)
        path = write_png(tmp_path / "huge.png", np.zeros((4, 4), np.uint8), declared=(30_000, 30_000))
        with pytest.raises(FileError, match=r'huge\.png" needs 13\.4 GiB of memory for its samples'):
            read_file(path, READERS)
        assert len(bpy.data.images) == before
