"""The packaged zip, not the checkout, is installed and enabled in Blender, in a folder with spaces and non-ASCII letters."""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import environment

pytest.importorskip("bpy")
pytestmark = pytest.mark.slow

CHILD = Path(__file__).with_name("in_blender.py")
MANIFEST = tomllib.loads((environment.ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("Wälder und Füße 樹")


@pytest.fixture(scope="module")
def archive(folder) -> Path:
    """The zip for this machine, as a user gets it."""
    import build_extension

    target = build_extension.running_platform()
    if target not in build_extension.PLATFORMS:
        pytest.skip(f"there is no zip for {target}")
    script = environment.ROOT / "scripts" / "build_extension.py"
    command = [sys.executable, str(script), "--platform", target, "--out", str(folder / "dist")]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return folder / "dist" / f"farfield-{MANIFEST['version']}.zip"


@pytest.fixture(scope="module")
def resources(folder, archive) -> Path:
    """A Blender folder of its own with the zip installed in it."""
    installed = folder / "Blender" / "extensions" / "user_default" / "farfield"
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(installed)
    return folder / "Blender"


@pytest.fixture(scope="module")
def seen(folder, resources) -> dict:
    """What a Blender sees that has the zip installed. It runs twice: the first run unpacks the wheels, the second begins with them."""
    wheels = resources / "extensions" / ".local" / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    variables = {**os.environ, "BLENDER_USER_RESOURCES": str(resources), "PYTHONPATH": str(wheels), "PYTHONUTF8": "1"}
    for _ in range(2):
        outcome = subprocess.run(
            [sys.executable, str(CHILD)], capture_output=True, encoding="utf-8", env=variables, cwd=folder, timeout=300, check=False
        )
        assert outcome.returncode == 0, outcome.stderr + outcome.stdout
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("SEEN ")]
    assert lines, outcome.stdout + outcome.stderr
    return json.loads(lines[0].removeprefix("SEEN "))


def test_zip_holds_the_extension_and_nothing_else(archive):
    with zipfile.ZipFile(archive) as packed:
        names = packed.namelist()
    assert {name.split("/")[0] for name in names} == {"__init__.py", "LICENSE", "addon", "blender_manifest.toml", "wheels"}
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".blend1"))]


def test_zip_brings_the_wheels_of_both_pythons_and_never_numpy(archive):
    with zipfile.ZipFile(archive) as packed:
        manifest = tomllib.loads(packed.read("blender_manifest.toml").decode())
        wheels = {name for name in packed.namelist() if name.startswith("wheels/")}
    assert {name.removeprefix("./") for name in manifest["wheels"]} == wheels
    assert len(manifest["platforms"]) == 1
    brought = {(name.split("/")[1].split("-")[0].lower(), name.split("-")[2]) for name in wheels}
    of_a_python = {(package, python) for package in ("scipy", "xatlas", "fast_simplification") for python in ("cp311", "cp313")}
    assert brought == of_a_python | {("threadpoolctl", "py3"), ("tifffile", "py3")}


def test_enabling_registers_the_tab_and_disabling_takes_all_back(seen):
    first, second = seen["enabled"]
    assert first == second and first
    assert seen["tabs"] == [["Farfield"], ["Farfield"]]
    assert seen["disabled"] == [[], []]


def test_installed_extension_builds_a_cloud_with_the_wheels_it_brought(seen, resources):
    assert seen["clouds"] == 1
    assert set(seen["wheels"]) >= {"scipy", "threadpoolctl"}
    for path in seen["wheels"].values():
        assert Path(path).is_relative_to(resources / "extensions" / ".local")


def test_workers_start_from_the_installed_extension(seen):
    assert seen["baked"] == ["Cube.001 Cloud L0 BTF"]


def test_a_torn_wheel_in_the_cache_is_not_used(tmp_path, monkeypatch):
    import build_extension

    monkeypatch.setattr(build_extension, "locked_wheels", lambda: {"scipy": {"0" * 64}})
    assert build_extension.wheels_at_hand(tmp_path) == []
    (tmp_path / "scipy-1.0-cp311-cp311-win_amd64.whl").write_bytes(b"half")
    assert build_extension.wheels_at_hand(tmp_path) == []
