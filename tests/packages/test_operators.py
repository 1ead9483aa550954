"""Packages from objects in a scene and from files: what is written, what is refused, and that every damaged byte is found."""

import json
import shutil
import urllib.request
import webbrowser
from pathlib import Path

import bpy
import numpy as np
import pytest
from reference.mesh_decoding import decode_level, dequantize

import packages
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.packages.files import LEVELS_GLB, read_package, read_page
from farfield.addon.core.packages.manifest import MANIFEST, MESH, TEXTURES
from farfield.addon.core.packages.textures.coding import decode_textures
from farfield.addon.operators.file_browser import FOLDERS
from farfield.addon.operators.packages.operators import default_folder
from glb_reader import read_glb
from lib import command_line, scene_files
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "small_images", "few_samples")
SMALL = {"levels": "number", "number": 3, "views": 2, "max_image": 64, "pixels": 96, "tile_size": 32}
FLAGS = ("--number", "3", "--views", "2", "--max-image", "64", "--pixels", "96", "--tile-size", "32")


@pytest.fixture
def folder(tmp_path):
    """A folder that does not exist, whose path has spaces and non-ASCII letters."""
    return tmp_path / "été à la mer" / "ball"


def run(*arguments):
    return packages.main([str(argument) for argument in arguments], command_line.ProgressLine())


