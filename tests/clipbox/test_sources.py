"""Terrains that come from files: known shapes come out where they should, from every kind of file; what cannot be read is said."""

import dataclasses
import gzip
import sys
from pathlib import Path

import numpy as np
import pytest

import environment
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.sources import read
from farfield.addon.core.clipbox.terrains import terrain_of
from farfield.addon.core.errors import FileError, SettingsError
from source_files import FEET_KEYS, WGS84_KEYS, nifti, patched, write_block, write_geotiff, write_png

DEMS = sorted((environment.ROOT.parent / "shared" / "data" / "dem").glob("*.tif"))
METRES_A_DEGREE = 111_320.0


def heights_of(path: Path, grid: Grid, **settings) -> np.ndarray:
    """The ground (X, Y) that a file gives at the middles of a grid's columns."""
    made = ClipboxSettings(terrain="heights", source=str(path), **settings)
    found = terrain_of(made).function(grid) + grid.axes()[2]
    assert np.ptp(found, axis=2).max() < 1e-3, "the ground is where the density is 0"
    return found[:, :, 0]


def volume_of(path: Path, **settings):
    return terrain_of(ClipboxSettings(terrain="volume", source=str(path), **settings)).function


def flat(columns: int, rows: int, voxel: float = 1.0) -> Grid:
    """A few layers of voxels, centred on the origin like the files."""
    return Grid((-columns // 2, -rows // 2, -1), (columns, rows, 4), voxel)


def cone(side: int) -> np.ndarray:
    """A cone (side, side) from 0 at the rim to 1 in the middle."""
    across = np.arange(side) - (side - 1) / 2.0
    return np.maximum(0.0, 1.0 - np.hypot(across, across[:, None]) / (side / 2.0))


def ball(shape=(40, 44, 36), radius: float = 15.0) -> np.ndarray:
    """Bytes (X, Y, Z) that fall from 255 within a ball in the middle to 0 outside, over 8 voxels; 127.5 on its surface."""
    places = np.indices(shape).astype(np.float64)
    middle = (np.array(shape) - 1.0) / 2.0
    depth = radius - np.sqrt(((places - middle[:, None, None, None]) ** 2).sum(axis=0))
    return np.clip(127.5 + 255.0 / 8.0 * depth, 0.0, 255.0).astype(np.uint8)


class TestHeights:
    """A map of heights as a volume."""

    @pytest.mark.parametrize("voxel", [0.25, 1.0, 2.0, 8.0])
    def test_a_plane_is_a_plane_at_every_size_of_voxel(self, tmp_path, voxel):
        rows, columns = np.mgrid[0:128, 0:160]
        np.save(tmp_path / "plane.npy", 3.0 * columns - 2.0 * rows)  # row 0 in the north
        grid = flat(*((8, 8) if voxel > 4 else (40, 40)), voxel)
        x, y, _ = grid.axes()
        lowest = -2.0 * 127
        expected = 3.0 * (x + 79.5) - 2.0 * (63.5 - y) - lowest
        assert np.allclose(heights_of(tmp_path / "plane.npy", grid, source_size=160.0), expected[..., 0], atol=1e-3)

    def test_a_picture_reaches_from_black_to_its_height_and_grows_with_the_scale(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(tmp_path / "cone.tif", np.round(cone(64) * 65535).astype(np.uint16))
        found = heights_of(tmp_path / "cone.tif", flat(64, 64), source_size=64.0, source_height=30.0)
        assert np.allclose(found, 30.0 * cone(64), atol=1e-3)
        twice = heights_of(tmp_path / "cone.tif", flat(64, 64, 2.0), source_size=64.0, source_height=30.0, scale=2.0)
        assert np.allclose(twice, 60.0 * cone(64), atol=2e-3)

    @pytest.mark.parametrize("kind", [np.uint8, np.uint16])
    def test_a_png_gives_the_grey_that_it_stores(self, tmp_path, kind):
        pytest.importorskip("bpy")
        from farfield.addon.bridge import terrain_sources  # noqa: F401 - makes the core know pictures

        white = np.iinfo(kind).max
        rising = np.tile(np.linspace(0, white, 64).astype(kind), (32, 1))
        rising[:8] = 0  # a strip in the north
        path = write_png(tmp_path / "Höhen 樹.png", rising)
        found = heights_of(path, flat(64, 32), source_size=64.0, source_height=20.0)
        assert np.allclose(found, 20.0 * rising[::-1].T / white, atol=1e-4)

    def test_colours_count_with_their_mean_and_compression_changes_nothing(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        colours = np.random.default_rng(1).integers(0, 256, (24, 32, 3), np.uint8)
        tifffile.imwrite(tmp_path / "plain.tif", colours, photometric="rgb")
        tifffile.imwrite(tmp_path / "packed.tiff", colours, photometric="rgb", compression="zlib", predictor=True, tile=(16, 16))
        plain, packed = (read(tmp_path / name).heights for name in ("plain.tif", "packed.tiff"))
        assert np.allclose(plain, colours.mean(axis=2)[::-1] / 255.0, atol=1e-6)
        assert np.array_equal(plain, packed)

    def test_degrees_are_true_to_scale(self, tmp_path):
        pytest.importorskip("tifffile")
        across = METRES_A_DEGREE * np.cos(np.radians(60.0)) / 100.0  # metres a pixel of a hundredth of a degree
        elevations = np.tile(500.0 + across * np.arange(200, dtype=np.float32), (100, 1))  # rises at 45 degrees to the east
        path = write_geotiff(tmp_path / "slope.tif", elevations, (0.01, 0.01), (20.0, 60.5), WGS84_KEYS)
        grid = flat(64, 64)
        found = heights_of(path, grid, source_size=200.0)  # as wide as deep: half the metres to a degree, twice the degrees
        assert np.allclose(found, (grid.axis(0) + 99.5)[:, None], atol=1e-2)
        south_north = np.tile(METRES_A_DEGREE / 100.0 * np.arange(100, dtype=np.float32)[::-1, None], (1, 200))
        path = write_geotiff(tmp_path / "north.tif", south_north, (0.01, 0.01), (20.0, 60.5), WGS84_KEYS)
        found = heights_of(path, grid, source_size=200.0)
        assert np.allclose(found, (grid.axis(1) + 99.0)[None, :], atol=1e-2)

    @pytest.mark.parametrize(("keys", "metres"), [((), 1.0), (FEET_KEYS, 0.3048)])
    def test_units_of_a_projection_are_true_to_scale(self, tmp_path, keys, metres):
        pytest.importorskip("tifffile")
        elevations = np.tile(10.0 * metres * np.arange(100, dtype=np.float32), (100, 1))
        path = write_geotiff(tmp_path / "slope.tif", elevations, (10.0, 10.0), (4e5, 5e6), keys)
        grid = flat(40, 40)
        assert np.allclose(heights_of(path, grid, source_size=100.0), (grid.axis(0) + 49.5)[:, None], atol=1e-2)

    def test_whole_numbers_without_a_place_are_a_picture_and_with_one_elevations(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        steps = np.arange(60, dtype=np.uint16).reshape(6, 10)
        tifffile.imwrite(tmp_path / "picture.tif", steps)
        assert read(tmp_path / "picture.tif").pixel is None
        assert read(write_geotiff(tmp_path / "map.tif", steps, (30.0, 30.0), (0.0, 0.0))).pixel == (30.0, 30.0)
        tifffile.imwrite(tmp_path / "floats.tif", steps.astype(np.float32))
        assert read(tmp_path / "floats.tif").pixel == (1.0, 1.0)

    def test_beyond_the_border_the_edge_goes_on(self, tmp_path):
        np.save(tmp_path / "noise.npy", np.random.default_rng(3).random((16, 16)))
        inner, outer = flat(16, 16), flat(80, 80)
        found = heights_of(tmp_path / "noise.npy", inner, source_size=16.0)
        around = heights_of(tmp_path / "noise.npy", outer, source_size=16.0)
        assert np.allclose(around, np.pad(found, 32, mode="edge"), atol=1e-6)
        far = heights_of(tmp_path / "noise.npy", Grid((10**12, -(10**12), -1), (2, 2, 4), 1.0), source_size=16.0)
        assert np.allclose(far, found[-1, 0], atol=1e-3)

    def test_what_is_unknown_lies_as_low_as_the_lowest_that_is_known(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        known = np.arange(40, 104, dtype=np.float32).reshape(8, 8)
        whole = {"lowest.npy": known}
        for name, number, kind in (("nan.npy", np.nan, np.float32), ("far.npy", -3.4e38, np.float32), ("short.npy", -32768, np.int16)):
            whole[name] = known.astype(kind)
            whole[name][2, 3] = number
        whole["lowest.npy"][2, 3] = 40.0
        found = {}
        for name, values in whole.items():
            np.save(tmp_path / name, values)
            found[name] = heights_of(tmp_path / name, flat(8, 8), source_size=8.0)
        holed = known.astype(np.int16)
        holed[2, 3] = -9999
        tifffile.imwrite(tmp_path / "tag.tif", holed, extratags=[(42113, 2, 0, "-9999", True)], metadata=None)
        found["tag.tif"] = heights_of(tmp_path / "tag.tif", flat(8, 8), source_size=8.0)
        assert all(np.array_equal(each, found["lowest.npy"]) for each in found.values())
        assert found["lowest.npy"].min() == 0.0

    def test_coarse_voxels_see_the_mean_of_what_they_cover(self, tmp_path):
        np.save(tmp_path / "board.npy", 100.0 * (np.indices((256, 256)).sum(axis=0) % 2))
        found = heights_of(tmp_path / "board.npy", flat(16, 16, 8.0), source_size=256.0)
        assert np.allclose(found, 50.0)
        assert np.ptp(heights_of(tmp_path / "board.npy", flat(16, 16, 1.0), source_size=256.0)) == 100.0

    @pytest.mark.skipif(not DEMS, reason="the elevation models in ../shared/data/dem are missing")
    @pytest.mark.parametrize("path", DEMS, ids=lambda path: path.stem)
    def test_a_real_elevation_model(self, path):
        pytest.importorskip("tifffile")
        source = read(path)
        side = METRES_A_DEGREE / 1200.0
        assert source.heights.shape == (1201, 1201) and source.no_data == -32767
        assert source.pixel[1] == pytest.approx(side)
        assert source.pixel[0] == pytest.approx(side * np.cos(np.radians(int(path.stem[1:3]) + 0.5)), rel=1e-4)
        valid = source.heights[source.heights != -32767]
        size = 1201.0 * side  # scene units are metres then
        ground = heights_of(path, Grid((-300, -300, 0), (600, 600, 1), 200.0), source_size=size)
        assert ground.min() >= 0.0
        assert 0.9 * np.ptp(valid) < ground.max() <= np.ptp(valid)
        coarse = heights_of(path, Grid((-40, -60, 0), (80, 120, 1), 1000.0), source_size=size)
        fine = heights_of(path, Grid((-400, -600, 0), (800, 1200, 1), 100.0), source_size=size)
        assert np.abs(coarse - fine.reshape(80, 10, 120, 10).mean(axis=(1, 3))).mean() < 0.02 * np.ptp(valid)


class TestVolume:
    """A block of voxels."""

    @pytest.mark.parametrize("name", ["ball.npy", "ball.raw", "ball.nii", "ball.nii.gz"])
    def test_a_ball_is_a_ball_from_every_kind_of_file(self, tmp_path, name):
        densities = volume_of(write_block(tmp_path / name, ball()), source_size=88.0)  # 2 scene units a voxel
        grid = Grid((-50, -50, -10), (100, 100, 100), 1.0)
        found = densities(grid)
        x, y, z = grid.axes()
        depth = 30.0 - np.sqrt(x**2 + y**2 + (z - 36.0) ** 2)
        near = np.abs(depth) < 4.0
        assert np.abs(found - depth)[near].max() < 0.5
        assert np.abs(depth[(found > 0) != (depth > 0)]).max(initial=0.0) < 0.1
        assert (found[~near & (depth < 0)] < 0).all()

    def test_all_kinds_of_files_give_the_same(self, tmp_path):
        grid = Grid((-30, -30, -5), (60, 60, 60), 0.9)
        paths = [write_block(tmp_path / f"ball.{ending}", ball()) for ending in ("npy", "raw", "nii", "nii.gz")]
        found = [volume_of(path, source_size=44.0)(grid) for path in paths]
        assert all(np.array_equal(each, found[0]) for each in found)

    @pytest.mark.parametrize("order", ["<", ">"])
    @pytest.mark.parametrize("kind", ["u1", "i1", "i2", "u2", "i4", "u4", "f4", "f8"])
    def test_every_type_of_nifti_is_read(self, tmp_path, order, kind):
        values = np.random.default_rng(2).integers(0, 100, (3, 4, 5)).astype(kind)
        (tmp_path / "block.nii").write_bytes(nifti(values, order))
        assert np.array_equal(read(tmp_path / "block.nii").values, values)

    def test_a_nifti_is_scaled_as_its_header_says(self, tmp_path):
        values = np.arange(60, dtype=np.int16).reshape(3, 4, 5)
        (tmp_path / "block.nii").write_bytes(nifti(values, slope=0.5, shift=-7.0, sides=(1.0, 1.0, 2.5)))
        source = read(tmp_path / "block.nii")
        assert np.array_equal(source.values, values * 0.5 - 7.0)
        assert source.spacing == (1.0, 1.0, 2.5)
        # 3 by 4 by 12.5 voxels wide: the block is 12.5 high where its longest side is
        assert volume_of(tmp_path / "block.nii", source_size=12.5)(Grid((0, 0, 11), (1, 1, 3), 1.0)).ravel()[-1] < 0

    def test_axes_are_x_y_z_and_the_block_stands_on_the_ground(self, tmp_path):
        solid = np.ones((2, 4, 8), bool)
        np.save(tmp_path / "solid.npy", solid)
        found = volume_of(tmp_path / "solid.npy", source_size=8.0)(Grid((-3, -4, -2), (6, 8, 12), 1.0)) > 0
        assert np.array_equal(np.argwhere(found).min(axis=0) + (-3, -4, -2), (-1, -2, 0))
        assert np.array_equal(np.argwhere(found).max(axis=0) + (-3, -4, -2), (0, 1, 7))
        assert found.sum() == solid.sum()

    def test_the_threshold_lies_in_the_middle_and_what_is_no_number_is_empty(self, tmp_path):
        values = np.full((4, 4, 4), 10.0)
        values[2:] = 30.0
        np.save(tmp_path / "halves.npy", values)
        densities = volume_of(tmp_path / "halves.npy", source_size=4.0)
        assert densities(Grid((-2, 0, 1), (4, 1, 1), 1.0)).ravel() == pytest.approx([-1 / 3, -1 / 3, 1 / 3, 1 / 3])
        values[3] = np.nan
        np.save(tmp_path / "holed.npy", values)
        assert list(volume_of(tmp_path / "holed.npy", source_size=4.0)(Grid((-2, 0, 1), (4, 1, 1), 1.0)).ravel() > 0) == [0, 0, 1, 0]

    def test_around_the_block_there_is_nothing(self, tmp_path):
        densities = volume_of(write_block(tmp_path / "full.npy", np.ones((8, 8, 8), bool)), source_size=8.0)
        assert (densities(Grid((10**9, 0, 0), (4, 4, 4), 1.0)) < 0).all()
        around = densities(Grid((-8, -8, -4), (16, 16, 16), 1.0)) > 0
        assert around.sum() == 512

    def test_coarse_voxels_keep_the_share_that_is_solid(self, tmp_path):
        crumbs = np.random.default_rng(4).random((64, 64, 64)) < 0.9
        densities = volume_of(write_block(tmp_path / "crumbs.npy", crumbs), source_size=64.0)
        far = densities(Grid((-3, -3, 1), (6, 6, 6), 8.0))
        assert (far > 0).all(), "single holes cannot be seen from afar"
        assert np.ptp(far) < 0.2 * np.ptp(densities(Grid((-30, -30, 2), (60, 60, 60), 1.0)))

    def test_an_openvdb_volume_and_a_level_set(self, tmp_path):
        pytest.importorskip("bpy")
        from farfield.addon.bridge import terrain_sources

        openvdb = terrain_sources._openvdb(tmp_path)
        fog, sphere = openvdb.FloatGrid(), openvdb.createLevelSetSphere(radius=20.0, voxelSize=1.0)
        box = np.zeros((10, 12, 14), np.float32)
        box[1:9, 1:11, 1:13] = 2.0
        fog.copyFromArray(box, ijk=(-50, 3, 7))
        openvdb.write(str(tmp_path / "fog.vdb"), [fog])
        openvdb.write(str(tmp_path / "sphere.vdb"), [sphere])
        found = volume_of(tmp_path / "fog.vdb", source_size=12.0)(Grid((-6, -6, 0), (12, 12, 12), 1.0)) > 0
        assert found.sum() == 8 * 10 * 12
        densities = volume_of(tmp_path / "sphere.vdb", source_size=float(read(tmp_path / "sphere.vdb").values.shape[0]))
        upwards = densities(Grid((0, 0, 0), (1, 1, 45), 1.0)).ravel()
        assert (upwards > 0).sum() == pytest.approx(40, abs=1)


def terrains_of_files(folder: Path) -> dict[str, ClipboxSettings]:
    np.save(folder / "hills.npy", np.random.default_rng(5).random((90, 70)) * 9.0)
    block = write_block(folder / "block.raw", ball((33, 21, 27), 9.0))
    np.save(folder / "real.npy", np.random.default_rng(6).normal(size=(33, 21, 27)))
    return {
        "heights": ClipboxSettings(terrain="heights", source=str(folder / "hills.npy"), source_size=70.0),
        "bytes": ClipboxSettings(terrain="volume", source=str(block), source_size=50.0),
        "reals": ClipboxSettings(terrain="volume", source=str(folder / "real.npy"), source_size=50.0, scale=1.3),
        "forest": ClipboxSettings(terrain="forest", source=str(block), source_size=25.0, forest_hills=6.0),
    }


@pytest.mark.parametrize("voxel", [0.3, 1.0, 3.7, 16.0])
@pytest.mark.parametrize("name", ["heights", "bytes", "reals", "forest"])
def test_a_voxel_does_not_know_the_grid_that_it_is_part_of(tmp_path, name, voxel):
    function = terrain_of(terrains_of_files(tmp_path)[name]).function
    whole = function(Grid((-17, -20, -6), (40, 37, 33), voxel))
    generator = np.random.default_rng(7)
    for _ in range(20):
        low = generator.integers(0, whole.shape)
        high = np.minimum(low + generator.integers(1, 20, 3), whole.shape)
        origin = tuple((low + (-17, -20, -6)).tolist())
        part = function(Grid(origin, tuple((high - low).tolist()), voxel))
        assert np.array_equal(part, whole[tuple(slice(a, b) for a, b in zip(low, high, strict=True))])
        assert part.dtype == np.float32


def test_all_are_among_the_terrains_that_settings_offer():
    choices = next(field.metadata["choices"] for field in dataclasses.fields(ClipboxSettings) if field.name == "terrain")
    assert {"heights", "volume", "forest"} <= set(choices)


class TestRefusals:
    """One sentence for everything that cannot be read."""

    @pytest.mark.parametrize(
        ("name", "content", "sentence"),
        [
            ("missing.npy", None, 'There is no file ".*missing.npy"; choose'),
            ("notes.txt", b"hello", "its name must end in one of .*.nii.gz, .*.npy"),
            ("empty.nii", b"", 'The file ".*empty.nii" is empty'),
            ("short.npy", b"\x93NUMPY\x01\x00v\x00{'descr'", "cannot be read as a NumPy array"),
            ("pickle.npy", np.array([{}, {}], object), "holds no plain numbers"),
            ("line.npy", np.arange(5.0), "an array with 1 axes; heights have 2, voxels 3"),
            ("complex.npy", np.ones((4, 4), complex), "samples of the type complex128"),
            ("nothing.npy", np.full((4, 4), np.nan), "holds no height anywhere"),
            ("flat.npy", np.ones((4, 4, 4)), "the same value everywhere, 1"),
            ("nothing3.npy", np.full((4, 4, 4), np.nan), "holds no number anywhere"),
            ("empty.npy", np.ones((0, 4, 4)), "cannot be read|holds no samples"),
            ("skull.raw", b"12345678", 'must tell its shape and type, as in "skull_256x256x178_uint8.raw"'),
            ("skull_2x2x3_uint8.raw", b"12345678", "holds 8 bytes; after its name it must be 12"),
            ("skull_9999x9999x9999_uint16.raw", b"12345678", "1862.1 GiB of samples, more than 2 GiB"),
            ("skull_0x2x3_uint8.raw", b"12345678", "holds no samples"),
            ("text.nii", b"hello" * 100, "does not begin as a NIfTI-1 file"),
            ("text.nii.gz", b"hello" * 100, "is not a whole gzip file"),
            ("cut.nii.gz", gzip.compress(nifti(np.ones((9, 9, 9), "f8")), mtime=0)[:-20], "is not a whole gzip file"),
            ("cut.nii", nifti(np.ones((3, 3, 3), "u1"))[:-1], "is cut short: it holds 26 bytes of voxels, not 27"),
            ("type.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 70, "<h", 32), "voxels of NIfTI type 32"),
            ("series.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 40, "<5h", 4, 3, 3, 3, 5), "holds a series of blocks"),
            ("shape.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 40, "<2h", 3, -3), "broken header: its voxels have no shape"),
            ("begin.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 108, "<f", np.nan), "its voxels would begin at byte nan"),
            ("pair.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 344, "4s", b"ni1"), "does not begin as a NIfTI-1 file"),
            ("large.nii", patched(nifti(np.ones((3, 3, 3), "u1")), 40, "<4h", 3, 9999, 9999, 9999), "931.0 GiB of samples, more than"),
            ("text.tif", b"hello" * 100, "cannot be read as a TIFF"),
        ],
        ids=lambda value: value if isinstance(value, str) else type(value).__name__,  # the same in every process
    )
    def test_bad_files(self, tmp_path, name, content, sentence):
        path = tmp_path / name
        if isinstance(content, np.ndarray):
            np.save(path, content)
        elif content is not None:
            path.write_bytes(content)
        terrain = "volume" if path.suffix in {".raw", ".nii", ".gz"} or name in {"flat.npy", "nothing3.npy", "empty.npy"} else "heights"
        with pytest.raises(FileError, match=sentence) as raised:
            terrain_of(ClipboxSettings(terrain=terrain, source=str(path)))
        assert str(raised.value).endswith(".") and str(path) in str(raised.value)

    def test_no_file(self):
        with pytest.raises(SettingsError, match="choose one with --source"):
            terrain_of(ClipboxSettings(terrain="heights"))

    def test_a_folder(self, tmp_path):
        (tmp_path / "folder.npy").mkdir()
        with pytest.raises(FileError, match="There is no file"):
            read(tmp_path / "folder.npy")

    def test_heights_are_no_voxels(self, tmp_path):
        np.save(tmp_path / "map.npy", np.eye(4))
        np.save(tmp_path / "block.npy", np.ones((4, 4, 4), bool))
        with pytest.raises(FileError, match='holds heights, not voxels; choose the terrain "heights"'):
            terrain_of(ClipboxSettings(terrain="volume", source=str(tmp_path / "map.npy")))
        with pytest.raises(FileError, match='holds voxels, not heights; choose the terrain "volume"'):
            terrain_of(ClipboxSettings(terrain="heights", source=str(tmp_path / "block.npy")))

    def test_a_tiff_without_its_library(self, tmp_path, monkeypatch):
        (tmp_path / "map.tif").write_bytes(b"II*\0")
        monkeypatch.setitem(sys.modules, "tifffile", None)
        with pytest.raises(FileError, match="needs the Python package tifffile, which is missing"):
            read(tmp_path / "map.tif")

    def test_tiffs_that_are_cut_short_or_compressed_in_an_unknown_way(self, tmp_path):
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(tmp_path / "map.tif", cone(64).astype(np.float32), metadata=None)
        whole = (tmp_path / "map.tif").read_bytes()
        (tmp_path / "cut.tif").write_bytes(whole[:-100])
        with pytest.raises(FileError, match="is cut short"):
            read(tmp_path / "cut.tif")
        of_compression = b"\x03\x01\x03\x00\x01\x00\x00\x00\x01\x00"  # tag 259, one short number, 1 for none
        assert whole.count(of_compression) == 1
        (tmp_path / "packed.tif").write_bytes(whole.replace(of_compression, of_compression[:-2] + b"\x51\xc3"))  # 50001, WebP
        with pytest.raises(FileError, match="save it without compression"):
            read(tmp_path / "packed.tif")

    def test_a_picture_or_volume_that_blender_cannot_read(self, tmp_path):
        bpy = pytest.importorskip("bpy")
        from farfield.addon.bridge import terrain_sources  # noqa: F401 - makes the core know them

        before = len(bpy.data.images)
        for name, sentence in (("text.png", "cannot be read as a picture"), ("text.vdb", "cannot be read: not a VDB file")):
            (tmp_path / name).write_bytes(b"hello")
            with pytest.raises(FileError, match=sentence):
                read(tmp_path / name)
        assert len(bpy.data.images) == before
