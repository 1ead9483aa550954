"""The packaged zip, not the checkout, is installed and enabled in Blender, in a folder with spaces and non-ASCII characters."""

import itertools
import json
import os
import re
import stat
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from lib import environment

pytest.importorskip("bpy")
pytestmark = pytest.mark.slow

CHILD = Path(__file__).with_name("in_blender.py")
MAX_BYTES = 55e6
MANIFEST = tomllib.loads((environment.ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("Wälder und Füße 樹")


@pytest.fixture(scope="module")
def archive(folder) -> Path:
    """The zip for this platform, as users get it."""
    import build_extension

    target = build_extension.running_platform()
    if target not in build_extension.PLATFORMS:
        pytest.skip(f"there is no zip for {target}")
    script = environment.ROOT / "scripts" / "build_extension.py"
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    command = [sys.executable, str(script), "--platform", target, "--python", python, "--out", str(folder / "dist")]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return folder / "dist" / f"farfield-{MANIFEST['version']}.zip"


@pytest.fixture(scope="module")
def resources(folder, archive) -> Path:
    """A separate Blender resource folder with the zip installed."""
    installed = folder / "Blender" / "extensions" / "user_default" / "farfield"
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(installed)
    return folder / "Blender"


@pytest.fixture(scope="module")
def results(folder, resources) -> dict:
    """The results of in_blender.py with the zip installed. A first run unpacks the wheels, because the second one must start with them."""
    wheels = resources / "extensions" / ".local" / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    variables = {**os.environ, "BLENDER_USER_RESOURCES": str(resources), "PYTHONPATH": str(wheels), "PYTHONUTF8": "1"}
    for arguments in (["unpack"], []):
        outcome = subprocess.run(
            [sys.executable, str(CHILD), *arguments],
            capture_output=True,
            encoding="utf-8",
            env=variables,
            cwd=folder,
            timeout=300,
            check=False,
        )
        assert outcome.returncode == 0, outcome.stderr + outcome.stdout
    lines = [line for line in outcome.stdout.splitlines() if line.startswith("RESULTS ")]
    assert lines, outcome.stdout + outcome.stderr
    return json.loads(lines[0].removeprefix("RESULTS "))


@pytest.mark.slow
def test_zip_contains_the_extension_and_nothing_else(archive):
    with zipfile.ZipFile(archive) as packed:
        names = packed.namelist()
    assert {name.split("/")[0] for name in names} == {"__init__.py", "LICENSE", "addon", "blender_manifest.toml", "manual", "wheels"}
    assert not [name for name in names if "__pycache__" in name or name.endswith((".pyc", ".blend1"))]


def test_every_folder_with_pictures_states_their_license(archive):
    with zipfile.ZipFile(archive) as packed:
        names = packed.namelist()
    pictures = [name for name in names if name.endswith((".png", ".webp", ".gif", ".jpg"))]
    licensed = tuple(name.removesuffix("LICENSE.txt") for name in names if name.endswith("/LICENSE.txt"))
    assert len(pictures) > 20 and all(name.startswith(licensed) for name in pictures)


def test_zip_contains_the_documentation_as_linked_html(resources):
    manual = resources / "extensions" / "user_default" / "farfield" / "manual"
    pages = sorted(manual.rglob("*.html"))
    assert {"billboards", "btf", "unwrap", "restore", "clipbox", "troubleshooting"} <= {page.stem for page in pages}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "<h1" in text and "| --- |" not in text
        for link in re.findall(r'(?:href|src)="([^"#]+)', text):
            assert "://" in link or (page.parent / link).exists(), f"{page.name}: {link}"


def test_zip_contains_the_wheels_of_its_python_but_not_numpy(archive):
    with zipfile.ZipFile(archive) as packed:
        manifest = tomllib.loads(packed.read("blender_manifest.toml").decode())
        wheels = {name for name in packed.namelist() if name.startswith("wheels/")}
    assert {name.removeprefix("./") for name in manifest["wheels"]} == wheels
    assert len(manifest["platforms"]) == 1
    bundled = {(name.split("/")[1].split("-")[0].lower(), name.split("-")[2]) for name in wheels}
    python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    binary_wheels = {(package, python) for package in ("scipy", "xatlas", "fast_simplification", "pillow")}
    stable = {("meshopt", "cp311" if python == "cp311" else "cp312"), ("threadpoolctl", "py3"), ("tifffile", "py3")}
    assert bundled == binary_wheels | stable
    assert archive.stat().st_size < MAX_BYTES


def test_zips_of_all_pythons_exclude_each_other_and_no_newer_blender():
    import build_extension

    text = (environment.ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    pythons = build_extension.BLENDER_VERSIONS
    wheels, holders = ["./wheels/a.whl"], ['2020 A "B" C']
    manifests = [tomllib.loads(build_extension.complete_manifest(text, "linux-x64", python, wheels, holders)) for python in pythons]
    limits = [(manifest["blender_version_min"], manifest.get("blender_version_max")) for manifest in manifests]
    assert limits == list(pythons.values()) and limits[0][0] == MANIFEST["blender_version_min"] and limits[-1][1] is None
    assert all(end == start for (_, end), (start, _) in itertools.pairwise(limits))
    assert all(manifest["wheels"] == ["./wheels/a.whl"] and manifest["platforms"] == ["linux-x64"] for manifest in manifests)
    assert all(manifest["copyright"] == [*MANIFEST["copyright"], *holders] for manifest in manifests)


def test_zip_names_the_copyright_holders_of_its_wheels_and_asks_for_no_network(archive):
    with zipfile.ZipFile(archive) as packed:
        manifest = tomllib.loads(packed.read("blender_manifest.toml").decode())
    holders = " ".join(manifest["copyright"])
    for name in ("Farfield", "SciPy", "OpenBLAS", "Markus Worchel", "PyVista", "threadpoolctl", "Gohlke", "Clark", "Kapoulkine"):
        assert name in holders
    assert set(manifest["permissions"]) == {"files"}


@pytest.mark.slow
def test_enabling_registers_the_tab_and_disabling_removes_everything(results):
    first, second = results["enabled"]
    assert first == second and first
    assert results["tabs"] == [["Farfield"], ["Farfield"]]
    assert results["disabled"] == [[], []]


def test_installed_extension_builds_a_cloud_with_its_own_wheels(results, resources):
    assert results["clouds"] == 1
    assert set(results["wheels"]) >= {"scipy", "threadpoolctl"}
    for path in results["wheels"].values():
        assert Path(path).is_relative_to(resources / "extensions" / ".local")


def test_workers_start_from_the_installed_extension(results):
    assert results["baked"] == ["Cube.001 Cloud L0 BTF"]


def test_workers_leave_the_wheels_of_the_running_blender_alone(results):
    before, after = results["wheel_folders"]
    assert "scipy" in before and after == before


def test_finished_views_lie_in_the_folder_that_blender_gives_to_the_extension(resources, results):
    (folder,) = (resources / "extensions" / ".user").rglob("farfield/btf")
    assert not any(folder.iterdir()), "the bake has ended"
    assert os.name == "nt" or stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_a_damaged_wheel_in_the_cache_is_not_used(tmp_path, monkeypatch):
    import build_extension

    monkeypatch.setattr(build_extension, "read_locked_wheels", lambda: {"scipy": {"0" * 64}})
    assert build_extension.cached_wheels(tmp_path) == []
    (tmp_path / "scipy-1.0-cp311-cp311-win_amd64.whl").write_bytes(b"half")
    assert build_extension.cached_wheels(tmp_path) == []
