"""OpenVDB volumes: known shapes, and damaged files, which crash the library or fill the memory, end in one sentence."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.bridge.clipbox import openvdb_files, openvdb_worker
from farfield.addon.bridge.clipbox.sources import READERS
from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.errors import FileError

SIGSEGV = 11


@pytest.fixture(scope="module")
def openvdb():
    return openvdb_worker.import_openvdb(Path())


def write_fog(openvdb, path: Path) -> Path:
    fog, box = openvdb.FloatGrid(), np.zeros((10, 12, 14), np.float32)
    box[1:9, 1:11, 1:13] = 2.0
    fog.copyFromArray(box, ijk=(-50, 3, 7))
    openvdb.write(str(path), [fog])
    return path


def volume_of(path: Path, source_size: float):
    return build_sampler(ClipboxSettings(terrain="volume", source=str(path), source_size=source_size), READERS).function


@pytest.mark.slow
def test_a_volume_and_a_level_set(openvdb, tmp_path):
    sphere = openvdb.createLevelSetSphere(radius=20.0, voxelSize=1.0)
    openvdb.write(str(tmp_path / "Kugel 樹.vdb"), [sphere])
    solid = volume_of(write_fog(openvdb, tmp_path / "fog.vdb"), 12.0)(Grid((-6, -6, 0), (12, 12, 12), 1.0)) > 0
    assert solid.sum() == 8 * 10 * 12
    voxels = read_file(tmp_path / "Kugel 樹.vdb", READERS)
    settings = ClipboxSettings(terrain="volume", source=str(tmp_path / "fog.vdb"), source_size=float(voxels.values.shape[0]))
    upwards = build_sampler(settings, {".vdb": lambda _path: voxels}).function(Grid((0, 0, 0), (1, 1, 45), 1.0)).ravel()
    assert (upwards > 0).sum() == pytest.approx(40, abs=1)


def sentence_of(path: Path) -> str:
    with pytest.raises(FileError) as raised:
        read_file(path, READERS)
    return assert_is_sentence(raised.value, path)


def assert_is_sentence(error: FileError, path: Path) -> str:
    text = str(error)
    assert text.startswith(f'"{path}"') and text.endswith(".") and text.count("\n") == 0
    return text


@pytest.mark.slow
@pytest.mark.parametrize(
    "fraction", [pytest.param(0.05, marks=pytest.mark.exhaustive), 0.3, pytest.param(0.97, marks=pytest.mark.exhaustive)]
)
def test_truncated_files_are_one_sentence(openvdb, tmp_path, fraction):
    content = write_fog(openvdb, tmp_path / "fog.vdb").read_bytes()
    (tmp_path / "cut.vdb").write_bytes(content[: int(fraction * len(content))])
    assert sentence_of(tmp_path / "cut.vdb")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in (4, 5))])
def test_damaged_files_are_one_sentence(openvdb, tmp_path, monkeypatch, seed):
    monkeypatch.setattr(openvdb_files, "TIMEOUT_SECONDS", 20.0)  # in some files the library never finds the end
    damaged, generator = bytearray(write_fog(openvdb, tmp_path / "fog.vdb").read_bytes()), np.random.default_rng(seed)
    for position in generator.integers(60, len(damaged), 40):
        damaged[position] = generator.integers(0, 256)
    path = tmp_path / "damaged.vdb"
    path.write_bytes(damaged)
    try:
        read_file(path, READERS)  # some damage shows in the voxels only
    except FileError as error:
        assert_is_sentence(error, path)


@pytest.mark.parametrize("code", [-SIGSEGV, 1, 3221225477])
def test_a_crash_of_the_library_is_one_sentence(tmp_path, monkeypatch, code):
    (tmp_path / "any.vdb").write_bytes(b"any")
    monkeypatch.setattr(openvdb_files, "_run_worker", lambda *_: subprocess.CompletedProcess([], code, None, b"Segmentation fault\n"))
    assert "cannot be read as an OpenVDB file: it is damaged or has another format" in sentence_of(tmp_path / "any.vdb")


def test_a_file_that_takes_too_long_is_one_sentence(openvdb, tmp_path, monkeypatch):
    monkeypatch.setattr(openvdb_files, "TIMEOUT_SECONDS", 0.01)
    assert "was not read within 0.01 s" in sentence_of(write_fog(openvdb, tmp_path / "fog.vdb"))


@pytest.mark.slow
@pytest.mark.skipif(not openvdb_worker.MEMORY_USE.exists(), reason="only Linux limits the memory of a process")
def test_a_file_that_fills_the_memory_is_one_sentence(tmp_path, monkeypatch):
    """The worker runs as always, but what it reads would need 64 GiB."""
    (tmp_path / "any.vdb").write_bytes(b"any")
    command = openvdb_files.worker_command("addon.bridge.clipbox.openvdb_worker", [str(tmp_path / "any.vdb"), str(tmp_path)])
    start, module_arguments = command[1], command[2:]
    code = f"""
import runpy, sys, types
sys.argv = {[start, *module_arguments]!r}
import numpy as np
scope = runpy.run_path({start!r}, run_name="start")
openvdb = sys.modules["openvdb"] = types.ModuleType("openvdb")
openvdb.readAllGridMetadata = lambda path: np.ones(2**33).tolist()
scope["main"]()
"""
    monkeypatch.setattr(openvdb_files, "worker_command", lambda *_: [command[0], "-c", code])
    assert "is damaged, or needs more than 6 GiB of memory" in sentence_of(tmp_path / "any.vdb")


def test_a_path_that_is_not_utf_8_is_one_sentence(tmp_path):
    path = Path(str(tmp_path / "grid.vdb").replace("grid", "gr\udcffid"))
    try:
        path.write_bytes(b"any")
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    with pytest.raises(FileError, match="is not valid UTF-8"):
        read_file(path, READERS)
