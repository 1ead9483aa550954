"""Small files cannot take all memory: sizes are checked before samples are read, and reading needs little more than the samples."""

import gzip
import subprocess
import sys
import tracemalloc
import warnings

import numpy as np
import pytest

from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import generators
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.height_maps import MAX_BYTES
from lib import environment
from terrain_files import nifti, patch_bytes, write_voxels

pytestmark = pytest.mark.core
SCRIPTS = environment.ROOT / "scripts"
SIDE = 256  # voxels
OVERHEAD_BYTES = 32 * 2**20  # temporary arrays of fixed size
COPIES = 2.2  # At most this many copies of the samples are in memory.


def write_samples(path):
    """Write 256^3 samples; return the bytes that the limit counts for each."""
    bytes_of_samples = np.random.default_rng(0).integers(0, 255, (1, SIDE, SIDE), np.uint8).repeat(SIDE, axis=0)
    if path.name.startswith("scaled"):
        content = nifti(bytes_of_samples, scale=0.5, offset=1.0)
        path.write_bytes(gzip.compress(content, 1) if path.suffix == ".gz" else content)
        return 4
    if path.suffix == ".tif":
        pytest.importorskip("tifffile").imwrite(path, bytes_of_samples.reshape(2048, -1))
        return 4
    dtype = np.dtype(path.stem)
    write_voxels(path, bytes_of_samples.astype(dtype))
    return dtype.itemsize


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["scaled.nii.gz", "gray.tif"]
    + [pytest.param(name, marks=pytest.mark.exhaustive) for name in ("scaled.nii", "uint8.nii", "float32.npy", "float64.npy")],
)
def test_reading_needs_little_more_memory_than_the_samples(tmp_path, name):
    counted = write_samples(tmp_path / name) * SIDE**3
    settings = ClipboxSettings(terrain="heights" if name == "gray.tif" else "volume", source=str(tmp_path / name))
    build_sampler(ClipboxSettings(terrain="volume", source=str(write_voxels(tmp_path / "warm_up.npy", np.eye(8)[None]))))
    tracemalloc.start()
    build_sampler(settings)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < COPIES * counted + OVERHEAD_BYTES


def test_scaled_bytes_count_as_the_floats_that_are_made_of_them(tmp_path):
    shape = (3, 1024, 1024, MAX_BYTES // 2**21)  # as bytes they would fit
    content = patch_bytes(nifti(np.ones((3, 3, 3), "u1"), scale=0.5), 40, "<4h", *shape)
    (tmp_path / "scaled.nii").write_bytes(content)
    with pytest.raises(FileError, match=r"needs 4.0 GiB of memory for its samples; the maximum is 2 GiB, so reduce its size"):
        read_file(tmp_path / "scaled.nii")


def test_bytes_count_as_the_heights_that_are_made_of_them(tmp_path):
    np.lib.format.open_memmap(tmp_path / "map.npy", "w+", np.uint8, (2**15, 2**15)).flush()  # a sparse file
    with pytest.raises(FileError, match=r"needs 4.0 GiB of memory for its samples"):
        read_file(tmp_path / "map.npy")


def test_a_header_that_a_file_cannot_hold_reserves_no_memory(tmp_path):
    content = patch_bytes(nifti(np.ones((3, 3, 3), "u1")), 40, "<4h", 3, 1000, 1000, 1000)
    (tmp_path / "false.nii.gz").write_bytes(gzip.compress(content))
    tracemalloc.start()
    with pytest.raises(FileError, match=r"is truncated: its .* bytes cannot contain 1,000,000,000 bytes of voxels"):
        read_file(tmp_path / "false.nii.gz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def test_absurd_sizes_are_a_short_sentence(tmp_path):
    name = f"skull_{'9' * 70}x{'9' * 70}x{'9' * 70}_float64.raw"
    (tmp_path / name).write_bytes(b"1")
    with pytest.raises(FileError, match=r"needs over 1,048,576 GiB of memory") as raised:
        read_file(tmp_path / name)
    assert len(str(raised.value)) < len(str(tmp_path / name)) + 120


def test_too_little_memory_beyond_the_reader_is_a_sentence(tmp_path, monkeypatch):
    def fail(*_):
        raise MemoryError

    np.save(tmp_path / "map.npy", np.eye(4))
    monkeypatch.setitem(generators.BUILDERS, "heights", fail)
    with pytest.raises(FileError, match=r'map\.npy" needs more memory than is available; reduce its size'):
        build_sampler(ClipboxSettings(terrain="heights", source=str(tmp_path / "map.npy")))


def test_damaged_floats_of_a_tiff_print_no_warning(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    colors = np.full((16, 16, 3), 3e38, np.float32)
    colors[0, 0] = np.nan, np.inf, -np.inf
    colors[8:] = 5.0
    tifffile.imwrite(tmp_path / "colors.tif", colors, photometric="rgb", metadata=None)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        heights = read_file(tmp_path / "colors.tif").heights
        function = build_sampler(ClipboxSettings(terrain="heights", source=str(tmp_path / "colors.tif"))).function
    assert (heights[0] == 5.0).all() and function is not None


@pytest.mark.slow
def test_damaged_tags_of_a_tiff_print_nothing(tmp_path):
    pytest.importorskip("tifffile").imwrite(tmp_path / "map.tif", np.ones((16, 16), np.float32), metadata=None)
    content = (tmp_path / "map.tif").read_bytes()
    (tmp_path / "map.tif").write_bytes(patch_bytes(content, 12, "<H", 77))  # no such type of tag
    code = f"""
import sys
sys.path.insert(0, {str(SCRIPTS)!r})
from lib import environment
environment.import_farfield()
from pathlib import Path
from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.errors import FileError
try:
    read_file(Path({str(tmp_path / "map.tif")!r}))
except FileError as error:
    print(error)
"""
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert outcome.stderr == "" and outcome.stdout.count("\n") == 1


@pytest.mark.parametrize("terrain", ["heights", "volume"])
def test_a_path_relative_to_an_unsaved_file_is_a_sentence(terrain):
    with pytest.raises(FileError, match=r'"//map\.npy" is relative to the \.blend file, which was never saved; save it'):
        build_sampler(ClipboxSettings(terrain=terrain, source="//map.npy"))
