"""Builds of large terrain: equal bytes however they run, resumption, holes, damage, and input that is refused."""

import json
import shutil
from collections import namedtuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import terrain_files
from farfield.addon.core.bdam.building import heights, simplified_diamonds
from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store import structure
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.errors import FarfieldError, FileError, SettingsError
from farfield.addon.core.jobs.progress import run_to_end
from tiff_writer import POINT_KEYS, map_tags, write_tiff

SIZE = 65
Usage = namedtuple("Usage", "total used free")


def heights_of(size=SIZE, holes=True, seed=3):
    """Rough heights (size, size) float32 in meters, row 0 in the north, with a hole and an unknown corner."""
    y, x = np.mgrid[0:size, 0:size] / size
    heights = 200.0 * np.sin(5.0 * x + 1.0) * np.cos(4.0 * y) + np.random.default_rng(seed).normal(0.0, 2.0, (size, size))
    if holes:
        heights[size // 3 : size // 2, size // 4 : size // 2] = np.nan
        heights[:5, :9] = np.nan
    return heights.astype(np.float32)


def write_source(folder, name="heights.npy", **options):
    path = folder / name
    np.save(path, heights_of(**options))
    return path


def write_image(folder, name="ground.tif", size=700):
    y, x = np.mgrid[0:size, 0:size]
    return write_tiff(folder / name, np.stack([x * 255 // size, y * 255 // size, (x + y) % 256], axis=-1).astype(np.uint8), tile=(64, 64))


def steps_of(sources, out, images=(), cell_size=10.0, **options):
    field = open_field(sources, FieldSettings(cell_size=cell_size))
    return build_terrain(field, sources, out, BdamSettings(**{"patch_size": "16", "executor": "serial"} | options), images)


def read_files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with a source, an image and the store of both; the files of the store; and the report of its build."""
    folder = tmp_path_factory.mktemp("höhen")
    source, image = write_source(folder), write_image(folder)
    report = run_to_end(steps_of([source], folder / "store", [image]))
    return folder, source, image, read_files(folder / "store"), report


@pytest.mark.slow
def test_processes_build_the_same_bytes(built, tmp_path):
    _, source, image, files, _ = built
    run_to_end(steps_of([source], tmp_path / "store", [image], executor="processes:2"))
    assert read_files(tmp_path / "store") == files
    assert [path.name for path in tmp_path.iterdir()] == ["store"]


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.8, *(pytest.param(fraction, marks=pytest.mark.exhaustive) for fraction in (0.02, 0.3, 0.55, 0.97))])
def test_a_cancelled_build_resumes_with_the_same_bytes(built, tmp_path, fraction):
    _, source, image, files, _ = built
    steps = steps_of([source], tmp_path / "store", [image])
    while next(steps).fraction < fraction:
        pass
    steps.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".store.farfield-build"]
    run_to_end(steps_of([source], tmp_path / "store", [image]))
    assert read_files(tmp_path / "store") == files
    assert [path.name for path in tmp_path.iterdir()] == ["store"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern", ["blocks-00-*.shard", pytest.param("blocks-*.shard", marks=pytest.mark.exhaustive), "patches-*.shard", "textures/*.tile"]
)
def test_damaged_parts_of_a_cancelled_build_are_made_again(built, tmp_path, pattern):
    _, source, image, files, _ = built
    steps, work = steps_of([source], tmp_path / "store", [image]), tmp_path / ".store.farfield-build"
    while not list(work.glob("blocks-00-*.shard")):
        next(steps)
    steps.close()
    random = np.random.default_rng(1)
    for path in sorted(work.glob(pattern)):
        content = bytearray(path.read_bytes())
        content[random.integers(len(content))] ^= 1
        path.write_bytes(content)
    run_to_end(steps_of([source], tmp_path / "store", [image]))
    assert read_files(tmp_path / "store") == files


@pytest.mark.slow
@pytest.mark.parametrize("change", ["source", "image", "settings"])
def test_the_work_folder_of_another_build_is_refused(tmp_path, change):
    source, image, options = write_source(tmp_path), write_image(tmp_path), {}
    steps = steps_of([source], tmp_path / "store", [image])
    while next(steps).fraction < 0.1:
        pass
    steps.close()
    if change == "source":
        write_source(tmp_path, seed=4)
    elif change == "image":
        write_image(tmp_path, size=650)
    else:
        options = {"texture_quality": 70}
    before = read_files(tmp_path / ".store.farfield-build")
    with pytest.raises(FileError, match="another terrain or with other settings"):
        run_to_end(steps_of([source], tmp_path / "store", [image], **options))
    assert read_files(tmp_path / ".store.farfield-build") == before and not (tmp_path / "store").exists()


@pytest.mark.slow
def test_a_store_does_not_depend_on_how_many_samples_are_measured_at_once(built, tmp_path, monkeypatch):
    _, source, image, files, _ = built
    monkeypatch.setattr(simplified_diamonds, "MAX_MEASURED_SAMPLES", 37)
    run_to_end(steps_of([source], tmp_path / "store", [image]))
    assert read_files(tmp_path / "store") == files


def test_the_report_describes_the_store(built):
    folder, _, image, files, report = built
    with TerrainStore(folder / "store") as store:
        assert report.patches == sum(len(level.indices) for level in store.levels)
        assert report.triangles == sum(int(level.counts[:, 1].sum()) for level in store.levels)
        assert report.tiles == len(store.textures) > 1
        assert report.origin == tuple(store.header.origin) and report.crs == store.header.crs
    assert report.bytes == sum(map(len, files.values())) and (report.rows, report.columns) == (SIZE, SIZE)
    assert report.holes == np.isnan(heights_of()).sum()
    assert (report.voids.filled, report.voids.left, report.voids.left_samples) == (1, 1, 45)
    assert report.describe_voids() == "1 void filled, 1 left of 0.0045 km²; Fill Holes can fill all."
    assert {"heights", "textures", "normals", "patches", "store"} == report.seconds.keys()
    assert any("has no position" in warning for warning in report.warnings) and image.exists()


def test_every_sample_of_the_source_is_in_the_finest_level(built):
    folder, _, _, _, _ = built
    heights, seen, is_hole = heights_of()[::-1], np.zeros((SIZE, SIZE), bool), np.zeros((SIZE, SIZE), bool)
    is_hole[-5:, :9] = True  # The other hole is small, and filled.
    with TerrainStore(folder / "store") as store:
        for row in range(len(store.levels[-1].indices)):
            patch = store.read(len(store.levels) - 1, row)
            is_known = np.isfinite(heights[patch.y, patch.x])
            seen[patch.y, patch.x] = True
            error = np.abs(patch.z * store.header.height_step - heights[patch.y, patch.x])[is_known]
            assert error.max(initial=0.0) <= 0.51 * store.header.height_step
            assert (patch.is_hole == is_hole[patch.y, patch.x][patch.triangles].all(axis=1)).all()
    assert seen.all()


@pytest.mark.parametrize(
    ("version", "message"), [(structure.OLDEST_VERSION - 1, "older Farfield"), (structure.VERSION + 1, "newer Farfield")]
)
def test_stores_of_other_versions_are_refused(built, tmp_path, monkeypatch, version, message):
    folder, _, _, _, _ = built
    shutil.copytree(folder / "store", tmp_path / "store")
    header, levels, _ = structure.read_structure(tmp_path / "store")
    (tmp_path / "store" / structure.STRUCTURE_FILE).unlink()
    with monkeypatch.context() as patched:
        patched.setattr(structure, "VERSION", version)
        structure.write_structure(tmp_path / "store", header, levels)
    with pytest.raises(FileError, match=f"{message}.*version {version}"):
        TerrainStore(tmp_path / "store")


def test_a_changed_byte_anywhere_is_found(built, tmp_path):
    folder, _, _, files, _ = built
    shutil.copytree(folder / "store", tmp_path / "store")
    random = np.random.default_rng(5)
    for name, content in files.items():
        path = tmp_path / "store" / name
        for position in [0, len(content) - 1, *random.integers(0, len(content), 12).tolist()]:
            damaged = bytearray(content)
            damaged[position] ^= 1 << int(random.integers(8))
            path.write_bytes(damaged)
            assert find_damage(tmp_path / "store"), f"{name}, byte {position}"
        path.write_bytes(content)
    assert not find_damage(tmp_path / "store")


def find_damage(folder):
    """Return what `verify` names, or the sentence with which the store is refused."""
    try:
        with TerrainStore(folder) as store:
            return list(store.verify())
    except FileError as error:
        return [str(error)]


def test_a_terrain_is_replaced(tmp_path):
    source = write_source(tmp_path, size=33)
    run_to_end(steps_of([source], tmp_path / "store"))
    (tmp_path / "store" / "structure.bdam").unlink()  # Its backup still says what the folder is.
    write_source(tmp_path, size=41)
    assert run_to_end(steps_of([source], tmp_path / "store")).rows == 41
    assert sorted(path.name for path in tmp_path.iterdir()) == ["heights.npy", "store"]
    with pytest.raises(FileError, match="is a file"):
        run_to_end(steps_of([source], source))


def test_a_disk_without_room_is_named_before_anything_is_written(tmp_path, monkeypatch):
    source = write_source(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9 - 5000, 5000))
    with pytest.raises(FileError, match=r"has 5 kB left, and the build needs about .* [kM]B there; free some space"):
        run_to_end(steps_of([source], tmp_path / "store"))
    assert [path.name for path in tmp_path.iterdir()] == ["heights.npy"]


def test_a_source_that_breaks_while_it_is_read_leaves_nothing(tmp_path):
    tags = map_tags((0.001, 0.001), (8.0, 47.0), POINT_KEYS)
    path = write_tiff(tmp_path / "dem.tif", heights_of(), compression="deflate", predictor=3, tile=(32, 32), tags=tags)
    content = bytearray(path.read_bytes())
    content[3000:3400] = bytes(400)
    path.write_bytes(content)
    with pytest.raises(FarfieldError, match="damaged"):
        run_to_end(steps_of([path], tmp_path / "store"))
    np.save(tmp_path / "unknown.npy", np.full((33, 33), np.nan, np.float32))
    with pytest.raises(FileError, match="no known height"):
        run_to_end(steps_of([tmp_path / "unknown.npy"], tmp_path / "store"))
    with pytest.raises(SettingsError, match="Height Step"):
        run_to_end(steps_of([write_source(tmp_path)], tmp_path / "store", height_step=1e-7))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dem.tif", "heights.npy", "unknown.npy"]


def test_an_image_that_cannot_be_read_leaves_nothing(tmp_path):
    """The next build has another image, and could not go on from here."""
    source, image = write_source(tmp_path, size=33), tmp_path / "ground.png"
    terrain_files.write_png(image, np.zeros((64, 64), np.uint8))
    image.write_bytes(image.read_bytes()[:-30])
    with pytest.raises(FileError, match="damaged or truncated"):
        run_to_end(steps_of([source], tmp_path / "store", [image]))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ground.png", "heights.npy"]


@pytest.mark.slow
def test_filled_holes_have_all_triangles_and_known_heights_stay(tmp_path):
    source = write_source(tmp_path)
    run_to_end(steps_of([source], tmp_path / "store", fill_holes="all", height_step=0.01))
    heights = heights_of()[::-1]
    with TerrainStore(tmp_path / "store") as store:
        for row in range(len(store.levels[-1].indices)):
            patch = store.read(len(store.levels) - 1, row)
            known = heights[patch.y, patch.x]
            assert not patch.is_hole.any()
            assert np.nanmax(np.append(np.abs(0.01 * patch.z - known), 0.0)) <= 0.0051
        assert store.height_range[0] >= np.nanmin(heights) - 0.01 and store.height_range[1] <= np.nanmax(heights) + 0.01


def write_grid(folder, steps, is_known):
    path = folder / "heights.raw"
    encode_heights(steps, is_known).astype("<i4").tofile(path)
    return HeightGrid(path, *steps.shape)


@settings(max_examples=25)
@given(st.integers(2, 50), st.integers(2, 50), st.integers(0, 2**31))
def test_filling_keeps_known_heights_stays_between_them_and_does_not_depend_on_bands(tmp_path_factory, rows, columns, seed):
    random = np.random.default_rng(seed)
    steps = random.integers(-1000, 1000, (rows, columns))
    is_known = random.random((rows, columns)) < random.choice([0.02, 0.5, 0.98])
    is_known[random.integers(rows), random.integers(columns)] = True
    results = []
    for band_samples in (heights.BAND_SAMPLES, 4 * columns):
        grid = write_grid(tmp_path_factory.mktemp("grid"), steps, is_known)
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(heights, "BAND_SAMPLES", band_samples)
            run_to_end(heights.fill_holes(grid))
        filled, all_known = grid.read(slice(0, rows), slice(0, columns))
        assert all_known.all() and (filled[is_known] == steps[is_known]).all()
        assert filled.min() >= steps[is_known].min() and filled.max() <= steps[is_known].max()
        assert [path.name for path in grid.path.parent.iterdir()] == ["heights.raw"]
        results.append(filled)
    assert (results[0] == results[1]).all()


def test_a_hole_in_a_plane_is_filled_by_nearly_the_plane(tmp_path):
    y, x = np.mgrid[0:200, 0:300]
    plane = 100 * x + 37 * y
    is_known = (np.abs(x - 150) > 40) | (np.abs(y - 90) > 25)
    grid = write_grid(tmp_path, plane, is_known)
    run_to_end(heights.fill_holes(grid))
    filled, _ = grid.read(slice(0, 200), slice(0, 300))
    assert np.abs(filled - plane).max() < 0.05 * np.ptp(plane[~is_known])
    edges = np.abs(np.diff(filled, axis=1)) - 100
    assert edges.max() < 100  # no step where the hole begins


def test_the_parameters_of_a_work_folder_are_plain_json(tmp_path):
    source, image = write_source(tmp_path), write_image(tmp_path)
    steps = steps_of([source], tmp_path / "store", [image])
    while next(steps).fraction < 0.5:
        pass
    steps.close()
    for name in ("parameters.json", "textures.json"):
        assert json.loads((tmp_path / ".store.farfield-build" / name).read_bytes()[32:])