@pytest.fixture(scope="module")
def two_packages(extension, small_images, tmp_path_factory):
    """The folder with the packages of two equal scaled and moved balls, whose export has left the scene as it was."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for ball in (textured_ball(8, "Bäll/chen"), textured_ball(8, "Bäll:chen")):
        ball.scale, ball.location = (1.0, 2.0, 3.0), (7.0, 0.0, 0.0)
        ball.select_set(True)
    bpy.context.view_layer.update()
    before = len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.images)
    folder, mirrors = tmp_path_factory.mktemp("package") / "été à la mer", "https://example.org/a, http://example.org/b/"
    assert bpy.ops.farfield.packages_export(folder=str(folder), mirrors=mirrors, **SMALL) == {"FINISHED"}
    assert (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.images)) == before
    return folder


class TestView:
    """*View in Browser*."""

    @pytest.fixture(autouse=True)
    def opened(self, monkeypatch):
        """The addresses that browsers were asked to open."""
        urls = []
        monkeypatch.setattr(webbrowser, "open", urls.append)
        return urls

    @pytest.mark.slow
    def test_the_package_that_was_exported_last_is_served_until_the_next_one(self, folder, opened):
        ball = textured_ball(4, "Bäll")
        ball.select_set(True)
        with pytest.raises(RuntimeError, match="Export a package first"):
            bpy.ops.farfield.packages_view()
        assert bpy.ops.farfield.packages_export(folder=str(folder), **SMALL) == {"FINISHED"}
        for _ in range(2):
            assert bpy.ops.farfield.packages_view() == {"FINISHED"}
        with urllib.request.urlopen(opened[1] + "manifest.json") as response:
            assert json.load(response)["name"] == "Bäll"
        with pytest.raises(OSError):
            urllib.request.urlopen(opened[0])

    def test_a_package_that_is_gone_is_reported(self, tmp_path):
        bpy.context.scene.farfield_packages.exported = str(tmp_path / "gone")
        with pytest.raises(RuntimeError, match="gone"):
            bpy.ops.farfield.packages_view()


@pytest.fixture(scope="module")
def package(two_packages):
    """The folder of one of the packages."""
    return two_packages / "Bäll_chen"


@pytest.mark.slow
def test_a_folder_is_proposed_next_to_the_file_and_then_next_to_the_package_before(tmp_path):
    ball = textured_ball(4, "Bäll:1")
    ball.select_set(True)
    bpy.context.window_manager.pop(FOLDERS, None)
    assert default_folder(bpy.context).parent == Path.home()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "été.blend"))
    assert default_folder(bpy.context) == tmp_path / "Bäll_1 package"
    (tmp_path / "other").mkdir()
    assert bpy.ops.farfield.packages_export(folder="//other/first", **SMALL) == {"FINISHED"}
    assert bpy.ops.farfield.packages_export(**SMALL) == {"FINISHED"}
    assert read_package(tmp_path / "other" / "Bäll_1 package").manifest.name == "Bäll:1"
    assert default_folder(bpy.context) == tmp_path / "other" / "Bäll_1 package 2", "another file may have made the first one"
    textured_ball(4, "second")
    ball.select_set(True)
    assert default_folder(bpy.context) == tmp_path / "other" / "packages"


def test_a_package_of_an_object(package):
    assert {path.name for path in package.iterdir()} == {MANIFEST, MESH, TEXTURES, LEVELS_GLB, *read_page()}
    content = read_package(package)
    manifest = content.manifest
    assert manifest.name == "Bäll/chen" and len(manifest.levels) == 3
    assert manifest.mirrors == ("https://example.org/a/", "http://example.org/b/")
    finest = decode_level(content.mesh, manifest, 2)
    positions = dequantize(finest.positions, manifest.bounds, manifest.steps[0])
    np.testing.assert_allclose(np.linalg.norm(positions / [1.0, 3.0, 2.0], axis=1), 1.0, atol=2e-3)
    assert len(finest.triangles) == 224
    (image,) = decode_textures(manifest.textures, content.increments, memoryview(content.textures)[manifest.first_increment :])
    assert image.shape == (32, 32, 3)
    rows, columns = np.mgrid[:32, :32]
    is_dark = ((rows // 4 + columns // 4) % 2).astype(bool)
    assert np.abs(image[is_dark].astype(int) - 51).mean() < 6.0
    assert len(manifest.errors.levels) == 3 and manifest.state_count == content.increments.state_count
    assert manifest.errors.tabulate()[2][-1] < 0.1 < manifest.errors.tabulate()[0][0]


def test_axes_are_those_of_gltf(package):
    np.testing.assert_allclose(read_package(package).manifest.bounds[1], [1.0, 3.0, 2.0], rtol=0.05)
    scene = read_glb(package / LEVELS_GLB)
    corners = scene.meshes[0].primitives[0].positions
    assert len(scene.meshes) == 3 and corners.max(axis=0).argmax() == 1


def test_several_objects_have_folders_and_equal_ones_the_same_bytes(two_packages):
    first, second = sorted(two_packages.iterdir())
    assert [first.name, second.name] == ["Bäll_chen", "Bäll_chen_2"]
    assert [read_package(path).manifest.name for path in (first, second)] == ["Bäll/chen", "Bäll:chen"]
    for name in (MESH, TEXTURES):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_settings_that_packages_determine_are_no_properties():
    names = set(bpy.ops.farfield.packages_export.get_rna_type().properties.keys())
    assert {"levels", "drastic_simplification", "pixels"} <= names and "vertices" not in names


def test_mirrors_must_be_urls(folder):
    textured_ball(8)
    with pytest.raises(RuntimeError, match="is no URL"):
        bpy.ops.farfield.packages_export(folder=str(folder), mirrors="https://example.org/a, elsewhere", **SMALL)
    assert not folder.exists()


@pytest.mark.slow
def test_script_builds_and_verifies(folder):
    textured_ball(8).scale = (1.0, 2.0, 3.0)
    scene = folder.parent / "bällchen.blend"
    scene.parent.mkdir(parents=True)
    scene_files.save_scene(scene)
    summary = run("build", scene, "--out", folder, "--report", folder.parent / "report.json", "--no-gltf-file", *FLAGS)
    assert '"Bällchen": 3 levels with 224' in summary
    (figures,) = json.loads((folder.parent / "report.json").read_text(encoding="utf-8"))["packages"]
    assert not (folder / LEVELS_GLB).exists()
    assert figures["errors_of_levels"][0] == 0.0 and figures["mesh_bytes"] == (folder / MESH).stat().st_size
    assert "is complete: 3 levels" in run("verify", folder)
    with pytest.raises(FileError, match="same file"):
        run("build", scene, "--out", scene)
    with pytest.raises(SettingsError, match="multiple of 16"):
        run("build", scene, "--out", folder, *FLAGS, "--tile-size", "100")
    site = folder.parent / "site"
    site.mkdir()
    (site / "index.html").write_text("My page", encoding="utf-8")
    with pytest.raises(FileError, match="but no package"):
        run("build", scene, "--out", site, *FLAGS)


@pytest.mark.parametrize("name", [MESH, TEXTURES])
def test_every_changed_byte_is_found(package, tmp_path, name):
    folder = shutil.copytree(package, tmp_path / "copy")
    content = (package / name).read_bytes()
    for position in np.linspace(0, len(content) - 1, 20).astype(int).tolist():
        changed = bytearray(content)
        changed[position] ^= 16
        (folder / name).write_bytes(changed)
        with pytest.raises(FileError, match="damaged"):
            read_package(folder)


def test_incomplete_packages_are_refused(package, tmp_path):
    folder = shutil.copytree(package, tmp_path / "copy")
    (folder / MESH).write_bytes((package / MESH).read_bytes()[:-1])
    with pytest.raises(FileError, match="instead of"):
        read_package(folder)
    (folder / MESH).unlink()
    with pytest.raises(FileError, match="package lacks"):
        read_package(folder)
    (folder / MANIFEST).unlink()
    with pytest.raises(FileError, match="contains no"):
        read_package(folder)
